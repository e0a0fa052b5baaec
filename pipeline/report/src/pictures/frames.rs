//! Frames of a clip: their images and maps, which ones are shown, how they are listed.

use rogs_schemas::records::clip::{Clip, SourceView};
use rogs_schemas::records::robot::{RobotMap, RobotMaps};
use rogs_schemas::{CameraIndex, FrameIndex};

use super::picture::Picture;

/// At most this many query times are shown per camera.
const MAX_TIMES: usize = 4;
/// The recorded image of a camera (index) at a clip frame, which renders are compared with.
pub(super) fn target(clip: &Clip, camera: CameraIndex, frame: FrameIndex) -> Option<Picture> {
    Picture::from_rgb(clip.width, clip.height, clip.target(camera, frame)?.rgb())
}

/// What a source camera (index) shows to whoever reconstructs a clip frame.
pub(super) fn observation(clip: &Clip, camera: CameraIndex, frame: FrameIndex) -> Option<Picture> {
    let view = SourceView { camera, frame };
    Picture::from_rgb(clip.width, clip.height, clip.observation(view)?.rgb())
}

/// The robot map of a camera (index) at a clip frame.
pub(super) fn map_at(robot: &RobotMaps, camera: CameraIndex, frame: FrameIndex) -> Option<&RobotMap> {
    robot.maps.iter().find(|map| map.camera == camera && map.frame == frame)
}

/// At most [`MAX_TIMES`] of the frames, evenly spread, first and last included.
pub(super) fn spread(frames: &[FrameIndex]) -> Vec<FrameIndex> {
    if frames.len() <= MAX_TIMES {
        return frames.to_vec();
    }
    (0..MAX_TIMES)
        .map(|index| frames[index * (frames.len() - 1) / (MAX_TIMES - 1)])
        .collect()
}

/// Frames with commas.
pub(super) fn join(frames: &[FrameIndex]) -> String {
    frames.iter().map(FrameIndex::to_string).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_spread_over_the_plan() {
        let shown = |frames: &[u32]| spread(&frames.iter().copied().map(FrameIndex).collect::<Vec<_>>());
        assert_eq!(shown(&[0, 3, 9]), [0, 3, 9].map(FrameIndex));
        assert_eq!(shown(&[0, 1, 2, 3, 4, 5, 16]), [0, 2, 4, 16].map(FrameIndex));
    }
}
