//! Trains a `ci` refiner on made-up clips for some steps and shows what it does to clips that it has not seen.
//!
//! `cargo run --release -p rogs-refine --example learn -- [STEPS] [FOLDER]`
//! The clips are those of the tests: a textured bumpy wall before three cameras, with a field whose colours, sizes,
//! rotations and opacities are wrong. It shows that the recurrence learns from rendering feedback; weights for real
//! clips need real clips and the whole objective. With FOLDER, writes observation, Stage 1 and the refined render of one
//! unseen clip side by side as a PPM picture.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of examples may be left half-written")]

#[path = "../tests/support/mod.rs"]
mod support;

use std::path::Path;

use burn::tensor::Device;
use rogs_field::TimedField;
use rogs_geometry::PosedCamera;
use rogs_refine::training::{AdamW, TrainingOptions, training_step};
use rogs_refine::{LoadedRefiner, RefineParams, refine};
use rogs_schemas::records::clip::Observation;
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::units::LengthUnit;
use rogs_splat::{RasterCamera, RasterConfig, render};
use rogs_stage2::{Refiner, RefinerConfig, seeded_parameters};
use rogs_worker::Unobserved;
use support::{Example, Sizes, example_of};

const SIZES: Sizes = Sizes {
    height: 28,
    width: 40,
    frames: 5,
    step: 4,
};
const UPDATES: u32 = 2;

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let steps: u64 = arguments.first().map_or(Ok(150), |text| text.parse())?;
    let config = RefinerConfig::preset("ci")?;
    let mut parameters = seeded_parameters(&config, 1, &Device::flex().autodiff())?;
    let params = RefineParams {
        updates: Some(UPDATES),
        keep_intermediate: true,
        ..RefineParams::default()
    };
    let options = TrainingOptions::default();
    let mut optimiser = AdamW::default();
    for step in 0..steps {
        // One-cycle in short: warm up over a tenth, then decay to nothing.
        let done = step as f64 / steps as f64;
        let rate = 4e-3 * (done * 10.0).min(1.0) * 0.5 * (1.0 + (std::f64::consts::PI * done).cos());
        (optimiser.learning_rate, optimiser.gate_learning_rate) = (rate, 1.521 * rate);
        AdamW::track(&mut parameters);
        let refiner = Refiner::load(&parameters, &config)?;
        let clip = example_of(SIZES, 1000 + step);
        let result = training_step(clip.inputs(), &refiner, &params, &options)?;
        optimiser.step(&mut parameters, &result.surrogate)?;
        if step % 10 == 0 {
            println!(
                "step {step:4}  objective {:.4}  colour error after each update {:.4?}",
                result.objective,
                result.terms.iter().map(|terms| terms.rendering).collect::<Vec<_>>()
            );
        }
    }
    let info = WeightsInfo {
        trained: true,
        configuration: config.name.clone(),
        description: format!("{steps} steps on made-up walls"),
        hash: String::new(),
    };
    let network = LoadedRefiner {
        refiner: Refiner::load(&parameters, &config)?,
        info,
        warnings: Vec::new(),
    };
    println!("unseen clips: PSNR of the source views, dB: Stage 1, then after each update");
    for seed in 1..=3 {
        let clip = example_of(SIZES, seed);
        let refinement = refine(clip.inputs(), &network, &params, &mut Unobserved)?;
        let scores = (0..=UPDATES)
            .map(|update| psnr(&clip, &refinement, update))
            .collect::<Result<Vec<_>, _>>()?;
        println!("clip {seed}: {scores:.2?}");
        if let (Some(folder), 1) = (arguments.get(1), seed) {
            picture(&clip, &refinement, &Path::new(folder).join("before-after.ppm"))?;
        }
    }
    Ok(())
}

/// Render of a source view after some updates, RGB in 0..=1.
fn view(clip: &Example, refinement: &Refinement, update: u32, view: usize) -> Result<Vec<f32>, Failure> {
    let source = clip.field.views[view];
    let field = TimedField::new(&clip.field)?;
    let field = match refinement.steps.iter().find(|step| step.update == update) {
        Some(step) => field.with_correction(step, refinement.scale_residual)?,
        None => field,
    };
    let time = rogs_schemas::records::clip::time_of_frame(source.frame, clip.clip.frame_count());
    let camera = PosedCamera::of_clip(&clip.clip, &clip.robot, source.camera, source.frame)?;
    let camera = RasterCamera::new(&camera, LengthUnit::Internal);
    let image = render(&field.gaussians(time)?, &camera, &RasterConfig::default())?;
    Ok(image.rgb.into_iter().map(|value| value.clamp(0.0, 1.0)).collect())
}

/// The observed image of a source view, RGB in 0..=1.
fn observed(clip: &Example, view: usize) -> Vec<f32> {
    let image = clip.clip.observation(clip.field.views[view]);
    let rgb = image.map_or(&[][..], Observation::rgb);
    rgb.iter().map(|&value| f32::from(value) / 255.0).collect()
}

fn psnr(clip: &Example, refinement: &Refinement, update: u32) -> Result<f64, Failure> {
    let mut total = 0.0;
    for index in 0..clip.field.views.len() {
        let (render, image) = (view(clip, refinement, update, index)?, observed(clip, index));
        let square: f64 = render.iter().zip(&image).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        total += -10.0 * (square / image.len() as f64).log10();
    }
    Ok(total / clip.field.views.len() as f64)
}

/// Observation, Stage 1 and the refined render of the first source view, each pixel eight times larger.
fn picture(clip: &Example, refinement: &Refinement, path: &Path) -> Result<(), Failure> {
    const ZOOM: usize = 8;
    let images = [
        observed(clip, 0),
        view(clip, refinement, 0, 0)?,
        view(clip, refinement, UPDATES, 0)?,
    ];
    let (height, width) = (SIZES.height as usize, SIZES.width as usize);
    let mut bytes = format!("P6\n{} {}\n255\n", 3 * width * ZOOM, height * ZOOM).into_bytes();
    for row in 0..height * ZOOM {
        for column in 0..3 * width * ZOOM {
            let (image, x) = (&images[column / (width * ZOOM)], column % (width * ZOOM) / ZOOM);
            let pixel = &image[(row / ZOOM * width + x) * 3..][..3];
            bytes.extend(pixel.iter().map(|&value| (value * 255.0 + 0.5) as u8));
        }
    }
    std::fs::write(path, bytes)?;
    println!("wrote {}", path.display());
    Ok(())
}
