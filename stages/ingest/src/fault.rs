//! How a wrong input is reported, and the paths and small files that every reader goes through.

use std::io::Read as _;
use std::path::{Component, Path, PathBuf};

use rogs_arrays::Problem;
use rogs_worker::{StageError, StageResult};

/// A wrong input, with the file it is in.
pub(crate) fn wrong(path: &Path, what: impl std::fmt::Display) -> StageError {
    StageError::bad_input(format!("`{}`: {what}", path.display()))
}

/// The text of a small file.
pub(crate) fn read_text(path: &Path, limit: u64) -> StageResult<String> {
    let file = rogs_files::open(path).map_err(|error| io_error(path, &error))?;
    let length = file.metadata().map_err(|error| io_error(path, &error))?.len();
    if length > limit {
        return Err(wrong(
            path,
            format!("{length} bytes are more than the {limit} that such a file may have"),
        ));
    }
    let mut bytes = Vec::new();
    let read = file.take(limit).read_to_end(&mut bytes);
    read.map_err(|error| io_error(path, &error))?;
    String::from_utf8(bytes).map_err(|error| {
        let is_utf16 = [[0xff, 0xfe], [0xfe, 0xff]]
            .iter()
            .any(|mark| error.as_bytes().starts_with(mark));
        let what = if is_utf16 {
            "it is UTF-16 text"
        } else {
            "it is no UTF-8 text"
        };
        wrong(path, what).with_hint("save it as UTF-8")
    })
}

/// An error of the operating system about a file.
pub(crate) fn io_error(path: &Path, error: &std::io::Error) -> StageError {
    match error.kind() {
        std::io::ErrorKind::NotFound => match std::fs::read_link(path) {
            // A cache or git-annex whose content was not fetched, or a disk that is not there.
            Ok(target) => wrong(
                path,
                format!("it is a link to `{}`, and nothing is there", target.display()),
            )
            .with_hint("fetch the content (`git annex get`, the hub's client), or mount the disk"),
            Err(_) => wrong(path, "the file is missing"),
        },
        // It is not UTF-8, or no file at all.
        std::io::ErrorKind::InvalidData | std::io::ErrorKind::InvalidInput => wrong(path, error),
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

/// A path named by a file, below the folder it belongs to. Only the text may not lead out: links are the person's, who
/// lays data sets out with them (caches of hubs, git-annex).
pub(crate) fn inside(folder: &Path, relative: &str, named_by: &Path) -> StageResult<PathBuf> {
    let leads_out = || {
        wrong(
            named_by,
            format!("the path `{relative}` does not stay inside the folder"),
        )
        .with_hint("name a path below the folder; a link there may lead elsewhere")
    };
    let mut below = PathBuf::new();
    for part in Path::new(relative).components() {
        match part {
            Component::Normal(name) => below.push(name),
            Component::CurDir => {}
            Component::ParentDir if below.pop() => {}
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => return Err(leads_out()),
        }
    }
    if below.as_os_str().is_empty() {
        return Err(leads_out());
    }
    Ok(folder.join(below))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_inside() {
        let folder = Path::new("/data");
        let by = Path::new("episode.json");
        assert_eq!(inside(folder, "a/b.png", by).unwrap(), Path::new("/data/a/b.png"));
        assert_eq!(inside(folder, "./a/../b.png", by).unwrap(), Path::new("/data/b.png"));
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("a.mp4");
        std::os::unix::fs::symlink("../.git/annex/objects/x/y.mp4", &link).unwrap();
        let missing = std::io::Error::from(std::io::ErrorKind::NotFound);
        let told = io_error(&link, &missing);
        assert!(
            told.message.contains("a link to `../.git/annex/objects/x/y.mp4`"),
            "{told}"
        );
        assert!(told.hint.is_some());
        assert!(
            io_error(&folder.path().join("b"), &missing)
                .message
                .contains("is missing")
        );
        let folder = Path::new("/data");
        for path in ["../x", "/etc/passwd", "a/../../x", "", ".", "a/.."] {
            assert!(inside(folder, path, by).is_err(), "{path}");
        }
    }
}
