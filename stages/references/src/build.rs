//! From a clip and its robot maps to references.

use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::references::References;
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::{Observer, StageError, StageResult};

use crate::params::Params;
use crate::{stereo, tracks};

/// Makes the references of a clip; `observer` hears what a person should know, which the record keeps too.
///
/// # Errors
/// When clip and robot maps do not belong together, or the parameters mean nothing. A pair that cannot be matched is no
/// error: its cameras have no depth, and a note says why.
pub fn build(clip: &Clip, robot: &RobotMaps, params: &Params, observer: &mut dyn Observer) -> StageResult<References> {
    params.check()?;
    check(clip, robot)?;
    let frames = clip.field_frames();
    let mut notes = Vec::new();
    let depth = observer.phase("stereo", 0.0, || stereo::make(clip, robot, &frames, params, &mut notes))?;
    let tracks = observer.phase("tracks", 0.9, || tracks::make(clip, robot, params, &mut notes))?;
    for note in &notes {
        observer.warn(note.clone());
    }
    Ok(References {
        clip_id: clip.clip_id.clone(),
        frame_count: clip.frame_count() as u32,
        height: clip.height,
        width: clip.width,
        frames,
        depth,
        tracks,
        notes,
    })
}

fn check(clip: &Clip, robot: &RobotMaps) -> StageResult<()> {
    let wrong = |what: String| Err(StageError::bad_input(what));
    if robot.clip_id != clip.clip_id {
        return wrong(format!(
            "the robot maps are of clip `{}`, not of `{}`",
            robot.clip_id, clip.clip_id
        ));
    }
    let frames = clip.frame_count();
    let found = [robot.base_from_camera.len(), robot.base_from_link.len()];
    let expected = [frames * clip.cameras.len(), frames * robot.link_names.len()];
    if found != expected {
        return wrong(format!(
            "the robot maps have {found:?} camera and link poses, the clip asks for {expected:?}"
        ));
    }
    if (robot.height, robot.width) != (clip.height, clip.width) {
        return wrong(format!(
            "the robot maps are {}x{} pixels, the clip {}x{} (height x width)",
            robot.height, robot.width, clip.height, clip.width
        ));
    }
    Ok(())
}
