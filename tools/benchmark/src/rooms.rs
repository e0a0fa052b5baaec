//! Rooms: triples of posed RGB-D frames as clips of a camera that stands still, and what the network makes of their depth.
//!
//! The world is scaled by [`SCALE`], so that depths are those of a robot cell; the floor is the plane z = 0 of the base,
//! which stands [`BEHIND_M`] behind the first camera and sees the way it looks. No robot is in view.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Context as _, ensure};
use glam::{DMat3, DVec3};
use rogs_geometry::{Base, Camera, Frame, Pose};
use rogs_schemas::episode::{
    EPISODE_FILE, EPISODE_FORMAT, Episode, EpisodeCamera, EpisodeCameraRole, EpisodeDepth, EpisodeMount, EpisodeRobot,
    PixelCentres,
};
use rogs_schemas::records::clip::CameraRole;
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::{Intrinsics, WrittenPose};
use rogs_score::metrics::{depth_scores, depth_support, mean, median, median_scale};
use rogs_synth::{ARM_JOINT_NAMES, Robot, write_robot};
use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::run::ScoredClip;
use crate::table::{Cell, Table};

/// Metres of the episode for a metre of the room.
const SCALE: f64 = 0.5;
/// From the base to the first camera, along its way of looking, metres of the episode.
const BEHIND_M: f64 = 1.0;
/// Frames of an episode: a clip of the usual length, in which nothing moves.
const FRAMES: u32 = 17;
/// Ending of the ids of clips whose third view is held out.
const HELD_OUT: &str = "-two";
/// The arm turned away from what the cameras see, joint values in radians.
const TURNED_AWAY: [f64; 7] = [2.8, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785];
/// Share of the recording's time, from its end, that training on `[[data.frames]]` leaves free (its default `held_out`).
const FREE_SHARE: f64 = 1.0 / 3.0;
/// Depths outside are not scored, metres of the episode.
const RANGE_M: [f32; 2] = [0.1, 5.0];

/// The world of the recording.
#[derive(Debug, Clone, Copy, PartialEq)]
enum World {}

impl Frame for World {
    const NAME: &'static str = "world";
}

#[derive(Deserialize)]
struct Frames {
    image_size: [u32; 2],
    intrinsics: Intrinsics,
    pixel_centres: PixelCentres,
    floor_y_m: f64,
    frames: Vec<Posed>,
}

#[derive(Deserialize)]
struct Posed {
    name: String,
    world_from_camera: WrittenPose,
}

#[derive(Deserialize)]
struct Triples {
    triples: Vec<Triple>,
}

#[derive(Deserialize)]
struct Triple {
    id: String,
    reference: String,
    views: [String; 2],
}

/// Writes the robot and the episodes of all triples: one with three views, one whose third view is held out.
pub(crate) fn write(source: &Path, out: &Path) -> anyhow::Result<()> {
    let frames: Frames = read(&source.join("frames.json"))?;
    let triples: Triples = read(&source.join("triples.json"))?;
    write_robot(&Robot::new(), &out.join(rogs_synth::ROBOT_FOLDER))?;
    for triple in &triples.triples {
        for ending in ["", HELD_OUT] {
            let id = format!("{}{ending}", triple.id);
            let folder = out.join(rogs_synth::EPISODES_FOLDER).join(&id);
            // The description is written last: what has one is whole.
            if !folder.join(EPISODE_FILE).is_file() {
                write_episode(source, &frames, triple, id, &folder)?;
            }
        }
    }
    Ok(())
}

fn read<T: DeserializeOwned>(path: &Path) -> anyhow::Result<T> {
    let what = || format!("reading `{}`", path.display());
    let text = rogs_files::read_to_string(path).with_context(what)?;
    serde_json::from_str(&text).with_context(what)
}

fn write_episode(source: &Path, frames: &Frames, triple: &Triple, id: String, folder: &Path) -> anyhow::Result<()> {
    let held_out = id.ends_with(HELD_OUT);
    let names = [&triple.reference, &triple.views[0], &triple.views[1]];
    let mut poses = Vec::new();
    for name in names {
        let posed = frames.frames.iter().find(|frame| frame.name == *name);
        let posed = posed.with_context(|| format!("frames.json has no frame `{name}`"))?;
        poses.push(Pose::<World, Camera>::from_written(&posed.world_from_camera)?);
    }
    let base = base_behind(&poses[0], frames.floor_y_m)?;
    let mut cameras = Vec::new();
    for ((name, pose), camera_id) in names.into_iter().zip(&poses).zip(["reference", "view1", "view2"]) {
        let evaluated = held_out && camera_id == "view2";
        copy_frames(source, name, &folder.join(camera_id))?;
        cameras.push(EpisodeCamera {
            id: camera_id.to_owned(),
            role: if evaluated {
                EpisodeCameraRole::Evaluation
            } else {
                EpisodeCameraRole::Source
            },
            partner: None,
            images: Some(format!("{camera_id}/images")),
            width: frames.image_size[0],
            height: frames.image_size[1],
            intrinsics: frames.intrinsics,
            pixel_centres: frames.pixel_centres,
            mount: EpisodeMount::Fixed {
                base_from_camera: written(&base.place(pose)),
            },
            depth: Some(EpisodeDepth {
                path: format!("{camera_id}/depth"),
                // Millimetres of the room.
                unit_m: Some(0.001 * SCALE),
                range_m: RANGE_M,
                origin: ReferenceOrigin::DepthCamera,
            }),
        });
    }
    let row = TURNED_AWAY.map(|value| value.to_string()).join(",");
    let states = format!(
        "{},gripper\n{}",
        ARM_JOINT_NAMES.join(","),
        format!("{row},0\n").repeat(FRAMES as usize)
    );
    rogs_files::write_bytes(&folder.join("joints.csv"), states.as_bytes())?;
    let episode = Episode {
        format: EPISODE_FORMAT.to_owned(),
        episode_id: id,
        fps: 15.0,
        frame_count: FRAMES,
        task: String::new(),
        calibration_note: format!("a room at {SCALE} of its size, poses of a head-mounted display"),
        robot: EpisodeRobot {
            joint_names: ARM_JOINT_NAMES.map(str::to_owned).to_vec(),
            states: "joints.csv".to_owned(),
            model: None,
        },
        cameras,
        tracks: None,
    };
    let text = serde_json::to_vec_pretty(&episode)?;
    rogs_files::write_bytes(&folder.join(EPISODE_FILE), &text)?;
    Ok(())
}

/// The picture and the depth of a frame, as often as an episode has frames.
fn copy_frames(source: &Path, name: &str, folder: &Path) -> anyhow::Result<()> {
    let path = source.join("images").join(name).with_extension("jpg");
    let bytes = rogs_files::read(&path).with_context(|| format!("reading `{}`", path.display()))?;
    let rgb = image::load_from_memory_with_format(&bytes, image::ImageFormat::Jpeg)
        .with_context(|| format!("reading `{}`", path.display()))?
        .into_rgb8();
    let image = rogs_arrays::png_bytes(rgb.dimensions(), &rgb)?;
    let path = source.join("depth").join(name).with_extension("png");
    let depth = rogs_files::read(&path).with_context(|| format!("reading `{}`", path.display()))?;
    for (kind, bytes) in [("images", image), ("depth", depth)] {
        let folder = folder.join(kind);
        std::fs::create_dir_all(&folder).with_context(|| format!("making `{}`", folder.display()))?;
        for frame in 0..FRAMES {
            rogs_files::write_bytes(&folder.join(format!("{frame:06}.png")), &bytes)?;
        }
    }
    Ok(())
}

/// The base in the world of a recording whose y axis points up.
struct Standing {
    /// Axes of the base in the world.
    base_from_world: DMat3,
    /// Its origin, metres of the room.
    origin: DVec3,
}

fn base_behind(reference: &Pose<World, Camera>, floor_y_m: f64) -> anyhow::Result<Standing> {
    let forward = reference.direction(DVec3::Z);
    let x = DVec3::new(forward.x, 0.0, forward.z).normalize_or_zero();
    ensure!(x != DVec3::ZERO, "the reference camera looks straight up or down");
    let z = DVec3::Y;
    let origin = reference.translation - x * (BEHIND_M / SCALE);
    Ok(Standing {
        base_from_world: DMat3::from_cols(x, z.cross(x), z).transpose(),
        origin: DVec3::new(origin.x, floor_y_m, origin.z),
    })
}

impl Standing {
    /// A camera in the base frame, metres of the episode.
    fn place(&self, world_from_camera: &Pose<World, Camera>) -> Pose<Base, Camera> {
        Pose::new(
            self.base_from_world * world_from_camera.rotation,
            self.base_from_world * (world_from_camera.translation - self.origin) * SCALE,
        )
    }
}

fn written(pose: &Pose<Base, Camera>) -> WrittenPose {
    let matrix = pose.to_matrix4();
    WrittenPose::Matrix(std::array::from_fn(|row| {
        std::array::from_fn(|column| matrix[4 * row + column])
    }))
}

/// What one rendered depth image is against the sensor's.
struct Judged {
    absrel: f64,
    /// After median scaling with the truth.
    scaled: f64,
    /// Of the logarithms.
    correlation: Option<f64>,
    /// Median of prediction over truth.
    ratio: f64,
    /// Of the truth's own median, everywhere.
    constant: f64,
}

fn judge(predicted: &[f32], truth: &[f32], range_m: [f32; 2]) -> Option<Judged> {
    let support = depth_support(truth, range_m);
    let absrel = |predicted: &[f32], scale| Some(depth_scores(predicted, truth, &support, scale)?.absrel);
    let known = truth.iter().zip(&support).filter(|(_, supported)| **supported);
    let middle = median(known.map(|(depth, _)| f64::from(*depth)).collect())?;
    let scale = median_scale(predicted, truth, &support);
    let pairs = predicted.iter().zip(truth).zip(&support);
    let logs: Vec<[f64; 2]> = pairs
        .filter(|((predicted, _), supported)| **supported && **predicted > 0.0 && predicted.is_finite())
        .map(|((predicted, truth), _)| [f64::from(*predicted).ln(), f64::from(*truth).ln()])
        .collect();
    Some(Judged {
        absrel: absrel(predicted, 1.0)?,
        scaled: absrel(predicted, scale)?,
        correlation: correlation(&logs),
        ratio: 1.0 / scale,
        constant: absrel(&vec![middle as f32; truth.len()], 1.0)?,
    })
}

/// Pearson's; none where one of the two does not change.
fn correlation(pairs: &[[f64; 2]]) -> Option<f64> {
    let means = [0, 1].map(|side| mean(&pairs.iter().map(|pair| pair[side]).collect::<Vec<_>>()));
    let [a, b] = [means[0]?, means[1]?];
    let moment = |f: &dyn Fn(&[f64; 2]) -> f64| pairs.iter().map(f).sum::<f64>();
    let spread = moment(&|p| (p[0] - a).powi(2)) * moment(&|p| (p[1] - b).powi(2));
    (spread > 0.0).then(|| moment(&|p| (p[0] - a) * (p[1] - b)) / spread.sqrt())
}

/// Ids of the triples whose frames all lie in the part of the recording that training leaves free.
pub(crate) fn free(source: &Path) -> anyhow::Result<BTreeSet<String>> {
    let frames: Frames = read(&source.join("frames.json"))?;
    let triples: Triples = read(&source.join("triples.json"))?;
    let first = (frames.frames.len() as f64 * (1.0 - FREE_SHARE)).floor() as usize;
    let last: BTreeSet<&str> = frames.frames[first..].iter().map(|frame| frame.name.as_str()).collect();
    let all_last = |triple: &Triple| {
        let mut views = std::iter::once(&triple.reference).chain(&triple.views);
        views.all(|name| last.contains(name.as_str()))
    };
    Ok(triples
        .triples
        .into_iter()
        .filter(all_last)
        .map(|triple| triple.id)
        .collect())
}

/// A row of the table.
struct Row {
    name: &'static str,
    role: CameraRole,
    /// Whether the third view was held out.
    held_out: bool,
    /// Whether the first camera alone counts.
    first: bool,
    /// Whether moments alone count that training on the recording leaves free.
    free: bool,
}

const ROWS: [Row; 5] = [
    Row {
        name: "views that were given",
        role: CameraRole::Source,
        held_out: false,
        first: false,
        free: false,
    },
    Row {
        name: "the first of them",
        role: CameraRole::Source,
        held_out: false,
        first: true,
        free: false,
    },
    Row {
        name: "a view held out, from two",
        role: CameraRole::Evaluation,
        held_out: true,
        first: false,
        free: false,
    },
    Row {
        name: "last third of time: views that were given",
        role: CameraRole::Source,
        held_out: false,
        first: false,
        free: true,
    },
    Row {
        name: "last third of time: a view held out, from two",
        role: CameraRole::Evaluation,
        held_out: true,
        first: false,
        free: true,
    },
];

impl Row {
    /// Whether a clip counts.
    fn has(&self, id: &str, free: &BTreeSet<String>) -> bool {
        let triple = id.strip_suffix(HELD_OUT);
        triple.is_some() == self.held_out && (!self.free || free.contains(triple.unwrap_or(id)))
    }
}

/// Depth of the rooms. `free`: as of [`free`].
pub(crate) fn table(clips: &[ScoredClip], free: &BTreeSet<String>) -> Table {
    let mut table = Table::new(
        "views",
        &[
            "AbsRel",
            "scaled by its median",
            "a constant",
            "correlation of log depth",
            "estimate / truth",
        ],
    );
    for row in &ROWS {
        let mut columns: [Vec<f64>; 5] = Default::default();
        for clip in clips.iter().filter(|clip| row.has(clip.clip.clip_id.as_str(), free)) {
            let judged: Vec<Judged> = clip
                .of("stage1")
                .into_iter()
                .flat_map(|scores| clip.renders(scores))
                .filter(|(camera, _)| clip.clip.cameras[camera.at()].role == row.role)
                .filter(|(camera, _)| !row.first || camera.at() == 0)
                .filter_map(|(camera, view)| {
                    let (truth, range_m) = clip.reference_depth(camera, view.frame)?;
                    judge(&view.depth_m, truth, range_m)
                })
                .collect();
            let of = |f: &dyn Fn(&Judged) -> Option<f64>| mean(&judged.iter().filter_map(f).collect::<Vec<_>>());
            let values = [
                of(&|j| Some(j.absrel)),
                of(&|j| Some(j.scaled)),
                of(&|j| Some(j.constant)),
                of(&|j| j.correlation),
                of(&|j| Some(j.ratio)),
            ];
            for (column, value) in columns.iter_mut().zip(values) {
                column.extend(value);
            }
        }
        table.row(row.name, columns.map(|values| Cell::over_clips(&values, 3)));
    }
    table
}

#[cfg(test)]
mod tests {
    use glam::DVec2;
    use rogs_geometry::Pinhole;
    use rogs_needs::{needs, shared};

    use super::*;

    /// Depth of the first camera, carried into the second by the poses and lenses of the written episode, is the depth
    /// that the second one measured: an oracle that knows nothing of how the episode was made.
    #[needs(shared)]
    #[test]
    fn depth_of_one_view_is_that_of_the_other() {
        let folder = tempfile::tempdir().unwrap();
        let source = shared!("data/hololens_rooms");
        let frames: Frames = read(&source.join("frames.json")).unwrap();
        let triples: Triples = read(&source.join("triples.json")).unwrap();
        write_episode(&source, &frames, &triples.triples[0], "room".to_owned(), folder.path()).unwrap();
        let episode: Episode = read(&folder.path().join(EPISODE_FILE)).unwrap();
        let [width, height] = frames.image_size;
        let view = |camera: &EpisodeCamera| {
            let EpisodeMount::Fixed { base_from_camera } = &camera.mount else {
                panic!("`{}` moves", camera.id)
            };
            let pose = Pose::<Base, Camera>::from_written(base_from_camera).unwrap();
            let depth = camera.depth.as_ref().unwrap();
            let picture = rogs_files::read(&folder.path().join(&depth.path).join("000016.png")).unwrap();
            let steps = image::load_from_memory(&picture).unwrap().into_luma16();
            let lens = Pinhole::from_integer_centres(camera.intrinsics, width, height);
            (pose, lens, steps, depth.unit_m.unwrap())
        };
        let (first, lens, steps, unit) = view(&episode.cameras[0]);
        let (second, other_lens, other_steps, _) = view(&episode.cameras[1]);
        let mut off = Vec::new();
        for (column, row, step) in steps.enumerate_pixels().filter(|(.., step)| step.0[0] > 0) {
            let depth = f64::from(step.0[0]) * unit;
            let centre = DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            let carried = second.inverse().point(first.point(lens.unproject(centre, depth)));
            let Some((place, there)) = other_lens.project(carried) else {
                continue;
            };
            let inside = place.cmpge(DVec2::ZERO).all() && place.x < f64::from(width) && place.y < f64::from(height);
            if inside && let measured @ 1.. = other_steps.get_pixel(place.x as u32, place.y as u32).0[0] {
                off.push((there / (f64::from(measured) * unit) - 1.0).abs());
            }
        }
        assert!(off.len() > 10_000, "{}", off.len());
        let middle = median(off).unwrap();
        assert!(middle < 0.01, "{middle}");
        // What a wrong scale of the poses would give.
        assert!(
            (first.translation - second.translation).length() < 0.34,
            "half of 0.67 m"
        );
    }

    #[test]
    fn the_base_stands_behind_the_camera_on_the_floor() {
        // A camera 1.6 m above the floor that looks along -z of the world, tilted down by some degrees.
        let tilt = 0.2_f64;
        let rotation = DMat3::from_cols(
            DVec3::X,
            DVec3::new(0.0, -tilt.cos(), tilt.sin()),
            DVec3::new(0.0, -tilt.sin(), -tilt.cos()),
        );
        let camera = Pose::<World, Camera>::new(rotation, DVec3::new(3.0, 0.1, 4.0));
        let placed = base_behind(&camera, -1.5).unwrap().place(&camera);
        assert!((placed.translation - DVec3::new(BEHIND_M, 0.0, 0.8)).length() < 1e-12);
        let forward = placed.direction(DVec3::Z);
        assert!((forward - DVec3::new(tilt.cos(), 0.0, -tilt.sin())).length() < 1e-12);
        assert!((placed.rotation.determinant() - 1.0).abs() < 1e-12);
        // What lies a metre of the room ahead lies half a metre ahead in the episode.
        let ahead = placed.point(DVec3::new(0.0, 0.0, SCALE));
        assert!((ahead - placed.translation - SCALE * forward).length() < 1e-12);
    }

    #[test]
    fn depth_that_is_half_the_truth_is_told_by_its_ratio() {
        let truth = [1.0, 2.0, 3.0, f32::NAN];
        let judged = judge(&[0.5, 1.0, 1.5, 9.0], &truth, [0.1, 5.0]).unwrap();
        assert!((judged.absrel - 0.5).abs() < 1e-12 && judged.scaled.abs() < 1e-12);
        assert!((judged.ratio - 0.5).abs() < 1e-12);
        assert!((judged.correlation.unwrap() - 1.0).abs() < 1e-12);
        // |1 - 2| / 1, 0, |3 - 2| / 3.
        assert!((judged.constant - 4.0 / 9.0).abs() < 1e-7);
        assert_eq!(correlation(&[[1.0, 2.0], [1.0, 3.0]]), None);
    }

    #[test]
    fn rows_of_the_last_third_count_its_moments_alone() {
        let free = BTreeSet::from(["holo-2".to_owned()]);
        let counted = |row: &Row| -> Vec<&str> {
            let all = ["holo-1", "holo-1-two", "holo-2", "holo-2-two"];
            all.into_iter().filter(|id| row.has(id, &free)).collect()
        };
        let expected: [&[&str]; 5] = [
            &["holo-1", "holo-2"],
            &["holo-1", "holo-2"],
            &["holo-1-two", "holo-2-two"],
            &["holo-2"],
            &["holo-2-two"],
        ];
        assert_eq!(ROWS.each_ref().map(counted), expected);
    }

    #[needs(shared)]
    #[test]
    fn moments_of_the_last_third_are_known() {
        let free = free(&shared!("data/hololens_rooms")).unwrap();
        let expected = ["holo-00173", "holo-00193", "holo-00213", "holo-00235"];
        assert!(free.iter().eq(expected.iter()), "{free:?}");
    }
}
