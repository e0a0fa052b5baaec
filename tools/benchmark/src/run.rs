//! What a run folder holds of each clip.

use std::path::Path;

use anyhow::{Context as _, ensure};
use rogs_r4c::read_record;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::{RenderedView, Scores};
use rogs_schemas::{CameraIndex, FrameIndex};

/// A clip with all that was scored on it.
pub(crate) struct ScoredClip {
    pub(crate) clip: Clip,
    pub(crate) robot: RobotMaps,
    /// One of each method.
    pub(crate) scores: Vec<Scores>,
}

/// Reads the clips of a run that have scores, by name.
pub(crate) fn read(run: &Path) -> anyhow::Result<Vec<ScoredClip>> {
    let folder = run.join("clips");
    let mut folders = paths(&folder).with_context(|| format!("reading `{}`", folder.display()))?;
    folders.retain(|path| path.is_dir());
    let mut clips = Vec::new();
    for folder in folders {
        // Those of variants lie in folders named by their keys.
        let mut places = paths(&folder)?;
        for inner in places.clone().iter().filter(|path| path.is_dir()) {
            places.extend(paths(inner)?);
        }
        let mut scores: Vec<Scores> = Vec::new();
        for path in places {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
            if !name.is_some_and(|name| name.starts_with("scores") && name.ends_with(".r4c")) {
                continue;
            }
            let (read, _) = read_record::<Scores>(&path)?;
            let method = &read.summary.method;
            ensure!(
                scores.iter().all(|other| other.summary.method != *method),
                "`{}` has scores of `{method}` twice: remove the older ones with `rogs gc {}`",
                folder.display(),
                run.display()
            );
            scores.push(read);
        }
        if !scores.is_empty() {
            clips.push(ScoredClip {
                clip: read_record(&folder.join("clip.r4c"))?.0,
                robot: read_record(&folder.join("robot.r4c"))?.0,
                scores,
            });
        }
    }
    ensure!(!clips.is_empty(), "`{}` has no scores", run.display());
    Ok(clips)
}

fn paths(folder: &Path) -> std::io::Result<Vec<std::path::PathBuf>> {
    let mut paths: Vec<_> = rogs_files::entries(folder)?
        .map(|entry| entry.map(|entry| entry.path()))
        .collect::<std::io::Result<_>>()?;
    paths.sort();
    Ok(paths)
}

impl ScoredClip {
    /// The scores of a method.
    pub(crate) fn of(&self, method: &str) -> Option<&Scores> {
        self.scores.iter().find(|scores| scores.summary.method == method)
    }

    /// Reference depth of a camera at a frame, metres, NaN where unknown, and the range that is scored. `[H, W]`
    pub(crate) fn reference_depth(&self, camera: CameraIndex, frame: FrameIndex) -> Option<(&[f32], [f32; 2])> {
        let reference = self.clip.cameras.get(camera.at())?.depth.as_ref()?;
        let area = self.clip.height as usize * self.clip.width as usize;
        let depth = reference.depth_m.get(frame.at() * area..(frame.at() + 1) * area)?;
        Some((depth, reference.range_m))
    }

    /// Kept renders of the clip's source times with their cameras.
    pub(crate) fn renders<'a>(
        &'a self,
        scores: &'a Scores,
    ) -> impl Iterator<Item = (CameraIndex, &'a RenderedView)> + 'a {
        let known = |view: &RenderedView| self.clip.source_frames.contains(&view.frame);
        let renders = scores.renders.iter().filter(move |view| known(view));
        renders.filter_map(|view| {
            let mut cameras = self.clip.cameras.iter();
            let at = cameras.position(|camera| camera.id == view.camera)?;
            Some((CameraIndex(u32::try_from(at).ok()?), view))
        })
    }
}
