//! Which mistake of calibration or states explains that the robot does not lie on the images
//! (`docs/spec/agreement.md` section 7).

mod camera;
mod footage;
mod hand;
mod mistake;
mod pictures;
mod states;
mod suppositions;
mod together;
mod trial;
mod watch;

pub use footage::{Filmed, Footage, Mount};
pub use mistake::Mistake;
pub use rogs_schemas::records::agreement::Verdict;

use rayon::prelude::*;

use crate::Result;
use crate::agreement::Why;
use camera::Found;
use footage::evenly;
use suppositions::suppositions_of;
use trial::{Supposed, Trials};
use watch::watch;

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
/// Cameras on whose images the robot lies well are good as they are. For the others, every supposition is looked at in two
/// images of half the size, and the best ones in four whole images; then poses are sought, where none of these puts the
/// robot clearly on the images.
///
/// # Errors
/// When the arrays do not fit together, or the joints do not fit the robot.
pub fn audit(footage: &Footage<'_>) -> Result<Vec<CameraAudit>> {
    footage.check()?;
    let plain = vec![footage.kinematics(footage.positions, footage.gripper)?];
    let steady_images = pictures::steady(footage);
    let steady_footage = pictures::with_steady(footage, &steady_images);
    let given: Vec<Supposed> = footage.cameras.iter().map(camera::given).collect();
    let frames = evenly(footage.frames(), 4);
    let raw = Trials::of(footage, &plain);
    let steady = Trials::of(&steady_footage, &plain);
    let mut found: Vec<Found> = (0..given.len())
        .into_par_iter()
        .map(|index| {
            let watched = watch(&raw, index, &given[index])?;
            let overlay = steady.overlay(index, &given[index], &frames, None);
            Ok(Found::new(&footage.cameras[index], watched, overlay))
        })
        .collect::<Result<_>>()?;
    let doubtful: Vec<usize> = (0..found.len())
        .filter(|&i| !found[i].is_good() && !found[i].is_blank())
        .collect();
    if doubtful.is_empty() {
        together::look_at_gripper(footage, &given, &mut found)?;
        return Ok(found.into_iter().map(Found::verdict).collect());
    }
    together::look_at_clock(&raw, &given, &mut found);
    let half_images = pictures::half_size(&steady_footage);
    let half_footage = pictures::with_half_size(&steady_footage, &half_images);
    // States are wrong for all cameras beside the robot, or for none.
    let beside = (0..found.len()).filter(|&i| !found[i].on_hand && !found[i].is_blank());
    let (readings, tables) = if beside.clone().all(|i| doubtful.contains(&i)) && beside.count() > 0 {
        states::readings(footage)?
    } else {
        (Vec::new(), plain.clone())
    };
    let close = Trials::of(&steady_footage, &tables);
    let rough = Trials {
        half: pictures::can_be_halved(footage),
        ..Trials::of(
            if pictures::can_be_halved(footage) {
                &half_footage
            } else {
                &steady_footage
            },
            &tables,
        )
    };
    let tried: Vec<(usize, Mistake, Supposed)> = (doubtful.iter())
        .flat_map(|&index| suppositions_of(footage, &given, index, &readings))
        .collect();
    let tried = promising(tried, &rough, &given, &frames);
    let looks: Vec<(usize, Supposed)> = (tried.iter())
        .map(|(index, _, supposed)| (*index, supposed.clone()))
        .collect();
    let lengths = close.lengths(&given, &frames);
    let overlays = close.overlays(&looks, &lengths, &frames);
    for ((index, mistake, _), overlay) in tried.into_iter().zip(overlays) {
        found[index].tried.push(Tried { mistake, overlay });
    }
    together::agree_on_states(&mut found);
    together::look_at_gripper(footage, &given, &mut found)?;
    // Under wrong states a hand is not where it is drawn.
    let states_explain = found
        .iter()
        .any(|own| !own.on_hand && own.is_clear() && own.best_is_of_joints());
    for &index in &doubtful {
        let own = &mut found[index];
        if own.is_clear() || (own.explained() && own.best_is_of_gripper()) {
            continue;
        }
        own.refine(&raw, index, &given[index], &frames);
        if !states_explain {
            own.look_at_hand(&raw, &close, &rough, index, &given[index]);
        }
    }
    Ok(found.into_iter().map(Found::verdict).collect())
}

/// Of each camera the suppositions that look best in two rough images; readings of the states that look so in any camera
/// are kept for all.
fn promising(
    tried: Vec<(usize, Mistake, Supposed)>,
    rough: &Trials<'_>,
    given: &[Supposed],
    frames: &[usize],
) -> Vec<(usize, Mistake, Supposed)> {
    /// Suppositions of a camera that are looked at closely.
    const CLOSELY: usize = 6;
    let two = &frames[frames.len() / 4..][..frames.len().min(2)];
    let looks: Vec<(usize, Supposed)> = (tried.iter())
        .map(|(index, _, supposed)| (*index, supposed.clone()))
        .collect();
    let lengths = rough.lengths(given, two);
    let overlays = rough.overlays(&looks, &lengths, two);
    let mut kept = vec![false; tried.len()];
    for camera in 0..given.len() {
        let mut own: Vec<usize> = (0..tried.len()).filter(|&i| tried[i].0 == camera).collect();
        own.sort_by(|&a, &b| overlays[b].total_cmp(&overlays[a]).then(a.cmp(&b)));
        own.iter().take(CLOSELY).for_each(|&i| kept[i] = true);
    }
    let states: Vec<Mistake> = (tried.iter().zip(&kept))
        .filter(|((_, mistake, _), kept)| **kept && mistake.is_of_states())
        .map(|((_, mistake, _), _)| mistake.clone())
        .collect();
    let all = tried.into_iter().zip(kept);
    all.filter(|((_, mistake, _), kept)| *kept || states.contains(mistake))
        .map(|(own, _)| own)
        .collect()
}
