//! AgiBot samples as Genie Envisioner keeps them (`docs/spec/data.md` section 7): PNG frames of a head camera and of one
//! camera a hand, `intrinsic_VIEW.npy`, a camera-to-base pose a step in `extrinsic_VIEW.npy`, and `actions.npy` with the
//! poses of both hands. There are no joints of the arms: each hand is a body that floats, with six joints of its own.

mod cameras;
mod hands;

use std::path::Path;

use rogs_worker::{StageError, StageResult};

use self::cameras::camera;
use self::hands::{actions, hands, states};
use crate::calibration::Calibration;
use crate::checks;
use crate::fault::{io_error, wrong};
use crate::params::StateColumns;
use crate::source::Source;

/// Name of the layout, as the clip keeps it.
pub(crate) const LAYOUT: &str = "agibot";
const ACTIONS: &str = "actions.npy";
/// Views in the order of a clip.
const VIEWS: [&str; 3] = ["hand_left", "hand_right", "head"];
/// Frames per second of AgiBot's recordings; the samples do not say.
const FPS: f64 = 30.0;
/// Most steps of a sample.
const MAX_STEPS: usize = 1 << 20;

/// Whether a folder is a sample.
pub(crate) fn is_sample(root: &Path) -> bool {
    root.join(ACTIONS).is_file() && VIEWS.iter().any(|view| images(root, view).is_dir())
}

fn images(root: &Path, view: &str) -> std::path::PathBuf {
    root.join(format!("{view}_color"))
}

/// Frames of a sample, for the list.
pub(crate) fn frames(root: &Path) -> Option<u64> {
    let view = VIEWS.iter().find(|view| images(root, view).is_dir())?;
    count(&images(root, view)).ok().map(u64::from)
}

/// The error for AgiBot World as it was released, which is another form; `None` for all other folders.
pub(crate) fn refusal(root: &Path) -> Option<StageError> {
    let parts = ["observations", "proprio_stats"];
    parts.iter().all(|part| root.join(part).is_dir()).then(|| {
        StageError::bad_input(format!(
            "`{}` is AgiBot World as released, which is not read",
            root.display()
        ))
        .with_hint("convert its episodes to episode folders (docs/episode-format.md), poses from `parameters`")
    })
}

/// Opens a sample.
pub(crate) fn open(root: &Path, calibration: Option<&Calibration>, choice: &StateColumns) -> StageResult<Source> {
    let name = root.canonicalize().map_err(|error| io_error(root, &error))?;
    let name = name.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let path = root.join(ACTIONS);
    let (actions, steps) = actions(&path)?;
    let views: Vec<&str> = VIEWS.into_iter().filter(|view| images(root, view).is_dir()).collect();
    let mut warnings = Vec::new();
    for view in VIEWS.iter().filter(|view| !views.contains(view)) {
        warnings.push(format!(
            "camera `{view}` is left out: there is no folder `{view}_color`"
        ));
    }
    let mut counts = views.iter().map(|view| Ok((*view, count(&images(root, view))?)));
    let counts: Vec<(&str, u32)> = counts.by_ref().collect::<StageResult<_>>()?;
    let Some(&(first, frame_count)) = counts.first() else {
        return Err(wrong(root, "it has no folder of images, e.g. `head_color`"));
    };
    if let Some((view, other)) = counts.iter().find(|(_, count)| *count != frame_count) {
        let what = format!("`{first}_color` has {frame_count} images, `{view}_color` {other}");
        return Err(wrong(root, what));
    }
    if frame_count == 0 || frame_count as usize > steps {
        let what = format!("it has {steps} steps for {frame_count} images");
        return Err(wrong(&path, what).with_hint("every image `K.png` needs its step K"));
    }
    if (frame_count as usize) < steps {
        warnings.push(format!(
            "`{}` has {steps} steps for {frame_count} images: image K is taken with step K, which the sample does not say",
            path.display()
        ));
    }
    warnings.push(format!(
        "the sample does not say its frame rate: {FPS} frames per second are taken"
    ));
    let hands = hands(&actions, frame_count as usize, &path)?;
    let cameras = views
        .iter()
        .map(|view| camera(root, view, &hands, (frame_count, steps), calibration));
    let cameras = cameras.collect::<StageResult<_>>()?;
    let states = states(&hands, choice, &path, &mut warnings)?;
    Ok(Source {
        episode_id: checks::episode_id(&name, root)?,
        layout: LAYOUT,
        task: String::new(),
        calibration_note: calibration.map_or_else(
            || "published with the sample (intrinsic and extrinsic arrays)".to_owned(),
            Calibration::note,
        ),
        fps: FPS,
        frame_count,
        cameras,
        states,
        tracks: None,
        cameras_chosen: false,
        warnings,
    })
}

/// PNG files `0.png`, `1.png`, ... of a folder, of which none may be missing.
fn count(folder: &Path) -> StageResult<u32> {
    let entries = rogs_files::entries(folder).map_err(|error| io_error(folder, &error))?;
    let number = |entry: std::io::Result<std::fs::DirEntry>| {
        let name = entry.ok()?.file_name().into_string().ok()?;
        name.strip_suffix(".png")?.parse::<u32>().ok()
    };
    let numbers: Vec<u32> = entries.filter_map(number).take(MAX_STEPS).collect();
    let count = numbers.len() as u32;
    if numbers.iter().any(|&number| number >= count) {
        let what = format!("its {count} images are not numbered from `0.png` on without a gap");
        return Err(wrong(folder, what));
    }
    Ok(count)
}
