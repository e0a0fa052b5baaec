//! Planted mistakes on procedural clips: what the audit says of them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::Machine;
use glam::{DVec2, DVec3};
use rogs_agreement::audit::{CameraAudit, Filmed, Footage, Mount, Verdict, audit};
use rogs_geometry::{Base, Camera, Link, Pinhole, Pose};
use rogs_synth::{ARM_JOINT_NAMES, Episode, RobotState, SynthConfig, generate_episode};

const FRAMES: usize = 17;
const FIRST: usize = 7;

/// A clip in memory that mistakes are planted in.
struct Clip {
    images: Vec<Vec<Vec<u8>>>,
    lenses: Vec<Pinhole>,
    mounts: Vec<Mount>,
    states: Vec<RobotState>,
}

fn hand(machine: &Machine, episode: &Episode) -> Mount {
    let link = machine.model.link_id("panda_link8").unwrap();
    let links = machine.links(&episode.states[0]);
    let link_from_camera: Pose<Link, Camera> = links[link].inverse() * episode.base_from_camera(0, 0);
    Mount::Hand { link, link_from_camera }
}

impl Clip {
    fn of(machine: &Machine, seed: u64) -> (Self, Episode) {
        let episode = generate_episode(&SynthConfig::default(), seed).unwrap();
        let mut images = vec![Vec::new(); 3];
        for frame in FIRST..FIRST + FRAMES {
            let views = episode.render_cameras(frame, &[0, 1, 2]);
            for (camera, view) in views.into_iter().enumerate() {
                images[camera].push(view.rgb);
            }
        }
        let mounts = vec![
            hand(machine, &episode),
            Mount::Fixed(episode.base_from_camera(1, 0)),
            Mount::Fixed(episode.base_from_camera(2, 0)),
        ];
        let clip = Self {
            images,
            lenses: (0..3).map(|camera| episode.cameras[camera].lens).collect(),
            mounts,
            states: episode.states[FIRST..FIRST + FRAMES].to_vec(),
        };
        (clip, episode)
    }

    fn audit(&self, machine: &Machine) -> Vec<CameraAudit> {
        let names: Vec<String> = ARM_JOINT_NAMES.map(str::to_owned).to_vec();
        let positions: Vec<f64> = self.states.iter().flat_map(|state| state.joints).collect();
        let gripper: Vec<f64> = self.states.iter().map(|state| state.gripper).collect();
        let cameras = ["wrist", "ext1", "ext2"]
            .into_iter()
            .enumerate()
            .map(|(index, name)| Filmed {
                name,
                lens: self.lenses[index],
                mount: self.mounts[index].clone(),
                images: self.images[index].iter().map(Vec::as_slice).collect(),
            });
        let footage = Footage {
            model: &machine.model,
            scene: &machine.scene,
            spec: &machine.spec,
            joint_names: &names,
            positions: &positions,
            gripper: &gripper,
            cameras: cameras.collect(),
        };
        audit(&footage).unwrap()
    }

    fn move_camera(&mut self, camera: usize, by: Pose<Camera, Camera>) {
        self.mounts[camera] = self.mounts[camera].moved(by);
    }

    fn change_images(&mut self, camera: usize, from: impl Fn(usize, usize) -> (usize, usize)) {
        let (width, height) = (self.lenses[camera].width as usize, self.lenses[camera].height as usize);
        for image in &mut self.images[camera] {
            let old = image.clone();
            for row in 0..height {
                for column in 0..width {
                    let (x, y) = from(column, row);
                    let (x, y) = (x.min(width - 1), y.min(height - 1));
                    for c in 0..3 {
                        image[3 * (row * width + column) + c] = old[3 * (y * width + x) + c];
                    }
                }
            }
        }
    }
}

/// 5 cm and 5 degrees in a direction that depends on the seed.
fn off(seed: u64) -> Pose<Camera, Camera> {
    let angle = seed as f64 * 2.4;
    let direction = DVec3::new(angle.cos(), angle.sin(), (seed as f64 * 1.3).sin() * 0.5).normalize();
    let axis = DVec3::new((seed as f64 * 1.7).cos(), (seed as f64 * 1.7).sin(), 0.5).normalize();
    Pose::new(
        rogs_geometry::rotation_about_axis(axis, 5f64.to_radians()),
        direction * 0.05,
    )
}

const KINDS: [&str; 17] = [
    "right",
    "inverted-pose",
    "swapped-cameras",
    "other-eye",
    "wrong-pose",
    "wrong-hand-eye",
    "wrist-drift",
    "camera-moved",
    "time-offset",
    "unscaled-intrinsics",
    "transposed-intrinsics",
    "distortion",
    "gripper-sense",
    "gripper-range",
    "joint-order",
    "joint-unit",
    "mirrored-image",
];

/// Plants a mistake; the camera in which it must be found.
fn plant(kind: &str, clip: &mut Clip, episode: &Episode, seed: u64) -> usize {
    let external = 1 + (seed as usize) % 2;
    match kind {
        "inverted-pose" => {
            if let Mount::Fixed(pose) = &clip.mounts[external] {
                clip.mounts[external] = Mount::Fixed(pose.inverse().relabelled());
            }
            external
        }
        "swapped-cameras" => {
            clip.mounts.swap(1, 2);
            external
        }
        "other-eye" => {
            for frame in 0..FRAMES {
                let mut views = episode.render_cameras(FIRST + frame, &[external + 3]);
                clip.images[external][frame] = views.remove(0).rgb;
            }
            external
        }
        "wrong-pose" => {
            clip.move_camera(external, off(seed));
            external
        }
        "wrong-hand-eye" => {
            clip.move_camera(0, off(seed));
            0
        }
        "wrist-drift" => {
            // The images' camera drifts: seen from the frame of the images, the states' poses drift the other way.
            let by = off(seed);
            let (axis, angle) = by.quaternion().to_axis_angle();
            let poses: Vec<Pose<Base, Camera>> = (0..FRAMES)
                .map(|frame| {
                    let part = frame as f64 / (FRAMES - 1) as f64;
                    let drift = Pose::new(
                        rogs_geometry::rotation_about_axis(axis, angle * part),
                        by.translation * part,
                    );
                    episode.base_from_camera(0, FIRST + frame) * drift
                })
                .collect();
            for (frame, pose) in poses.iter().enumerate() {
                clip.images[0][frame] = render_from(episode, 0, FIRST + frame, pose);
            }
            0
        }
        "camera-moved" => {
            let from = 6 + (seed as usize) % 5;
            for frame in from..FRAMES {
                let pose = episode.base_from_camera(external, FIRST + frame) * off(seed);
                clip.images[external][frame] = render_from(episode, external, FIRST + frame, &pose);
            }
            external
        }
        "time-offset" => {
            let delay = [3, -3, 4, -4][(seed as usize) % 4];
            let at = |frame: usize| (FIRST as i64 + frame as i64 + delay) as usize;
            clip.states = (0..FRAMES).map(|frame| episode.states[at(frame)]).collect();
            external
        }
        "unscaled-intrinsics" => {
            let k = &mut clip.lenses[external].intrinsics;
            let factor = 1280.0 / 280.0;
            (k.fx, k.fy, k.cx, k.cy) = (k.fx * factor, k.fy * factor, k.cx * factor, k.cy * factor);
            external
        }
        "transposed-intrinsics" => {
            let k = &mut clip.lenses[external].intrinsics;
            (k.fx, k.fy, k.cx, k.cy) = (k.fy, k.fx, k.cy, k.cx);
            external
        }
        "distortion" => {
            let lens = clip.lenses[external];
            let k1 = -0.25;
            clip.change_images(external, |column, row| {
                // The ideal point whose distorted image this pixel is.
                let ray = lens.ray(column as u32, row as u32);
                let (mut x, mut y) = (ray.x, ray.y);
                for _ in 0..20 {
                    let factor = 1.0 + k1 * (x * x + y * y);
                    (x, y) = (ray.x / factor, ray.y / factor);
                }
                let p = DVec2::new(
                    x * lens.intrinsics.fx + lens.intrinsics.cx,
                    y * lens.intrinsics.fy + lens.intrinsics.cy,
                );
                (p.x.max(0.0) as usize, p.y.max(0.0) as usize)
            });
            external
        }
        "gripper-sense" => {
            clip.states
                .iter_mut()
                .for_each(|state| state.gripper = 1.0 - state.gripper);
            0
        }
        "gripper-range" => {
            clip.states.iter_mut().for_each(|state| state.gripper *= 0.25);
            0
        }
        "joint-order" => {
            clip.states.iter_mut().for_each(|state| state.joints.reverse());
            external
        }
        "joint-unit" => {
            clip.states
                .iter_mut()
                .for_each(|state| state.joints = state.joints.map(f64::to_degrees));
            external
        }
        "mirrored-image" => {
            let width = clip.lenses[external].width as usize;
            clip.change_images(external, |column, row| (width - 1 - column, row));
            external
        }
        _ => external,
    }
}

/// The picture of a camera of an episode that stands elsewhere.
fn render_from(episode: &Episode, camera: usize, frame: usize, pose: &Pose<Base, Camera>) -> Vec<u8> {
    let mut elsewhere = episode.clone();
    elsewhere.cameras[camera].mount = rogs_synth::Mount::Fixed(*pose);
    elsewhere.render_cameras(frame, &[camera]).remove(0).rgb
}

/// Plants every kind in the episodes of some seeds: clips, flagged, named right, by kind; false alarms are cameras of
/// right clips that are not good. `ROGS_AUDIT_KINDS` takes some.
fn sweep(seeds: std::ops::Range<u64>) -> Vec<(&'static str, [usize; 3])> {
    let machine = Machine::new();
    let mut out = Vec::new();
    let clips: Vec<_> = seeds.clone().map(|seed| Clip::of(&machine, seed)).collect();
    let only = std::env::var("ROGS_AUDIT_KINDS").unwrap_or_default();
    for kind in KINDS {
        if !only.is_empty() && !only.split(',').any(|own| own == kind) {
            continue;
        }
        let mut counts = [0; 3];
        for (seed, (clip, episode)) in seeds.clone().zip(&clips) {
            let mut planted = Clip {
                images: clip.images.clone(),
                lenses: clip.lenses.clone(),
                mounts: clip.mounts.clone(),
                states: clip.states.clone(),
            };
            let camera = plant(kind, &mut planted, episode, seed);
            let start = std::time::Instant::now();
            let found = planted.audit(&machine);
            let seconds = start.elapsed().as_secs_f64();
            let bad = |index: usize| [Verdict::Wrong, Verdict::Suspect].contains(&found[index].verdict);
            if kind == "right" {
                counts[0] += 3;
                counts[1] += (0..3).filter(|&index| bad(index)).count();
            } else {
                counts[0] += 1;
                counts[1] += usize::from(bad(camera));
                let named = found[camera].mistake.as_ref().map(|mistake| mistake.name());
                counts[2] += usize::from(named == Some(kind));
            }
            println!("{kind} seed {seed} ({seconds:.2} s):");
            for camera in &found {
                let mistake = camera.mistake.as_ref().map(ToString::to_string).unwrap_or_default();
                let tried: Vec<String> = camera
                    .tried
                    .iter()
                    .take(3)
                    .map(|t| format!("{} {:.2}", t.mistake.name(), t.overlay))
                    .collect();
                println!(
                    "    {} {} overlay {:.2} offset {:.1?} {mistake} {:?} [{}]",
                    camera.camera,
                    camera.verdict.name(),
                    camera.overlay,
                    camera.offset,
                    camera.why,
                    tried.join(", ")
                );
            }
        }
        println!("== {kind}: {counts:?}");
        out.push((kind, counts));
    }
    out
}

/// Episodes of each kind: `ROGS_AUDIT_EPISODES`, else 1.
fn episodes() -> std::ops::Range<u64> {
    let asked = std::env::var("ROGS_AUDIT_EPISODES")
        .ok()
        .map(|count| count.parse().unwrap());
    0..asked.unwrap_or(1)
}

#[test]
fn planted_mistakes_are_found_and_named() {
    let table = sweep(episodes());
    let mut sums = [0; 3];
    for (kind, [clips, flagged, named]) in &table {
        println!("{kind}: {flagged} of {clips} flagged, {named} named right");
        if *kind != "right" {
            sums = [sums[0] + clips, sums[1] + flagged, sums[2] + named];
        }
    }
    println!(
        "all mistakes: {} of {} flagged, {} named right",
        sums[1], sums[0], sums[2]
    );
    for (kind, [clips, flagged, named]) in table {
        let share = |count: usize| count as f64 / clips as f64;
        match kind {
            "right" => assert!(share(flagged) <= 0.02, "{flagged} false alarms"),
            _ => assert!(
                share(flagged) >= 0.95 && share(named) >= 0.9,
                "{kind}: {flagged}, {named} of {clips}"
            ),
        }
    }
}
