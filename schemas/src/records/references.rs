//! References made by the pipeline itself, for clips that come without.

use super::check::{Check, area, ascending_frames, count, ensure, product};
use super::clip::{Clip, DepthReference, Tracks};
use super::origin::ReferenceOrigin;
use crate::ids::ClipId;
use crate::index::{CameraIndex, FrameIndex};

/// Written by `references`: depth from stereo pairs and robot tracks from kinematics (`docs/spec/references.md`). What is not
/// in it stays as the clip has it.
#[derive(Debug, Clone, PartialEq)]
pub struct References {
    /// The clip this belongs to.
    pub clip_id: ClipId,
    /// Number of frames of the clip.
    pub frame_count: u32,
    /// Height of the clip's images, pixels.
    pub height: u32,
    /// Width of the clip's images, pixels.
    pub width: u32,
    /// Clip frames that depth was made for, ascending: those at which a field is scored or lifted.
    pub frames: Vec<FrameIndex>,
    /// Depth of some cameras, cameras ascending.
    pub depth: Vec<MadeDepth>,
    /// Tracks, where they were made.
    pub tracks: Option<Tracks>,
    /// What a person should know: which camera has no depth, and why.
    pub notes: Vec<String>,
}

/// Depth of one camera at [`References::frames`].
#[derive(Debug, Clone, PartialEq)]
pub struct MadeDepth {
    /// Index into the clip's cameras.
    pub camera: CameraIndex,
    /// Camera-z depth, metres, NaN where unknown. `[frames, H, W]`
    pub depth_m: Vec<f32>,
    /// Depths outside this open interval are not scored, metres.
    pub range_m: [f32; 2],
    /// What made it.
    pub origin: ReferenceOrigin,
}

impl References {
    /// Puts these references into their clip, in the place of what it has there.
    ///
    /// # Errors
    /// When they are of another clip, in words.
    pub fn complete(self, clip: &mut Clip) -> Check {
        ensure(self.clip_id == clip.clip_id, || {
            format!(
                "the references are of clip `{}`, not of `{}`",
                self.clip_id, clip.clip_id
            )
        })?;
        let found = [self.frame_count as usize, self.height as usize, self.width as usize];
        let expected = [clip.frame_count(), clip.height as usize, clip.width as usize];
        ensure(found == expected, || {
            format!("the references have {found:?} frames, rows and columns, the clip {expected:?}")
        })?;
        let area = area(self.height, self.width)?;
        for made in self.depth {
            let cameras = clip.cameras.len();
            let camera = clip.cameras.get_mut(made.camera.at());
            let camera = camera.ok_or_else(|| format!("there is depth of camera {} of {cameras}", made.camera))?;
            let mut depth_m = vec![f32::NAN; self.frame_count as usize * area];
            for (&frame, map) in self.frames.iter().zip(made.depth_m.chunks_exact(area)) {
                depth_m[frame.at() * area..][..area].copy_from_slice(map);
            }
            camera.depth = Some(DepthReference {
                depth_m,
                range_m: made.range_m,
                origin: made.origin,
            });
        }
        if let Some(tracks) = self.tracks {
            tracks.check(clip.cameras.len(), clip.frame_count())?;
            clip.tracks = Some(tracks);
        }
        Ok(())
    }

    /// The arrays agree with the counts, and every number is possible.
    ///
    /// # Errors
    /// What contradicts what, in words.
    pub fn check(&self) -> Check {
        let area = area(self.height, self.width)?;
        let frames = self.frame_count as usize;
        ensure((1..=65_536).contains(&frames), || format!("{frames} frames"))?;
        ascending_frames("frames with depth", &self.frames, frames)?;
        let ascending = self.depth.is_sorted_by(|a, b| a.camera < b.camera);
        ensure(ascending, || "the cameras with depth do not ascend".into())?;
        for made in &self.depth {
            let here = |what: String| format!("depth of camera {}: {what}", made.camera);
            ensure(made.camera.at() < 255, || here("there is no such camera".into()))?;
            let values = product("depth", &[self.frames.len(), area])?;
            count("depth", made.depth_m.len(), values).map_err(here)?;
            let [near, far] = made.range_m;
            ensure(near.is_finite() && far.is_finite() && near < far, || {
                here(format!("its range is {near} to {far}"))
            })?;
        }
        match &self.tracks {
            None => Ok(()),
            Some(tracks) => tracks.check(255, frames),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::index::EpisodeFrame;
    use crate::pose::{Intrinsics, RigidPose};
    use crate::records::clip::{CameraMount, CameraRole, ClipCamera, RobotStates};

    fn clip() -> Clip {
        let camera = |id: &str| ClipCamera {
            id: id.into(),
            role: CameraRole::Source,
            partner: None,
            intrinsics: Intrinsics {
                fx: 2.0,
                fy: 2.0,
                cx: 1.0,
                cy: 0.5,
            },
            mount: CameraMount::Fixed {
                base_from_camera: RigidPose::IDENTITY,
            },
            recorded: None,
            generated: None,
            depth: Some(DepthReference {
                depth_m: vec![1.0; 6],
                range_m: [0.1, 5.0],
                origin: ReferenceOrigin::FoundationStereo,
            }),
        };
        Clip {
            clip_id: "clip".parse().unwrap(),
            episode_id: "clip".into(),
            layout: "rogs-episode".into(),
            task: String::new(),
            calibration_note: String::new(),
            fps: 5.0,
            episode_frames: EpisodeFrame::first(3).collect(),
            source_frames: vec![FrameIndex(0)],
            query_frames: vec![FrameIndex(2)],
            anchor_frame: FrameIndex(0),
            height: 1,
            width: 2,
            cameras: vec![camera("wrist"), camera("ext1")],
            robot: RobotStates {
                joint_names: vec![],
                positions: vec![],
                gripper: vec![0.0; 3],
            },
            tracks: None,
            rollout: None,
        }
    }

    fn references() -> References {
        References {
            clip_id: "clip".parse().unwrap(),
            frame_count: 3,
            height: 1,
            width: 2,
            frames: vec![FrameIndex(0), FrameIndex(2)],
            depth: vec![MadeDepth {
                camera: CameraIndex(1),
                depth_m: vec![0.5, 0.6, 0.7, f32::NAN],
                range_m: [0.2, 4.0],
                origin: ReferenceOrigin::ClassicalStereo,
            }],
            tracks: None,
            notes: vec![],
        }
    }

    #[test]
    fn what_was_made_replaces_and_the_rest_stays() {
        let mut clip = clip();
        references().check().unwrap();
        references().complete(&mut clip).unwrap();
        let depth = |camera: usize| clip.cameras[camera].depth.as_ref().unwrap();
        assert_eq!(depth(0).origin, ReferenceOrigin::FoundationStereo);
        assert_eq!(
            (depth(1).origin, depth(1).range_m),
            (ReferenceOrigin::ClassicalStereo, [0.2, 4.0])
        );
        assert_eq!(depth(1).depth_m[..2], [0.5, 0.6]);
        assert!(
            depth(1).depth_m[2..4].iter().all(|value| value.is_nan()),
            "no depth was made there"
        );
        assert_eq!(depth(1).depth_m[4], 0.7);
        clip.check().unwrap();
    }

    #[test]
    fn references_of_another_clip_are_refused() {
        let other = References {
            clip_id: "other".parse().unwrap(),
            ..references()
        };
        assert!(other.complete(&mut clip()).unwrap_err().contains("`other`"));
        let longer = References {
            frame_count: 4,
            ..references()
        };
        assert!(longer.complete(&mut clip()).unwrap_err().contains("[4, 1, 2]"));
        let mut beyond = references();
        beyond.depth[0].camera = CameraIndex(7);
        assert!(beyond.complete(&mut clip()).unwrap_err().contains("camera 7 of 2"));
    }
}
