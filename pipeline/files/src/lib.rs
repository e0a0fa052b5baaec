//! Files and folders that appear whole or not at all.
//!
//! Everything that rogs writes as a whole goes through this crate: it is written under a temporary name beside its
//! place, flushed to disk, renamed, and its folder is flushed. A writer that dies leaves the old file, the new one or
//! none, and perhaps a temporary `.NAME.PID.PLACE.tmp`, which [`sweep`] recognises and removes. Lints of the workspace
//! forbid `std::fs::write`, `File::create` and `std::fs::rename` elsewhere. What some file systems cannot do is decided in
//! one place, the module `missing`; nothing is written through links, and what is no file is not read.
//!
//! | to write | call |
//! |---|---|
//! | bytes at hand | [`write_bytes`] |
//! | a file piece by piece | [`write_with`]; [`try_write_with`] when filling it can fail in ways of its own |
//! | a folder of files | [`Draft`] |
//! | a file that is already there under another name | [`rename`] |
//! | a line of a log | [`append`] |
//! | a folder in a folder of ours, or nothing in its place | [`make_folder_below`], [`remove_below`] |
//!
//! | to read | call |
//! |---|---|
//! | a file that somebody else named, which may be a pipe or a device | [`open`], [`read()`], [`read_to_string`] |
//! | what lies in a folder of data, without what systems leave there | [`entries`] |
//! | whether anybody else is at work | [`Lock`], [`is_locked`] |
//!
//! ```
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("scores.csv");
//! rogs_files::write_with(&path, |out| {
//!     use std::io::Write;
//!     writeln!(out, "clip,psnr_db")?;
//!     writeln!(out, "kitchen-0,24.5")
//! })?;
//! assert_eq!(std::fs::read_to_string(&path)?, "clip,psnr_db\nkitchen-0,24.5\n");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![allow(clippy::disallowed_methods, reason = "the one place that creates and renames files; everybody else calls it")]

mod atomic;
mod draft;
mod error;
pub mod fault_injection;
mod left_behind;
mod lock;
mod missing;
mod paths;
mod place;
mod probe;
mod stray;
mod writer;

pub use atomic::{rename, try_write_with, write_bytes, write_with};
pub use draft::{Draft, DraftFile};
pub use error::{Error, Result, hint};
pub use left_behind::{is_left_behind, sweep};
pub use lock::{Lock, LockError, is_locked};
pub use missing::is_missing_operation;
pub use place::{append, make_folder_below, open, read, read_to_string, remove_below};
pub use probe::probe;
pub use stray::{entries, is_stray};
pub use writer::remove_own;
