//! How a wrong input is reported, and the paths and small files that every reader goes through.

use std::path::{Component, Path, PathBuf};

use rogs_arrays::Problem;
use rogs_worker::{StageError, StageResult};

/// A wrong input, with the file it is in.
pub(crate) fn wrong(path: &Path, what: impl std::fmt::Display) -> StageError {
    StageError::bad_input(format!("`{}`: {what}", path.display()))
}

/// The text of a small file.
pub(crate) fn read_text(path: &Path, limit: u64) -> StageResult<String> {
    let length = std::fs::metadata(path).map_err(|error| io_error(path, &error))?.len();
    if length > limit {
        return Err(wrong(
            path,
            format!("{length} bytes are more than the {limit} that such a file may have"),
        ));
    }
    std::fs::read_to_string(path).map_err(|error| io_error(path, &error))
}

/// An error of the operating system about a file.
pub(crate) fn io_error(path: &Path, error: &std::io::Error) -> StageError {
    match error.kind() {
        std::io::ErrorKind::NotFound => wrong(path, "the file is missing"),
        std::io::ErrorKind::InvalidData => wrong(path, error),
        _ => StageError::io(format!("reading `{}`: {error}", path.display())),
    }
}

/// An array or image that cannot be read.
pub(crate) fn unreadable(error: rogs_arrays::Error) -> StageError {
    match &error.problem {
        Problem::Io(cause) => io_error(&error.path, cause),
        Problem::Wrong(what) => wrong(&error.path, what),
    }
}

/// A path named by a file, below the folder it belongs to.
pub(crate) fn inside(folder: &Path, relative: &str, named_by: &Path) -> StageResult<PathBuf> {
    let path = Path::new(relative);
    let plain = path
        .components()
        .all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    if relative.is_empty() || !plain {
        return Err(wrong(
            named_by,
            format!("the path `{relative}` does not stay inside the folder"),
        ));
    }
    let joined = folder.join(path);
    // Links that lead out are refused where the file exists; a missing file is reported by whoever opens it.
    if let (Ok(real), Ok(root)) = (joined.canonicalize(), folder.canonicalize())
        && !real.starts_with(&root)
    {
        return Err(wrong(
            named_by,
            format!("the path `{relative}` leads out of the folder through a link"),
        ));
    }
    Ok(joined)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_inside() {
        let folder = Path::new("/data");
        let by = Path::new("episode.json");
        assert_eq!(inside(folder, "a/b.png", by).unwrap(), Path::new("/data/a/b.png"));
        for path in ["../x", "/etc/passwd", "a/../../x", ""] {
            assert!(inside(folder, path, by).is_err(), "{path}");
        }
    }
}
