//! What an episode's description says to whoever writes a manifest for it; nothing is opened besides the description.

use std::path::Path;

use rogs_schemas::episode::EpisodeCameraRole;
use rogs_worker::StageResult;

use crate::layouts::{ctrlworld, droid, lerobot_outline, rogs_episode};
use crate::listing::EpisodeListing;
use crate::source::EpisodeOutline;

/// The outline of a listed episode.
///
/// # Errors
/// When its description cannot be read.
pub fn outline(root: &Path, episode: &EpisodeListing) -> StageResult<EpisodeOutline> {
    let folder = root.join(&episode.folder);
    if episode.layout == rogs_episode::LAYOUT {
        let found = rogs_episode::read_description(&folder)?;
        let sources = found
            .cameras
            .iter()
            .filter(|camera| camera.role == EpisodeCameraRole::Source);
        return Ok(EpisodeOutline {
            cameras: sources.map(|camera| camera.id.clone()).collect(),
            joints: found.robot.joint_names,
            model: found.robot.model.map(|model| format!("{}/{model}", episode.folder)),
            calibrated: true,
            ..EpisodeOutline::default()
        });
    }
    let panda = || (1..=7).map(|joint| format!("panda_joint{joint}")).collect();
    if episode.layout == droid::LAYOUT || episode.layout == ctrlworld::LAYOUT {
        return Ok(EpisodeOutline {
            cameras: ["wrist", "ext1", "ext2"].map(str::to_owned).to_vec(),
            joints: panda(),
            robot: Some("Franka Panda with a Robotiq 2F-85".to_owned()),
            calibrated: episode.layout == droid::LAYOUT || ctrlworld::is_calibrated(&folder, &episode.selector),
            ..EpisodeOutline::default()
        });
    }
    if episode.layout.starts_with("lerobot") {
        return lerobot_outline(&folder);
    }
    Ok(EpisodeOutline {
        calibrated: true,
        ..EpisodeOutline::default()
    })
}
