//! Content hashes of sources, remembered by path, size and time so that a plan need not read every video again.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rayon::prelude::*;
use rogs_r4c::source::{combine, hash_file, source_files};
use rogs_schemas::ContentHash;
use serde::{Deserialize, Serialize};

use crate::error::Result;

/// A file younger than this may still be changing within the same time stamp, so its hash is not remembered.
const SETTLED: Duration = Duration::from_secs(2);

/// A remembered hash.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Entry {
    size: u64,
    modified_ns: u128,
    hash: ContentHash,
}

/// A file that this cache has looked at: its hash, once it is known.
type Looked = Arc<Mutex<Option<ContentHash>>>;

/// Hashes files, each once: a file that many episodes share is looked at for the first of them alone.
#[derive(Debug, Default)]
pub struct SourceCache {
    known: Mutex<HashMap<PathBuf, Entry>>,
    looked: Mutex<HashMap<PathBuf, Looked>>,
    file: Option<PathBuf>,
    changed: std::sync::atomic::AtomicBool,
}

impl SourceCache {
    /// A cache that is kept in a file. A file that cannot be read or understood counts as empty: it only saves time.
    #[must_use]
    pub fn open(file: &Path) -> Self {
        let text = rogs_files::read(file).unwrap_or_default();
        let known: BTreeMap<PathBuf, Entry> = serde_json::from_slice(&text).unwrap_or_default();
        Self {
            known: Mutex::new(known.into_iter().collect()),
            file: Some(file.to_owned()),
            ..Self::default()
        }
    }

    /// Writes the cache back, when it has anything new.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn save(&self) -> Result<()> {
        let Some(file) = self
            .file
            .as_ref()
            .filter(|_| self.changed.swap(false, std::sync::atomic::Ordering::SeqCst))
        else {
            return Ok(());
        };
        let known = self.known.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let sorted: BTreeMap<_, _> = known.iter().collect();
        rogs_files::write_with(file, |out| Ok(serde_json::to_writer(out, &sorted)?))?;
        Ok(())
    }

    /// Content hash of one file.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn file(&self, path: &Path) -> Result<ContentHash> {
        let lock = || self.looked.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let looked = lock().entry(path.to_owned()).or_default().clone();
        // Whoever asks for the same file waits here, and does not read it again.
        let mut hash = looked.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(hash) = *hash {
            return Ok(hash);
        }
        let found = self.look(path)?;
        *hash = Some(found);
        Ok(found)
    }

    /// Content hash of a file as it is now.
    fn look(&self, path: &Path) -> Result<ContentHash> {
        let metadata = std::fs::metadata(path);
        let stamp = metadata
            .ok()
            .and_then(|metadata| Some((metadata.len(), metadata.modified().ok()?)));
        let Some((size, modified)) = stamp else {
            return Ok(hash_file(path)?);
        };
        let modified_ns = modified
            .duration_since(UNIX_EPOCH)
            .map_or(0, |duration| duration.as_nanos());
        let lock = || self.known.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        if let Some(entry) = lock()
            .get(path)
            .filter(|entry| entry.size == size && entry.modified_ns == modified_ns)
        {
            return Ok(entry.hash);
        }
        let hash = hash_file(path)?;
        if SystemTime::now()
            .duration_since(modified)
            .is_ok_and(|age| age > SETTLED)
        {
            lock().insert(
                path.to_owned(),
                Entry {
                    size,
                    modified_ns,
                    hash,
                },
            );
            self.changed.store(true, std::sync::atomic::Ordering::SeqCst);
        }
        Ok(hash)
    }

    /// Content hash of a whole source: the same as `rogs_r4c::source::hash_source`.
    ///
    /// # Errors
    /// When something in it cannot be read.
    pub fn source(&self, role: &str, path: &Path) -> Result<ContentHash> {
        let files: Vec<_> = source_files(role, path)?.into_iter().collect();
        let hashed = files.into_par_iter().map(|(name, path)| Ok((name, self.file(&path)?)));
        Ok(combine(&hashed.collect::<Result<BTreeMap<_, _>>>()?))
    }

    /// Content hash of the files of an episode below its root. What is not there, is no file or cannot be read counts as
    /// missing, so that the episode is planned, fails by itself in ingest where it needs that file, and gets another key
    /// when the file appears.
    ///
    /// # Errors
    /// Of an episode that lists no files: when something in its folder cannot be read.
    pub fn episode(&self, root: &Path, files: &[PathBuf]) -> Result<ContentHash> {
        if files.is_empty() {
            return self.source("episode", root);
        }
        let hashed = files.iter().map(|file| {
            let path = root.join(file);
            let name = path
                .strip_prefix(root)
                .unwrap_or(file)
                .to_string_lossy()
                .replace('\\', "/");
            Ok((name, self.file(&path).unwrap_or(ContentHash([0; 32]))))
        });
        Ok(combine(&hashed.collect::<Result<BTreeMap<_, _>>>()?))
    }
}
