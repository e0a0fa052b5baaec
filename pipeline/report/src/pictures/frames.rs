//! Frames of a clip: their images and maps, which ones are shown, how they are listed.

use rogs_schemas::records::clip::{Clip, ClipCamera};
use rogs_schemas::records::robot::{RobotMap, RobotMaps};

use super::picture::Picture;

/// At most this many query times are shown per camera.
const MAX_TIMES: usize = 4;
/// The image of a camera at a clip frame.
pub(super) fn frame_rgb(clip: &Clip, camera: &ClipCamera, frame: u32) -> Option<Picture> {
    let area = (clip.height * clip.width * 3) as usize;
    let start = frame as usize * area;
    Picture::from_rgb(
        clip.width,
        clip.height,
        camera.rgb.as_deref()?.get(start..start + area)?,
    )
}

/// The robot map of a camera (index) at a clip frame.
pub(super) fn map_at(robot: &RobotMaps, camera: u32, frame: u32) -> Option<&RobotMap> {
    robot.maps.iter().find(|map| map.camera == camera && map.frame == frame)
}

/// At most [`MAX_TIMES`] of the frames, evenly spread, first and last included.
pub(super) fn spread(frames: &[u32]) -> Vec<u32> {
    if frames.len() <= MAX_TIMES {
        return frames.to_vec();
    }
    (0..MAX_TIMES)
        .map(|index| frames[index * (frames.len() - 1) / (MAX_TIMES - 1)])
        .collect()
}

/// Frames with commas.
pub(super) fn join(frames: &[u32]) -> String {
    frames.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_spread_over_the_plan() {
        assert_eq!(spread(&[0, 3, 9]), [0, 3, 9]);
        assert_eq!(spread(&[0, 1, 2, 3, 4, 5, 16]), [0, 2, 4, 16]);
    }
}
