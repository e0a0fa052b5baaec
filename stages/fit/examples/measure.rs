//! What a fit gains: image quality at source views and at held-out cameras before and after, seconds, displacements.
//!
//! `cargo run --release -p rogs-fit --example measure -- CLIP_FOLDER [UPDATES] ['{"hold": 0.001, ...}']`
//! The folder is that of a clip in a run, with `clip.r4c`, `robot.r4c`, `field-1.r4c` and, where there is one, `field-2.r4c`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::path::Path;
use std::time::Instant;

use rogs_field::TimedField;
use rogs_fit::{ClipInputs, FitParams, Fitting};
use rogs_geometry::{Base, Pose, PosedCamera, Recon};
use rogs_r4c::read_record;
use rogs_schemas::records::clip::{CameraRole, Clip, time_of_frame};
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::{RasterCamera, RasterConfig, render};

/// Mean PSNR of cameras of a role at frames, dB.
fn psnr(
    clip: &Clip,
    robot: &RobotMaps,
    field: &TimedField<'_>,
    recon: &Pose<Recon, Base>,
    role: CameraRole,
    frames: &[FrameIndex],
) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for &frame in frames {
        let Ok(gaussians) = field.gaussians(time_of_frame(frame, clip.frame_count())) else {
            continue;
        };
        for camera in 0..clip.cameras.len() {
            let index = CameraIndex(camera as u32);
            let (true, Some(target)) = (clip.cameras[camera].role == role, clip.target(index, frame)) else {
                continue;
            };
            let posed = PosedCamera::of_clip(clip, robot, index, frame).unwrap().in_frame(recon);
            let image = render(
                &gaussians,
                &RasterCamera::new(&posed, LengthUnit::Internal),
                &RasterConfig::default(),
            )
            .unwrap();
            let square = |(&a, &b): (&f32, &u8)| (f64::from(a.clamp(0.0, 1.0)) - f64::from(b) / 255.0).powi(2);
            let mse = image.rgb.iter().zip(target.rgb()).map(square).sum::<f64>() / image.rgb.len() as f64;
            sum += -10.0 * mse.log10();
            count += 1;
        }
    }
    sum / f64::from(count)
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(&arguments[0]);
    let clip: Clip = read_record(&folder.join("clip.r4c")).unwrap().0;
    let robot: RobotMaps = read_record(&folder.join("robot.r4c")).unwrap().0;
    let field: Field = read_record(&folder.join("field-1.r4c")).unwrap().0;
    let refinement: Option<Refinement> = read_record(&folder.join("field-2.r4c")).ok().map(|read| read.0);
    let mut params: FitParams = serde_json::from_str(arguments.get(2).map_or("{}", String::as_str)).unwrap();
    if let Some(updates) = arguments.get(1) {
        params.updates = updates.parse().unwrap();
    }
    let recon: Pose<Recon, Base> = Pose::from_rigid(&field.recon_from_base).unwrap();
    let (sources, queries) = (clip.source_frames.clone(), clip.query_frames.clone());
    let others: Vec<FrameIndex> = queries
        .iter()
        .copied()
        .filter(|frame| !sources.contains(frame))
        .collect();
    let tell = |name: &str, timed: &TimedField<'_>, seconds: f64| {
        let at = |role, frames: &[FrameIndex]| psnr(&clip, &robot, timed, &recon, role, frames);
        println!(
            "{name:>12}  source {:.3}  source cameras at other times {:.3}  right eyes {:.3}  {seconds:.1} s",
            at(CameraRole::Source, &sources),
            at(CameraRole::Source, &others),
            at(CameraRole::Evaluation, &queries),
        );
    };
    println!("{} Gaussians, sources {sources:?}, queries {queries:?}", field.len());
    tell("Stage 1", &TimedField::new(&field).unwrap(), 0.0);
    if let Some(refinement) = &refinement {
        tell(
            "Stage 1+2",
            &TimedField::new(&field).unwrap().with_refinement(refinement).unwrap(),
            0.0,
        );
    }
    let inputs = ClipInputs {
        clip: &clip,
        robot: &robot,
        field: &field,
        refinement: refinement.as_ref(),
    };
    let begin = Instant::now();
    let mut fitting = Fitting::new(inputs, &params).unwrap();
    let every = (params.updates / 5).max(1);
    let mut spent = 0.0;
    tell(
        "start",
        &TimedField::new(&fitting.field().unwrap()).unwrap(),
        begin.elapsed().as_secs_f64(),
    );
    for update in 1..=params.updates {
        let start = Instant::now();
        let loss = fitting.update().unwrap();
        spent += start.elapsed().as_secs_f64();
        if update % every == 0 {
            println!("loss {loss:.5}");
            tell(
                &format!("{update}"),
                &TimedField::new(&fitting.field().unwrap()).unwrap(),
                spent,
            );
        }
    }
    let fitted = fitting.field().unwrap();
    let (mut kept, mut robots) = (true, 0);
    for (a, b) in field.slices.iter().zip(&fitted.slices) {
        for index in (0..field.len()).filter(|&index| field.support[index] != 0) {
            robots += 1;
            kept &=
                (0..3).all(|k| a.displacement_m[3 * index + k].to_bits() == b.displacement_m[3 * index + k].to_bits());
        }
    }
    println!("{robots} displacements of robot Gaussians, all kept bit for bit: {kept}");
}
