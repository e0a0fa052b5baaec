//! Which mistake of calibration or states explains that the robot does not lie on the images
//! (`docs/spec/agreement.md` section 7).

mod camera;
mod footage;
mod mistake;
mod states;
mod trial;

pub use footage::{Filmed, Footage, Mount};
pub use mistake::Mistake;
pub use rogs_schemas::records::agreement::Verdict;

use crate::Result;
use crate::agreement::Why;
use camera::{Found, all_frames, suppositions_of};
use trial::{Supposed, Trials};

/// A supposition that was tried.
#[derive(Debug, Clone, PartialEq)]
pub struct Tried {
    /// What was supposed.
    pub mistake: Mistake,
    /// Overlay under it: about 0 by chance, 1 for a perfect one.
    pub overlay: f64,
}

/// What was found out about a camera.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraAudit {
    /// Its name.
    pub camera: String,
    /// In short.
    pub verdict: Verdict,
    /// The supposition that fits, where the camera is not good.
    pub mistake: Option<Mistake>,
    /// Overlay as the files say, mean over frames.
    pub overlay: f64,
    /// Median offset over frames, its standard deviation, pixels, and the offset in millimetres; `None` where no frame
    /// tells.
    pub offset: Option<[f64; 3]>,
    /// Why it cannot be told.
    pub why: Option<Why>,
    /// The best suppositions, best first.
    pub tried: Vec<Tried>,
}

/// A supposition must raise the overlay by this much.
pub const GAIN: f64 = 0.12;
/// And to at least this.
pub const FITS: f64 = 0.25;
/// Offsets from here on are suspect, pixels.
pub const SUSPECT_PX: f64 = 1.5;

/// Audits the cameras of a clip.
///
/// # Errors
/// When the arrays do not fit together, or the joints do not fit the robot.
pub fn audit(footage: &Footage<'_>) -> Result<Vec<CameraAudit>> {
    footage.check()?;
    let (readings, tables) = states::readings(footage)?;
    let trials = Trials { footage, tables };
    let given: Vec<Supposed> = footage.cameras.iter().map(camera::given).collect();
    let frames = all_frames(footage.frames(), 4);
    let mut found: Vec<Found> = Vec::new();
    for index in 0..given.len() {
        found.push(Found::of_given(&trials, index, &given[index], &frames));
    }
    let tried: Vec<(usize, Mistake, Supposed)> = (0..given.len())
        .filter(|&index| !found[index].is_blank())
        .flat_map(|index| suppositions_of(footage, &given, index, &readings))
        .collect();
    let looks: Vec<(usize, Supposed)> = tried
        .iter()
        .map(|(index, _, supposed)| (*index, supposed.clone()))
        .collect();
    let overlays = trials.overlays(&looks, &given, &frames);
    for ((index, mistake, _), overlay) in tried.into_iter().zip(overlays) {
        found[index].tried.push(Tried { mistake, overlay });
    }
    camera::agree_on_states(&mut found);
    camera::look_at_gripper(footage, &given, &mut found)?;
    for (index, found) in found.iter_mut().enumerate() {
        found.refine(&trials, index, &given[index], &frames);
    }
    Ok(found.into_iter().map(Found::verdict).collect())
}
