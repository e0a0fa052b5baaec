//! Reading the files of a robot within bounds.

use std::io::Read as _;
use std::path::Path;

use crate::error::{Error, Result};

/// Reads a file of at most `limit` bytes.
///
/// # Errors
/// When it cannot be read or is larger.
pub(crate) fn read_capped(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let failed = |source| Error::Io {
        action: "reading",
        path: path.to_owned(),
        source,
    };
    let file = rogs_files::open(path).map_err(failed)?;
    let length = file.metadata().map_err(failed)?.len();
    let too_large = || Error::Reference {
        reference: path.display().to_string(),
        what: format!("it is larger than the limit of {} MiB", limit >> 20),
    };
    if length > limit {
        return Err(too_large());
    }
    let mut bytes = Vec::with_capacity(length as usize);
    file.take(limit + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > limit {
        Err(too_large())
    } else {
        Ok(bytes)
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;

    #[test]
    fn large_files_are_refused_before_they_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.stl");
        std::fs::write(&path, vec![0; 2000]).unwrap();
        assert!(read_capped(&path, 1999).unwrap_err().to_string().contains("larger"));
        assert_eq!(read_capped(&path, 2000).unwrap().len(), 2000);
        assert!(
            read_capped(folder.path(), 2000)
                .unwrap_err()
                .chain()
                .contains("it is a folder")
        );
    }
}
