//! Clips of procedural episodes in memory.
#![allow(dead_code, reason = "each test uses a part")]

use std::ops::Range;

use rogs_agreement::audit::{Filmed, Footage, Mount};
use rogs_geometry::{Camera, Link, Pinhole, Pose};
use rogs_synth::{ARM_JOINT_NAMES, Episode, SynthConfig, generate_episode};

use crate::common::Machine;

/// Frames of a clip, and the first of them in its episode.
pub(crate) const FRAMES: usize = 17;
const FIRST: usize = 7;

/// A clip whose cameras and states can be changed.
pub(crate) struct Clip {
    pub(crate) images: Vec<Vec<Vec<u8>>>,
    pub(crate) lenses: Vec<Pinhole>,
    pub(crate) mounts: Vec<Mount>,
    pub(crate) positions: Vec<f64>,
    pub(crate) gripper: Vec<f64>,
    names: Vec<String>,
}

impl Clip {
    /// Frames 7 to 23 of the wrist camera and the two beside the robot.
    pub(crate) fn of(machine: &Machine, seed: u64) -> Self {
        Self::delayed(machine, seed, 0)
    }

    /// The same with the states of `delay` frames later.
    pub(crate) fn delayed(machine: &Machine, seed: u64, delay: i64) -> Self {
        let states = (FIRST as i64 + delay) as usize;
        Self::filmed(machine, seed, FIRST..FIRST + FRAMES, states..states + FRAMES)
    }

    /// All frames of an episode.
    pub(crate) fn whole(machine: &Machine, seed: u64) -> Self {
        let frames = 0..SynthConfig::default().frames as usize;
        Self::filmed(machine, seed, frames.clone(), frames)
    }

    fn filmed(machine: &Machine, seed: u64, frames: Range<usize>, states: Range<usize>) -> Self {
        let episode = generate_episode(&SynthConfig::default(), seed).unwrap();
        let mut images = vec![Vec::new(); 3];
        for frame in frames {
            for (camera, view) in episode.render_cameras(frame, &[0, 1, 2]).into_iter().enumerate() {
                images[camera].push(view.rgb);
            }
        }
        let states = &episode.states[states];
        Self {
            images,
            lenses: (0..3).map(|camera| episode.cameras[camera].lens).collect(),
            mounts: vec![
                hand(machine, &episode),
                Mount::Fixed(episode.base_from_camera(1, 0)),
                Mount::Fixed(episode.base_from_camera(2, 0)),
            ],
            positions: states.iter().flat_map(|state| state.joints).collect(),
            gripper: states.iter().map(|state| state.gripper).collect(),
            names: ARM_JOINT_NAMES.map(str::to_owned).to_vec(),
        }
    }

    pub(crate) fn footage<'a>(&'a self, machine: &'a Machine) -> Footage<'a> {
        let cameras = ["wrist", "ext1", "ext2"].into_iter().enumerate();
        Footage {
            model: &machine.model,
            scene: &machine.scene,
            spec: &machine.spec,
            joint_names: &self.names,
            positions: &self.positions,
            gripper: &self.gripper,
            cameras: cameras
                .map(|(index, name)| Filmed {
                    name,
                    lens: self.lenses[index],
                    mount: self.mounts[index].clone(),
                    images: self.images[index].iter().map(Vec::as_slice).collect(),
                })
                .collect(),
        }
    }
}

fn hand(machine: &Machine, episode: &Episode) -> Mount {
    let link = machine.model.link_id("panda_link8").unwrap();
    let links = machine.links(&episode.states[0]);
    let link_from_camera: Pose<Link, Camera> = links[link].inverse() * episode.base_from_camera(0, 0);
    Mount::Hand { link, link_from_camera }
}
