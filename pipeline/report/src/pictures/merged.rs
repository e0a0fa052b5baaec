//! The geometry that the Gaussians of all cameras make together, and of each alone.

use rogs_geometry::{Base, Pose, Recon};
use rogs_schemas::CameraIndex;
use rogs_schemas::records::field::Field;
use rogs_splat::{Colour, Gaussians, sh};

use super::picture::{Figure, Picture};
use super::studio::{Studio, View};

/// Hue of a camera's Gaussians, by its place among the source cameras, RGB in 0..1.
const HUES: [[f32; 3]; 6] = [
    [1.0, 0.45, 0.25],
    [0.35, 0.7, 1.0],
    [0.55, 0.95, 0.35],
    [1.0, 0.85, 0.3],
    [0.9, 0.5, 1.0],
    [0.4, 1.0, 0.9],
];

/// The cells of a method in the figure of merged geometry.
pub(super) fn merged_row(
    studio: &Studio<'_>,
    view: &View,
    field: &Field,
    gaussians: &Gaussians,
    recon_from_base: &Pose<Recon, Base>,
) -> Vec<Option<Figure>> {
    let area = field.height as usize * field.width as usize;
    let camera_of = |index: usize| field.views.get(index / area.max(1)).map(|view| view.camera);
    let of_camera: Vec<Option<CameraIndex>> = (0..gaussians.len()).map(camera_of).collect();
    let drawn = |gaussians: &Gaussians| studio.render(gaussians, view.posed, recon_from_base);
    let shown = |picture: &Option<Picture>, view: &View, what: String| view.of(picture.as_ref()?).jpeg(what);
    let sources = studio.sources();
    let mut cells = Vec::new();
    for (camera, name) in &sources {
        let keep: Vec<bool> = of_camera.iter().map(|own| *own == Some(*camera)).collect();
        cells.push(shown(&drawn(&gaussians.kept(&keep)), view, format!("{name} alone")));
    }
    let hues: Vec<[f32; 3]> = (of_camera.iter())
        .map(|own| {
            let place = sources
                .iter()
                .position(|(camera, _)| *own == Some(*camera))
                .unwrap_or(0);
            HUES[place % HUES.len()]
        })
        .collect();
    let (merged, by_camera) = (drawn(gaussians), drawn(&tinted(gaussians, &hues)));
    let crop = studio.crop(view.posed, view.frame, &[view.frame], "crop".to_owned());
    cells.push(shown(&merged, view, "merged".to_owned()));
    cells.push(shown(&by_camera, view, "merged, by camera".to_owned()));
    cells.push(shown(&merged, &crop, "crop".to_owned()));
    cells.push(shown(&by_camera, &crop, "crop, by camera".to_owned()));
    cells
}

/// The Gaussians in these hues, as bright as they are. `hues [N]`
fn tinted(gaussians: &Gaussians, hues: &[[f32; 3]]) -> Gaussians {
    let per = match &gaussians.colour {
        Colour::Rgb(_) => 3,
        Colour::Sh { degree, .. } => 3 * sh::coefficient_count(*degree),
    };
    let (values, harmonics) = match &gaussians.colour {
        Colour::Rgb(values) => (values, false),
        Colour::Sh { coefficients, .. } => (coefficients, true),
    };
    let grey = |row: &[f32]| {
        let mean = (row[0] + row[1] + row[2]) / 3.0;
        let mean = if harmonics { sh::C0 * mean + 0.5 } else { mean };
        mean.clamp(0.0, 1.0)
    };
    let colours = values.chunks_exact(per).zip(hues);
    let rgb = colours.flat_map(|(row, hue)| {
        let shade = 0.25 + 0.75 * grey(row);
        hue.map(|channel| channel * shade)
    });
    Gaussians {
        colour: Colour::Rgb(rgb.collect()),
        ..gaussians.clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tints_keep_brightness_and_forget_the_colour() {
        let one = |colour| Gaussians {
            means: vec![0.0; 6],
            quats: vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            scales: vec![0.1; 6],
            opacities: vec![0.5; 2],
            colour,
            extra: Vec::new(),
            extra_channels: 0,
        };
        let hues = [[1.0, 0.5, 0.0]; 2];
        let Colour::Rgb(plain) = tinted(&one(Colour::Rgb(vec![0.0, 0.0, 0.0, 0.0, 1.0, 2.0])), &hues).colour else {
            panic!("not plain");
        };
        assert_eq!(plain, [0.25, 0.125, 0.0, 1.0, 0.5, 0.0]);
        let grey = (0.5 - 0.5) / sh::C0;
        let harmonics = Colour::Sh {
            degree: 0,
            coefficients: vec![grey; 6],
        };
        let Colour::Rgb(plain) = tinted(&one(harmonics), &hues).colour else {
            panic!("not plain");
        };
        assert_eq!(plain[..3], [0.625, 0.3125, 0.0]);
    }
}
