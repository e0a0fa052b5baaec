//! Forms of DROID that cannot be ingested, with why and where to go.

use std::path::Path;

use rogs_worker::StageError;

/// The error for a folder in a form that lacks what a clip needs; `None` for all others.
pub(crate) fn refusal(root: &Path) -> Option<StageError> {
    let folders = std::iter::once(root.to_owned()).chain(below(root, |path| path.is_dir()));
    let found = folders.take(64).find(|folder| is_records(folder))?;
    let text = format!(
        "`{}` holds TFRecord files (RLDS, TFDS): these have images of 320x180 pixels of the left eyes, and neither \
         intrinsics nor poses of the cameras",
        found.display()
    );
    Some(StageError::bad_input(text).with_hint(
        "take the raw episodes of the same recordings instead: `recording_folderpath` in the metadata of each names its \
         LAB/OUTCOME/DATE/TIME (docs/droid.md)",
    ))
}

/// Whether a folder is that of a data set in TFRecord files.
fn is_records(folder: &Path) -> bool {
    let described = folder.join("dataset_info.json").is_file() && folder.join("features.json").is_file();
    described
        || below(folder, |path| path.to_string_lossy().contains(".tfrecord"))
            .next()
            .is_some()
}

/// What lies in a folder and fits, in no order.
fn below(folder: &Path, fits: impl Fn(&Path) -> bool) -> impl Iterator<Item = std::path::PathBuf> {
    let entries = rogs_files::entries(folder).into_iter().flatten().take(4096);
    entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(move |path| fits(path))
}
