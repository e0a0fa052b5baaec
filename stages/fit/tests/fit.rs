//! A fit of a small procedural clip: what it gains, what it keeps, and what it refuses.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::sync::OnceLock;

use glam::{DVec2, DVec3};
use rogs_field::TimedField;
use rogs_fit::{ClipInputs, FitParams, Fitting, RobotMotion, fit};
use rogs_geometry::{Base, LinkPoses, Pose, PosedCamera, Recon};
use rogs_robot_maps::Robot;
use rogs_schemas::interim::Figures;
use rogs_schemas::records::clip::{CameraRole, Clip, time_of_frame};
use rogs_schemas::records::field::{Field, RAW_CHANNELS, TimeSlice, WeightsInfo};
use rogs_schemas::records::progress::Progress;
use rogs_schemas::records::robot::{NO_LINK, RobotMaps};
use rogs_schemas::units::{LengthUnit, UNITS_PER_METRE};
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex};
use rogs_splat::{RasterCamera, RasterConfig, render};
use rogs_synth::{ROBOT_SPEC_FILE, SynthConfig, write_dataset};
use rogs_worker::{Observer, Unobserved};

const FRAMES: u32 = 5;

struct Example {
    clip: Clip,
    robot: RobotMaps,
    field: Field,
}

impl Example {
    fn inputs(&self) -> ClipInputs<'_> {
        ClipInputs {
            clip: &self.clip,
            robot: &self.robot,
            field: &self.field,
            refinement: None,
        }
    }
}

fn noise(k: usize) -> f64 {
    (k * 7919 % 1013) as f64 / 1013.0 - 0.5
}

/// A procedural clip, and a field of its exact depth that is 2 % off, with colours that are off too.
fn example() -> &'static Example {
    static EXAMPLE: OnceLock<Example> = OnceLock::new();
    EXAMPLE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let config = SynthConfig {
            frames: FRAMES,
            ..SynthConfig::default()
        };
        let made = write_dataset(folder.path(), 1, 501, &config).unwrap();
        let params = rogs_ingest::Params {
            frames: FRAMES,
            height: 42,
            width: 70,
            start_frame: Some(EpisodeFrame(0)),
            source_frames: vec![FrameIndex(0), FrameIndex(4)],
            query: rogs_ingest::QueryChoice::Frames(vec![FrameIndex(2)]),
            ..rogs_ingest::Params::default()
        };
        let (clip, _) = rogs_ingest::read_clip(&made.episodes[0], None, &params, "procedural").unwrap();
        let spec = made.robot.with_file_name(ROBOT_SPEC_FILE);
        let params = rogs_robot_maps::Params {
            robot: serde_json::from_slice(&std::fs::read(spec).unwrap()).unwrap(),
            ..rogs_robot_maps::Params::default()
        };
        let model = Robot::load(&made.robot, &params).unwrap();
        let robot = rogs_robot_maps::build(&clip, &model, &params, &mut Unobserved).unwrap();
        let field = field(&clip, &robot);
        field.check().unwrap();
        Example { clip, robot, field }
    })
}

fn field(clip: &Clip, robot: &RobotMaps) -> Field {
    let views = clip.source_views();
    let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&robot.recon_from_base).unwrap();
    let (height, width) = (clip.height as usize, clip.width as usize);
    let frames = [0, 2, 4].map(FrameIndex);
    let poses = frames.map(|frame| LinkPoses::at_frame(robot, frame).unwrap());
    let n = views.len() * height * width;
    let (mut position_m, mut base_raw) = (Vec::new(), Vec::new());
    let (mut support, mut link) = (Vec::new(), Vec::new());
    let mut displacement = vec![vec![0.0; 3 * n]; frames.len()];
    for view in &views {
        let camera = PosedCamera::of_clip(clip, robot, view.camera, view.frame)
            .unwrap()
            .in_frame(&recon_from_base);
        let pinhole = camera.lens;
        let depth = clip.cameras[view.camera.at()].depth.as_ref().unwrap();
        let map = robot
            .maps
            .iter()
            .find(|map| map.camera == view.camera && map.frame == view.frame)
            .unwrap();
        let rgb = clip.observation(*view).unwrap();
        let own = frames.iter().position(|&frame| frame == view.frame).unwrap();
        for pixel in 0..height * width {
            let index = support.len();
            let exact = f64::from(depth.depth_m[view.frame.at() * height * width + pixel]);
            let z = if exact.is_finite() { exact } else { 2.0 } * (1.0 + 0.02 * noise(index));
            let place = DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
            let point: DVec3 = camera.world_from_camera.point(pinhole.unproject(place, z));
            position_m.extend(point.as_vec3().to_array());
            let anchored = map.support[pixel] != 0;
            support.push(u8::from(anchored));
            link.push(if anchored { map.link[pixel] } else { NO_LINK });
            if anchored {
                for (slice, pose) in poses.iter().enumerate() {
                    let moved = pose
                        .motion_from(&poses[own])
                        .moved(map.link[pixel].into(), point)
                        .unwrap();
                    let d = (moved - point).as_vec3().to_array();
                    displacement[slice][3 * index..3 * index + 3].copy_from_slice(&d);
                }
            }
            let colour = |channel: usize| {
                let value = f64::from(rgb.rgb()[3 * pixel + channel]) / 255.0 + 0.2 * noise(3 * index + channel);
                (2.0 * value.clamp(0.02, 0.98) - 1.0).atanh() as f32
            };
            base_raw.extend([0, 1, 2].map(colour));
            let scale = (0.6 * z / pinhole.intrinsics.fx * UNITS_PER_METRE / 0.001) as f32;
            base_raw.extend([scale, scale, scale, 1.0, 0.0, 0.0, 0.0, 1.8]);
        }
    }
    assert_eq!(base_raw.len(), RAW_CHANNELS * n);
    let slices = frames
        .iter()
        .zip(displacement)
        .map(|(&frame, displacement_m)| TimeSlice {
            time: time_of_frame(frame, FRAMES as usize),
            displacement_m,
            gate: vec![0; n],
            moving_raw: Vec::new(),
        });
    Field {
        clip_id: clip.clip_id.clone(),
        frame_count: FRAMES,
        height: clip.height,
        width: clip.width,
        views,
        recon_from_base: robot.recon_from_base,
        weights: WeightsInfo {
            trained: false,
            configuration: "none".into(),
            description: "exact depth, 2 % off".into(),
            hash: String::new(),
        },
        position_m,
        base_raw,
        support,
        link,
        scale_cap_iu: vec![f32::INFINITY; n],
        slices: slices.collect(),
        query_state: Vec::new(),
    }
}

/// Mean PSNR of the cameras of a role at frames, dB.
fn psnr(example: &Example, field: &Field, role: CameraRole, frames: &[u32]) -> f64 {
    let timed = TimedField::new(field).unwrap();
    let recon: Pose<Recon, Base> = Pose::from_rigid(&field.recon_from_base).unwrap();
    let (mut sum, mut count) = (0.0, 0);
    for &frame in frames {
        let frame = FrameIndex(frame);
        let gaussians = timed.gaussians(time_of_frame(frame, FRAMES as usize)).unwrap();
        for (camera, own) in example.clip.cameras.iter().enumerate() {
            let index = CameraIndex(camera as u32);
            let (true, Some(target)) = (own.role == role, example.clip.target(index, frame)) else {
                continue;
            };
            let posed = PosedCamera::of_clip(&example.clip, &example.robot, index, frame)
                .unwrap()
                .in_frame(&recon);
            let camera = RasterCamera::new(&posed, LengthUnit::Internal);
            let image = render(&gaussians, &camera, &RasterConfig::default()).unwrap();
            let square = |(&a, &b): (&f32, &u8)| (f64::from(a.clamp(0.0, 1.0)) - f64::from(b) / 255.0).powi(2);
            let mse = image.rgb.iter().zip(target.rgb()).map(square).sum::<f64>() / image.rgb.len() as f64;
            sum += -10.0 * mse.log10();
            count += 1;
        }
    }
    sum / f64::from(count)
}

/// Notes what it is shown.
#[derive(Default)]
struct Watching {
    shown: Vec<(Figures, Vec<u8>)>,
}

impl Observer for Watching {
    fn show(&mut self, figures: &Figures, picture_png: &[u8]) {
        self.shown.push((figures.clone(), picture_png.to_vec()));
    }
}

#[test]
fn source_views_gain_and_so_do_views_that_were_never_seen() {
    let example = example();
    let params = FitParams {
        updates: 40,
        ..FitParams::default()
    };
    let mut watching = Watching::default();
    let fitted = fit(example.inputs(), &params, None, &mut watching).unwrap();
    fitted.check().unwrap();
    // Whoever watches sees the source views on their way.
    let [(figures, picture)] = &watching.shown[..] else {
        panic!("{} pictures", watching.shown.len())
    };
    assert_eq!((figures.update, figures.updates), (25, 40));
    let shown = figures.source_psnr_db.unwrap();
    let [start, end] = [&example.field, &fitted].map(|field| psnr(example, field, CameraRole::Source, &[0, 4]));
    assert!(start < shown && shown < end + 0.2, "{start} {shown} {end}");
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), picture).unwrap();
    let picture = rogs_arrays::Png::open(file.path()).unwrap();
    let cameras = example.clip.source_cameras().len() as u32;
    assert_eq!(
        (picture.width, picture.height),
        (2 * example.clip.width, cameras * example.clip.height)
    );
    let gain = |role: CameraRole, frames: &[u32]| {
        let (before, after) = (
            psnr(example, &example.field, role, frames),
            psnr(example, &fitted, role, frames),
        );
        println!("{role:?} {frames:?}: {before:.2} to {after:.2} dB");
        after - before
    };
    assert!(gain(CameraRole::Source, &[0, 4]) > 1.5);
    assert!(gain(CameraRole::Evaluation, &[0, 4]) > 0.5, "right eyes");
    assert!(gain(CameraRole::Source, &[2]) > 0.3, "a time that was never seen");
    for (before, after) in example.field.slices.iter().zip(&fitted.slices) {
        for index in (0..fitted.len()).filter(|&index| fitted.support[index] != 0) {
            let bits = |slice: &TimeSlice| [0, 1, 2].map(|k| slice.displacement_m[3 * index + k].to_bits());
            assert_eq!(bits(before), bits(after), "the robot moves as it did");
            let centre = |field: &Field| [0, 1, 2].map(|k| field.position_m[3 * index + k].to_bits());
            assert_eq!(centre(&example.field), centre(&fitted), "and begins where it did");
        }
    }
    assert!(
        fitted.weights.description.ends_with("40 updates"),
        "{}",
        fitted.weights.description
    );
}

#[test]
fn interrupted_fits_and_any_number_of_threads_end_at_the_same_bits() {
    let example = example();
    let params = FitParams {
        updates: 4,
        ..FitParams::default()
    };
    let on = |threads: usize, interrupted: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut fitting = Fitting::new(example.inputs(), &params).unwrap();
            for update in 0..params.updates {
                if interrupted && update == 2 {
                    let kept = fitting.kept();
                    fitting = Fitting::new(example.inputs(), &params).unwrap();
                    assert!(fitting.resume(&kept));
                    let short = Progress {
                        arrays: kept.arrays[1..].to_vec(),
                        ..kept
                    };
                    assert!(!fitting.resume(&short), "of another fit");
                }
                fitting.update().unwrap();
            }
            fitting.field().unwrap()
        })
    };
    let once = on(1, false);
    assert_eq!(on(3, false), once);
    assert_eq!(on(2, true), once);
}

#[test]
fn links_can_move_the_robot() {
    let example = example();
    let mut field = example.field.clone();
    for slice in &mut field.slices {
        slice.displacement_m.fill(0.0);
    }
    let params = FitParams {
        updates: 0,
        robot: RobotMotion::Kinematics,
        ..FitParams::default()
    };
    let inputs = ClipInputs {
        field: &field,
        ..example.inputs()
    };
    let fitted = fit(inputs, &params, None, &mut Unobserved).unwrap();
    fitted.check().unwrap();
    let mut moved = 0.0f32;
    for (before, after) in example.field.slices.iter().zip(&fitted.slices) {
        for (a, b) in before.displacement_m.iter().zip(&after.displacement_m) {
            moved = moved.max(a.abs());
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
    assert!(moved > 0.01, "the robot moves: {moved}");
}

#[test]
fn records_that_do_not_belong_together_are_refused() {
    let example = example();
    let params = FitParams::default();
    let refused = |inputs: ClipInputs<'_>, params: &FitParams| Fitting::new(inputs, params).err().unwrap().message;
    let mut field = example.field.clone();
    field.clip_id = "another".parse().unwrap();
    let other = ClipInputs {
        field: &field,
        ..example.inputs()
    };
    assert!(refused(other, &params).contains("do not belong together"));
    let mut field = example.field.clone();
    field.slices.remove(0);
    let late = ClipInputs {
        field: &field,
        ..example.inputs()
    };
    assert!(refused(late, &params).contains("no values at its own source frame 0"));
    let mut clip = example.clip.clone();
    clip.cameras.iter_mut().for_each(|camera| camera.recorded = None);
    let blind = ClipInputs {
        clip: &clip,
        ..example.inputs()
    };
    assert!(refused(blind, &params).contains("has no images"));
    let mut clip = example.clip.clone();
    clip.cameras.iter_mut().for_each(|camera| camera.depth = None);
    let flat = ClipInputs {
        clip: &clip,
        ..example.inputs()
    };
    let deep = FitParams {
        depth: 0.1,
        ..params.clone()
    };
    assert!(refused(flat, &deep).contains("asks for reference depth"));
    let none = FitParams { bases: 0, ..params };
    assert!(refused(example.inputs(), &none).contains("`bases` must be 1 to 64"));
}
