//! The records that the pipeline's stages would make of a procedural clip, without files: for training of Stage 2, and to
//! hold the training clips against the stages themselves.

use rogs_schemas::records::clip::{
    CameraMount, CameraRole, Clip, ClipCamera, DepthReference, PROCEDURAL_NOTE, RobotStates, Tracks,
};
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_schemas::records::robot::{RobotMap, RobotMaps};
use rogs_schemas::{CameraIndex, ClipId, EpisodeFrame, FrameIndex};
use rogs_synth::{ARM_JOINT_NAMES, CAMERA_NAMES, CAMERAS, FIRST_OBJECT_ID, View};

use crate::builder::{ClipBuilder, DEPTH_RANGE_M};
use crate::config::DataSettings;
use crate::error::Result;
use crate::plan::ClipPlan;
use crate::plan::SOURCE_CAMERAS;

/// The records of one clip.
#[derive(Debug, Clone, PartialEq)]
pub struct Records {
    /// Cameras, images and states. Only frames that the plan names have images.
    pub clip: Clip,
    /// Where robot and cameras are. Maps are those of the source views.
    pub robot: RobotMaps,
    /// How the robot moves.
    pub conditioning: Conditioning,
}

impl ClipPlan {
    /// The records that the pipeline would make of the clip.
    ///
    /// # Errors
    /// As [`Self::sample`].
    pub fn records(&self, data: &DataSettings) -> Result<Records> {
        let episode = self.episode(data)?;
        ClipBuilder::new(self, data, &episode).records()
    }
}

impl ClipBuilder<'_> {
    /// The records of the clip.
    pub(crate) fn records(&self) -> Result<Records> {
        let (clip, views) = self.clip();
        let robot = self.robot(&clip, &views);
        let conditioning = rogs_conditioning::build(&clip, &robot, &rogs_conditioning::Params::default())?;
        Ok(Records {
            clip,
            robot,
            conditioning,
        })
    }

    /// The clip, and the pictures of the source cameras at the source frames.
    fn clip(&self) -> (Clip, Vec<Vec<View>>) {
        let [height, width] = self.plan.size;
        let (area, frames) = (height as usize * width as usize, self.data.clip_frames as usize);
        let mut wanted: Vec<FrameIndex> = self.plan.sources.iter().chain(&self.plan.queries).copied().collect();
        wanted.sort_unstable();
        wanted.dedup();
        let mut rgb = vec![vec![0u8; 3 * area * frames]; CAMERAS];
        let mut depth = vec![vec![f32::NAN; area * frames]; CAMERAS];
        let mut sources: Vec<Vec<View>> = Vec::new();
        for &frame in &wanted {
            let views = self.episode.render_frame(self.frame(frame)).views;
            for (camera, view) in views.iter().enumerate() {
                rgb[camera][frame.at() * 3 * area..][..3 * area].copy_from_slice(&view.rgb);
                depth[camera][frame.at() * area..][..area].copy_from_slice(&view.depth_m);
            }
            if self.plan.sources.contains(&frame) {
                sources.push(views.into_iter().take(SOURCE_CAMERAS).collect());
            }
        }
        let mut images = rgb.into_iter().zip(depth);
        let camera = |index: usize| ClipCamera {
            id: CAMERA_NAMES[index].to_owned(),
            role: if index < SOURCE_CAMERAS {
                CameraRole::Source
            } else {
                CameraRole::Evaluation
            },
            partner: index
                .checked_sub(SOURCE_CAMERAS)
                .map(|partner| CameraIndex(partner as u32)),
            intrinsics: self.episode.cameras[index].recorded_lens.intrinsics,
            mount: CameraMount::Trajectory {
                base_from_camera: FrameIndex::first(frames)
                    .map(|frame| self.recorded(index, self.frame(frame)).to_rigid())
                    .collect(),
            },
            recorded: None,
            generated: None,
            depth: None,
        };
        let cameras = (0..CAMERAS).map(|index| {
            let (rgb, depth_m) = images.next().unwrap_or_default();
            ClipCamera {
                recorded: Some(rgb),
                depth: Some(DepthReference {
                    depth_m,
                    range_m: DEPTH_RANGE_M,
                    origin: ReferenceOrigin::Exact,
                }),
                ..camera(index)
            }
        });
        let states = (0..frames).map(|frame| &self.episode.states[self.plan.first.at() + frame]);
        let clip = Clip {
            clip_id: ClipId::made_of(&self.episode.id()),
            episode_id: self.episode.id(),
            layout: "procedural".into(),
            task: self.episode.task(),
            calibration_note: PROCEDURAL_NOTE.into(),
            fps: self.episode.config.fps,
            episode_frames: (0..self.data.clip_frames)
                .map(|frame| EpisodeFrame(self.plan.first.0 + frame))
                .collect(),
            source_frames: self.plan.sources.clone(),
            query_frames: self.plan.queries.clone(),
            anchor_frame: self.plan.sources[0],
            height,
            width,
            cameras: cameras.collect(),
            robot: RobotStates {
                joint_names: match &self.episode.guest {
                    None => ARM_JOINT_NAMES.map(str::to_owned).to_vec(),
                    Some(guest) => guest.joint_names.clone(),
                },
                positions: match &self.episode.guest {
                    None => states.clone().flat_map(|state| state.joints).collect(),
                    Some(guest) => guest.joints[self.plan.first.at()..][..frames].concat(),
                },
                gripper: states.map(|state| state.gripper).collect(),
            },
            tracks: Some(self.tracks(&sources[0])),
            rollout: None,
        };
        (clip, sources)
    }

    /// Tracks that start at the first source time; `anchor` are the pictures of the source cameras then.
    fn tracks(&self, anchor: &[View]) -> Tracks {
        let all = self.episode.tracks(anchor);
        let (first, frames) = (self.plan.first.at(), self.data.clip_frames as usize);
        let episode_frames = self.episode.frame_count();
        let cut = |values: &[f32], per: usize| -> Vec<f32> {
            values
                .chunks_exact(per * episode_frames)
                .flat_map(|track| track[per * first..per * (first + frames)].iter().copied())
                .collect()
        };
        Tracks {
            anchor_frame: self.plan.sources[0],
            camera: all.camera.into_iter().map(CameraIndex).collect(),
            pixel: all.pixel.iter().flatten().map(|&place| place as f32).collect(),
            position_m: cut(&all.position_m, 3),
            visible: (all.visible.chunks_exact(episode_frames))
                .flat_map(|track| track[first..first + frames].iter().copied())
                .collect(),
            origin: ReferenceOrigin::Exact,
        }
    }

    fn robot(&self, clip: &Clip, sources: &[Vec<View>]) -> RobotMaps {
        let frames = FrameIndex::first(self.data.clip_frames as usize);
        let count = (0..FIRST_OBJECT_ID)
            .take_while(|&id| self.episode.body_pose(id, 0).is_some())
            .count() as u8;
        let link_poses = frames.clone().flat_map(|frame| {
            (0..count).filter_map(move |id| {
                self.episode
                    .body_pose(id, self.frame(frame))
                    .map(|pose| pose.to_rigid())
            })
        });
        let maps = clip.source_views().into_iter().map(|view| {
            let time = self.plan.sources.iter().position(|&frame| frame == view.frame);
            let picture = &sources[time.unwrap_or(0)][view.camera.at()];
            let seen = self.robot_seen(picture, view.camera.at(), self.frame(view.frame));
            RobotMap {
                camera: view.camera,
                frame: view.frame,
                depth_m: seen.depth_m,
                link: seen.link,
                support: seen.support,
            }
        });
        RobotMaps {
            clip_id: clip.clip_id.clone(),
            link_names: (0..count).map(|id| format!("link{id}")).collect(),
            base_from_link: link_poses.collect(),
            base_from_camera: (0..CAMERAS)
                .flat_map(|camera| frames.clone().map(move |frame| (camera, frame)))
                .map(|(camera, frame)| self.recorded(camera, self.frame(frame)).to_rigid())
                .collect(),
            recon_from_base: self.recon_from_base.to_rigid(),
            tool_m: frames
                .clone()
                .flat_map(|frame| self.episode.tool(self.frame(frame)).to_array())
                .collect(),
            height: clip.height,
            width: clip.width,
            maps: maps.collect(),
        }
    }
}
