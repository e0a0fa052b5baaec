//! Many views at once: the same bytes as one view at a time, for every number of threads.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common {
    pub(crate) mod random;
    pub(crate) mod room;
}

use common::{random, room};
use rogs_splat::{
    Gaussians, Gradients, Mode, PoseGradient, RasterCamera, RasterConfig, Render, RenderGradient, backward,
    backward_into, backward_views, render, render_views, render_views_with_tape,
};

/// More cameras than are projected together, of several sizes.
fn cameras() -> Vec<RasterCamera> {
    [(70, 50), (20, 90), (64, 64), (33, 31), (80, 20), (16, 16), (50, 40)]
        .into_iter()
        .enumerate()
        .map(|(index, (width, height))| {
            let mut camera = random::camera(width, height);
            camera.translation[0] += 0.1 * index as f64;
            camera
        })
        .collect()
}

fn config() -> RasterConfig {
    RasterConfig {
        mode: Mode::Antialiased,
        background: [0.2, 0.4, 0.6],
        ..RasterConfig::default()
    }
}

/// Gradient images of a fixed random loss: colour, depth, extra channels of each view.
struct Loss(Vec<[Vec<f32>; 3]>);

impl Loss {
    fn new(scene: &Gaussians, cameras: &[RasterCamera]) -> Self {
        let view = |(seed, camera): (usize, &RasterCamera)| {
            let pixels = camera.pixels();
            [3, 1, scene.extra_channels].map(|channels| room::normals(channels * pixels, (10 * seed + channels) as u64))
        };
        Self(cameras.iter().enumerate().map(view).collect())
    }

    fn images(&self) -> Vec<RenderGradient<'_>> {
        let mut images = Vec::new();
        for view in &self.0 {
            let [rgb, depth_expected, extra] = view;
            images.push(RenderGradient {
                rgb,
                depth_expected,
                extra,
                ..RenderGradient::default()
            });
        }
        images
    }
}

fn assert_same(a: &[Render], b: &[Render], what: &str) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        for (x, y) in [
            (&a.rgb, &b.rgb),
            (&a.alpha, &b.alpha),
            (&a.depth_expected, &b.depth_expected),
            (&a.extra, &b.extra),
        ] {
            assert!(bits(x) == bits(y), "{what}");
        }
        assert_eq!(a.counts, b.counts, "{what}");
    }
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|v| v.to_bits()).collect()
}

fn all_bits(gradients: &Gradients, poses: &[PoseGradient]) -> (Vec<Vec<u32>>, Vec<u64>) {
    let parts = [
        &gradients.means,
        &gradients.quats,
        &gradients.scales,
        &gradients.opacities,
        &gradients.colour,
        &gradients.extra,
    ];
    let pose = |rotation: &[f64; 9], translation: &[f64; 3]| -> Vec<u64> {
        rotation.iter().chain(translation).map(|v| v.to_bits()).collect()
    };
    let mut numbers = pose(&gradients.camera_rotation, &gradients.camera_translation);
    numbers.extend(gradients.background.map(f64::to_bits));
    for own in poses {
        numbers.extend(pose(&own.rotation, &own.translation));
    }
    (parts.iter().map(|part| bits(part)).collect(), numbers)
}

#[test]
fn views_together_are_the_views_alone() {
    for degree in [None, Some(2)] {
        let scene = random::scene(20_000, 13, degree, 3);
        let (cameras, config) = (cameras(), config());
        let alone: Vec<Render> = cameras
            .iter()
            .map(|camera| render(&scene, camera, &config).unwrap())
            .collect();
        assert!(alone.iter().all(|image| image.counts.visible > 50));
        assert_same(&render_views(&scene, &cameras, &config).unwrap(), &alone, "plain");
        let (images, tapes) = render_views_with_tape(&scene, &cameras, &config).unwrap();
        assert_same(&images, &alone, "with tapes");

        let loss = Loss::new(&scene, &cameras);
        let (together, poses) = backward_views(&scene, &config, &tapes, &loss.images()).unwrap();
        let mut summed = Gradients::zeros(&scene);
        for ((tape, image), pose) in tapes.iter().zip(loss.images()).zip(&poses) {
            backward_into(&scene, &config, tape, &image, &mut summed).unwrap();
            let own = backward(&scene, &config, tape, &image).unwrap();
            assert_eq!(
                (own.camera_rotation, own.camera_translation),
                (pose.rotation, pose.translation)
            );
        }
        assert!(together.means.iter().any(|g| *g != 0.0) && together.not_finite == 0);
        // Adding to zeros and writing differ in the sign of zero only.
        assert_eq!(together, summed);
    }
}

#[test]
fn threads_do_not_show_in_many_views() {
    let scene = random::scene(20_000, 14, Some(1), 3);
    let (cameras, config) = (cameras(), config());
    let loss = Loss::new(&scene, &cameras);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (images, tapes) = render_views_with_tape(&scene, &cameras, &config).unwrap();
            let (gradients, poses) = backward_views(&scene, &config, &tapes, &loss.images()).unwrap();
            (images, all_bits(&gradients, &poses))
        })
    };
    let one = run(1);
    for threads in [2, 8] {
        let many = run(threads);
        assert_same(&one.0, &many.0, "images");
        assert!(one.1 == many.1, "gradients on {threads} threads");
    }
}

#[test]
fn no_views_are_no_images_and_zero_gradients() {
    let scene = random::scene(100, 15, None, 0);
    let (images, tapes) = render_views_with_tape(&scene, &[], &config()).unwrap();
    assert!(images.is_empty() && render_views(&scene, &[], &config()).unwrap().is_empty());
    let (gradients, poses) = backward_views(&scene, &config(), &tapes, &[]).unwrap();
    assert!(poses.is_empty() && gradients == Gradients::zeros(&scene));
}

#[test]
fn gradient_images_and_scenes_that_do_not_fit_are_refused() {
    let scene = random::scene(100, 16, None, 0);
    let cameras = &cameras()[..2];
    let (_, tapes) = render_views_with_tape(&scene, cameras, &config()).unwrap();
    let one = [RenderGradient::default()];
    let message = backward_views(&scene, &config(), &tapes, &one).unwrap_err().to_string();
    assert!(message.contains("one per view"), "{message}");
    let short = [0.0; 7];
    let wrong = RenderGradient {
        rgb: &short,
        ..RenderGradient::default()
    };
    let message = backward_views(&scene, &config(), &tapes, &[one[0], wrong])
        .unwrap_err()
        .to_string();
    assert!(message.contains("gradient of rgb"), "{message}");
    let other = random::scene(99, 16, None, 0);
    let message = backward_views(&other, &config(), &tapes, &[one[0]; 2])
        .unwrap_err()
        .to_string();
    assert!(message.contains("forward pass"), "{message}");
    let mut small = Gradients::zeros(&scene);
    small.scales.pop();
    let message = backward_into(&scene, &config(), &tapes[0], &one[0], &mut small)
        .unwrap_err()
        .to_string();
    assert!(message.contains("scales"), "{message}");
}
