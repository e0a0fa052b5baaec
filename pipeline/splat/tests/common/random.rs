//! Random scenes: all sizes from a fraction of a pixel to the whole image, needles, thin and opaque ones.

#![allow(dead_code, unreachable_pub, missing_docs)]

use rogs_splat::{Colour, Gaussians, RasterCamera};

use super::room::Rng;

pub fn scene(count: usize, seed: u64, degree: Option<usize>, extra_channels: usize) -> Gaussians {
    let mut rng = Rng(seed);
    let mut out = Gaussians {
        extra_channels,
        ..Gaussians::empty()
    };
    let per = degree.map_or(3, |d| 3 * (d + 1) * (d + 1));
    let mut colours = Vec::new();
    for _ in 0..count {
        let z = 0.7 + 5.0 * rng.uniform();
        out.means
            .extend([(rng.uniform() - 0.5) * 1.6 * z, (rng.uniform() - 0.5) * 1.2 * z, z].map(|v| v as f32));
        let size = 0.3 * (-5.0 * rng.uniform()).exp();
        out.scales
            .extend((0..3).map(|_| (size * (1.2 * rng.normal()).exp()).min(1.5) as f32));
        out.quats.extend((0..4).map(|_| rng.normal() as f32));
        out.opacities.push(rng.uniform().powi(2) as f32);
        colours.extend((0..per).map(|k| if degree.is_none() { rng.uniform() } else { rng.normal() * if k < 3 { 1.0 } else { 0.3 } } as f32));
        out.extra.extend((0..extra_channels).map(|_| rng.normal() as f32));
    }
    out.colour = match degree {
        None => Colour::Rgb(colours),
        Some(degree) => Colour::Sh {
            degree,
            coefficients: colours,
        },
    };
    out
}

pub fn camera(width: u32, height: u32) -> RasterCamera {
    let focal = 0.7 * f64::from(width);
    // A small rotation about all axes, so that nothing is aligned by accident.
    let (a, b) = (0.11_f64, -0.07_f64);
    let (ca, sa, cb, sb) = (a.cos(), a.sin(), b.cos(), b.sin());
    RasterCamera {
        width,
        height,
        fx: focal,
        fy: 1.05 * focal,
        cx: 0.48 * f64::from(width),
        cy: 0.53 * f64::from(height),
        rotation: [ca, -sa, 0.0, cb * sa, cb * ca, -sb, sb * sa, sb * ca, cb],
        translation: [0.05, -0.03, 0.2],
    }
}
