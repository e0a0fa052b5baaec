//! Scenes: what is written is read back within its steps, looks the same, and nothing else is read.
#![allow(clippy::unwrap_used, clippy::expect_used)]

use rogs_export::scene::{
    COLOUR_STEP, LinkMesh, Moment, Moments, POSITION_STEP_M, ROTATION_STEP, SCALE_STEP, Scene, SceneCamera, SceneHead,
    ScenePicture, SceneWriter,
};
use rogs_export::{Error, Result};
use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, Gaussians};

const COUNT: usize = 500;
const EYE: [f64; 16] = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.];

/// A number in -1..1 that depends on nothing but `k`.
fn noise(k: usize) -> f32 {
    (k.wrapping_mul(2_654_435_761) % 10_007) as f32 / 5003.5 - 1.0
}

/// Gaussians in metres of which every fifth moves and every seventh changes at odd times.
fn at(time: usize, degree: usize) -> Gaussians {
    let moves = |n: usize| if n.is_multiple_of(5) { 0.01 * time as f32 } else { 0.0 };
    let changes = |n: usize| if n.is_multiple_of(7) && time % 2 == 1 { 0.3 } else { 0.0 };
    let per = 3 * (degree + 1) * (degree + 1);
    Gaussians {
        means: (0..3 * COUNT).map(|k| noise(k) + moves(k / 3)).collect(),
        quats: (0..4 * COUNT).map(|k| noise(k + 7) + 0.01).collect(),
        scales: (0..3 * COUNT)
            .map(|k| 0.002 + 0.001 * noise(k + 1) + 0.01 * changes(k / 3))
            .collect(),
        opacities: (0..COUNT)
            .map(|n| 0.5 + 0.4 * noise(n + 3) * (1.0 - changes(n)))
            .collect(),
        colour: Colour::Sh {
            degree,
            coefficients: (0..per * COUNT).map(|k| noise(k + 9)).collect(),
        },
        extra: Vec::new(),
        extra_channels: 0,
    }
}

fn head() -> SceneHead {
    let camera = SceneCamera {
        id: "<b>ext1".into(),
        held_out: false,
        width: 8,
        height: 6,
        fx: 9.0,
        fy: 9.0,
        cx: 4.0,
        cy: 3.0,
        recon_from_camera: vec![EYE; 3],
    };
    SceneHead {
        title: "<script>".into(),
        name: "Stage 1".into(),
        times: vec![0.0, 0.25, 1.0],
        seconds: 1.0,
        recon_from_base: EYE,
        cameras: vec![camera],
        links: vec!["hand".into()],
        recon_from_link: vec![vec![EYE]; 3],
    }
}

fn write(degree: usize, most_degree: usize) -> Result<Vec<u8>> {
    let head = head();
    let meshes = [LinkMesh {
        link: 0,
        positions: vec![[0.0, 0.1, -0.2], [1.0, 0.0, 0.0], [0.0; 3]],
        triangles: vec![[0, 1, 2]],
    }];
    let pictures = [ScenePicture {
        camera: 0,
        time: 1,
        jpeg: vec![0xff, 0xd8, 7],
    }];
    let link_of: Vec<u8> = (0..COUNT).map(|n| if n % 3 == 0 { 0 } else { 255 }).collect();
    let writer = SceneWriter {
        head: &head,
        link_of: &link_of,
        meshes: &meshes,
        pictures: &pictures,
        unit: LengthUnit::Metre,
        most_degree,
    };
    writer.bytes(|time| Ok::<_, Error>(at(time, degree)))
}

#[test]
fn a_scene_comes_back_within_its_steps() {
    let bytes = write(1, 3).unwrap();
    let scene = Scene::parse(&bytes).unwrap();
    assert_eq!(scene.head, head());
    assert_eq!(
        (scene.link_of[0], scene.link_of[1], scene.link_of.len()),
        (0, 255, COUNT)
    );
    assert_eq!(scene.pictures[0].jpeg, [0xff, 0xd8, 7]);
    assert_eq!(scene.meshes[0].triangles, [[0, 1, 2]]);
    assert!((scene.meshes[0].positions[0][2] + 0.2).abs() < 1e-4);
    for time in 0..3 {
        let (told, meant) = (scene.gaussians(time).unwrap(), at(time, 1));
        let near = |a: &[f32], b: &[f32], by: f32| {
            assert_eq!(a.len(), b.len());
            a.iter()
                .zip(b)
                .for_each(|(a, b)| assert!((a - b).abs() <= by, "{a} {b} {by}"));
        };
        // Half a step, and what f32 adds.
        near(&told.means, &meant.means, 0.501 * POSITION_STEP_M);
        near(&told.opacities, &meant.opacities, 0.501 * COLOUR_STEP);
        near(told.colour.values(), meant.colour.values(), 0.501 * COLOUR_STEP / 0.28);
        let logs = |scales: &[f32]| scales.iter().map(|scale| scale.ln()).collect::<Vec<_>>();
        near(&logs(&told.scales), &logs(&meant.scales), 0.51 * SCALE_STEP);
        for (told, meant) in told.quats.chunks(4).zip(meant.quats.chunks(4)) {
            let norm = meant.iter().map(|part| part * part).sum::<f32>().sqrt();
            let sign = told.iter().zip(meant).map(|(a, b)| a * b).sum::<f32>().signum();
            told.iter()
                .zip(meant)
                .for_each(|(a, b)| assert!((a * sign - b / norm).abs() <= 0.51 * ROTATION_STEP));
        }
    }
    // What stands still is told once.
    let still = scene.planes[2]
        .moved
        .chunks(3)
        .filter(|moved| **moved == [0; 3])
        .count();
    assert_eq!(still, COUNT - COUNT / 5);
}

#[test]
fn harmonics_end_where_they_are_told_to() {
    let scene = Scene::parse(&write(2, 1).unwrap()).unwrap();
    let Colour::Sh { degree, coefficients } = scene.gaussians(0).unwrap().colour else {
        panic!("no harmonics")
    };
    assert_eq!((degree, coefficients.len()), (1, 12 * COUNT));
    let meant = at(0, 2);
    assert!((coefficients[12 + 5] - meant.colour.values()[27 + 5]).abs() < COLOUR_STEP);
}

#[test]
fn what_cannot_be_drawn_is_hidden() {
    let head = SceneHead {
        cameras: vec![],
        links: vec![],
        recon_from_link: vec![],
        ..head()
    };
    let writer = SceneWriter {
        head: &head,
        link_of: &[],
        meshes: &[],
        pictures: &[],
        unit: LengthUnit::Metre,
        most_degree: 0,
    };
    let bytes = writer.bytes(|_| {
        let mut own = at(0, 0);
        own.means[0] = f32::NAN;
        own.scales[4] = f32::INFINITY;
        own.quats[8..12].fill(0.0);
        Ok::<_, Error>(own)
    });
    let told = Scene::parse(&bytes.unwrap()).unwrap().gaussians(0).unwrap();
    assert_eq!(told.opacities[..3], [0.0; 3]);
    assert!(told.opacities[3] > 0.0 && told.validate().is_ok());
}

#[test]
fn the_same_gaussians_give_the_same_bytes() {
    assert_eq!(write(1, 3).unwrap(), write(1, 3).unwrap());
}

/// Gaussians that say which of them may look different; one that does not is not finite at a time.
struct Marked {
    gaussians: Gaussians,
    open: Vec<u8>,
}

impl Moments for Marked {
    type Error = Error;

    fn at(&mut self, time: usize) -> Result<Moment<'_>> {
        self.gaussians = marked(time);
        // Some are open that look the same as ever.
        self.open = (0..COUNT)
            .map(|n| u8::from((n.is_multiple_of(7) && time > 0) || n.is_multiple_of(11)))
            .collect();
        Ok(Moment {
            gaussians: &self.gaussians,
            open: Some(&self.open),
        })
    }
}

fn marked(time: usize) -> Gaussians {
    let mut own = at(time, 1);
    if time == 1 {
        own.means[3 * 8] = f32::NAN;
    }
    own
}

#[test]
fn what_is_known_to_look_the_same_saves_time_and_no_bytes() {
    for times in [vec![0.0, 0.25, 1.0], vec![0.0, 0.5], vec![0.0]] {
        let mut head = head();
        head.times.clone_from(&times);
        head.cameras[0].recon_from_camera.truncate(times.len());
        head.recon_from_link.truncate(times.len());
        let writer = SceneWriter {
            head: &head,
            link_of: &[],
            meshes: &[],
            pictures: &[],
            unit: LengthUnit::Metre,
            most_degree: 1,
        };
        let plain = writer.bytes(|time| Ok::<_, Error>(marked(time))).unwrap();
        let mut moments = Marked {
            gaussians: Gaussians::empty(),
            open: Vec::new(),
        };
        assert!(writer.bytes_of(&mut moments).unwrap() == plain);
        let scene = Scene::parse(&plain).unwrap();
        for time in 0..times.len() {
            let told = scene.gaussians(time).unwrap();
            let hidden = told.opacities.iter().filter(|opacity| **opacity == 0.0).count();
            assert_eq!(hidden, usize::from(time == 1));
        }
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let refused = |head: SceneHead, links: &[u8]| {
        let writer = SceneWriter {
            head: &head,
            link_of: links,
            meshes: &[],
            pictures: &[],
            unit: LengthUnit::Metre,
            most_degree: 0,
        };
        writer
            .bytes(|time| Ok::<_, Error>(at(time, 0)))
            .unwrap_err()
            .to_string()
    };
    assert!(
        refused(
            SceneHead {
                times: vec![],
                ..head()
            },
            &[]
        )
        .contains("0 times")
    );
    assert!(refused(head(), &[1, 2]).contains("2 links for 500 Gaussians"));
    assert!(
        refused(
            SceneHead {
                links: vec![],
                ..head()
            },
            &[]
        )
        .contains("one pose for every link")
    );
}

#[test]
fn cut_off_and_changed_files_are_errors_or_other_scenes_and_never_panic() {
    let bytes = write(1, 1).unwrap();
    for length in (0..bytes.len()).step_by(97) {
        assert!(Scene::parse(&bytes[..length]).is_err(), "{length}");
    }
    for at in (0..bytes.len()).step_by(13) {
        let mut changed = bytes.clone();
        changed[at] ^= 0x15;
        if let Ok(scene) = Scene::parse(&changed) {
            assert!(scene.gaussians(0).unwrap().len() == COUNT);
        }
    }
}
