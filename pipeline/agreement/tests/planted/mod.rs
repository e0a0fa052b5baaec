//! Mistakes planted in procedural clips, and what the audit says of them.
#![allow(dead_code, reason = "each target uses a part")]

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Instant;

use glam::{DVec2, DVec3};
use rogs_agreement::audit::{CameraAudit, Filmed, Footage, Mount, Verdict, audit};
use rogs_geometry::{Base, Camera, Link, Pinhole, Pose};
use rogs_synth::{ARM_JOINT_NAMES, Episode, RobotState, SynthConfig, generate_episode};

use crate::common::Machine;

const FRAMES: usize = 17;
const FIRST: usize = 7;

/// A clip in memory that mistakes are planted in.
#[derive(Clone)]
pub(crate) struct Clip {
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
    pub(crate) fn of(machine: &Machine, seed: u64) -> (Self, Episode) {
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

    pub(crate) fn audit(&self, machine: &Machine) -> Vec<CameraAudit> {
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

/// What is planted; `right` is nothing.
pub(crate) const KINDS: [&str; 17] = [
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
pub(crate) fn plant(kind: &str, clip: &mut Clip, episode: &Episode, seed: u64) -> usize {
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

/// What the audit said of one clip.
pub(crate) struct Outcome {
    pub(crate) kind: &'static str,
    /// Cameras that are suspect or wrong.
    pub(crate) flagged: usize,
    /// Whether the camera of the mistake is among them.
    pub(crate) found: bool,
    /// What is said of that camera: the mistake's name, or the verdict.
    pub(crate) named: String,
    pub(crate) seconds: f64,
    /// Time of all processors together, where the system tells.
    pub(crate) work: Option<f64>,
}

/// Time that all threads have computed so far, seconds; Linux tells it in ticks of 10 ms.
fn worked() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    let mut after_name = text.rsplit_once(')')?.1.split_whitespace().skip(11);
    let mut ticks = || after_name.next()?.parse::<f64>().ok();
    Some(0.01 * (ticks()? + ticks()?))
}

/// Plants some kinds in an episode; a line of each camera is printed.
#[allow(clippy::print_stdout)]
pub(crate) fn outcomes(machine: &Machine, kinds: &[&'static str], seed: u64) -> Vec<Outcome> {
    let (clip, episode) = Clip::of(machine, seed);
    let of_kind = |&kind: &&'static str| {
        let mut planted = clip.clone();
        let camera = plant(kind, &mut planted, &episode, seed);
        let (start, before) = (Instant::now(), worked());
        let found = planted.audit(machine);
        let seconds = start.elapsed().as_secs_f64();
        let work = worked().zip(before).map(|(after, before)| after - before);
        println!(
            "{kind} seed {seed} ({seconds:.2} s, {:.2} s of work):",
            work.unwrap_or(f64::NAN)
        );
        for (index, own) in found.iter().enumerate() {
            let mistake = own.mistake.as_ref().map(ToString::to_string).unwrap_or_default();
            let tried = own.tried.iter().take(3);
            let tried: Vec<String> = tried
                .map(|tried| format!("{} {:.2}", tried.mistake.name(), tried.overlay))
                .collect();
            println!(
                "   {}{} {} overlay {:.2} offset {:.1?} {mistake} {:?} [{}]",
                if index == camera && kind != "right" { "*" } else { " " },
                own.camera,
                own.verdict.name(),
                own.overlay,
                own.offset,
                own.why,
                tried.join(", ")
            );
        }
        let bad = |own: &CameraAudit| [Verdict::Wrong, Verdict::Suspect].contains(&own.verdict);
        let own = &found[camera];
        let named = own
            .mistake
            .as_ref()
            .map_or(own.verdict.name(), |mistake| mistake.name());
        Outcome {
            kind,
            flagged: found.iter().filter(|own| bad(own)).count(),
            found: bad(own),
            named: named.to_owned(),
            seconds,
            work,
        }
    };
    kinds.iter().map(of_kind).collect()
}

/// Clips, flagged and named right, of one kind; of right clips: cameras, false alarms and 0.
pub(crate) fn counts(outcomes: &[Outcome], kind: &str) -> [usize; 3] {
    let own = outcomes.iter().filter(|outcome| outcome.kind == kind);
    own.fold([0; 3], |[clips, flagged, named], outcome| {
        if kind == "right" {
            [clips + 3, flagged + outcome.flagged, named]
        } else {
            [
                clips + 1,
                flagged + usize::from(outcome.found),
                named + usize::from(outcome.found && outcome.named == kind),
            ]
        }
    })
}

/// The confusion table: a line a kind, with what it was called otherwise, and the times.
pub(crate) fn table(outcomes: &[Outcome]) -> String {
    let mut text = format!(
        "{:24}clips flagged  named  seconds: median, most  of work: median, most  called otherwise\n",
        "planted"
    );
    let mut sums = [0; 3];
    for kind in KINDS {
        let own: Vec<&Outcome> = outcomes.iter().filter(|outcome| outcome.kind == kind).collect();
        if own.is_empty() {
            continue;
        }
        let [clips, flagged, named] = counts(outcomes, kind);
        if kind != "right" {
            sums = [sums[0] + clips, sums[1] + flagged, sums[2] + named];
        }
        let middle_and_most = |of: &dyn Fn(&Outcome) -> f64| {
            let mut values: Vec<f64> = own.iter().map(|outcome| of(outcome)).collect();
            values.sort_by(f64::total_cmp);
            format!("{:7.2} {:7.2}", values[values.len() / 2], values[values.len() - 1])
        };
        let seconds = middle_and_most(&|outcome| outcome.seconds);
        let work = middle_and_most(&|outcome| outcome.work.unwrap_or(f64::NAN));
        let mut others: BTreeMap<&str, usize> = BTreeMap::new();
        let wrong = |outcome: &&&Outcome| outcome.named != kind && (kind != "right" || outcome.flagged > 0);
        for outcome in own.iter().filter(wrong) {
            *others.entry(&outcome.named).or_default() += 1;
        }
        let others: Vec<String> = others.iter().map(|(name, count)| format!("{count} {name}")).collect();
        let _ = writeln!(
            text,
            "{kind:24}{clips:5} {flagged:7} {named:6}  {seconds}        {work}          {}",
            others.join(", ")
        );
    }
    let _ = writeln!(text, "{:24}{:5} {:7} {:6}", "all mistakes", sums[0], sums[1], sums[2]);
    text
}
