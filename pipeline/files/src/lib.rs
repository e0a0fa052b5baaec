//! Files and folders that appear whole or not at all.
//!
//! Everything that rogs writes as a whole goes through this crate: it is written under a temporary name beside its
//! place, flushed to disk, renamed, and its folder is flushed. A writer that dies leaves the old file, the new one or
//! none, and perhaps a temporary `.NAME.PID.tmp`, which [`sweep`] recognises and removes. Lints of the workspace forbid
//! `std::fs::write`, `File::create` and `std::fs::rename` elsewhere; logs that only grow are opened for appending.
//!
//! | to write | call |
//! |---|---|
//! | bytes at hand | [`write_bytes`] |
//! | a file piece by piece | [`write_with`]; [`try_write_with`] when filling it can fail in ways of its own |
//! | a folder of files | [`Draft`] |
//! | a file that is already there under another name | [`rename`] |
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
mod stray;

pub use atomic::{rename, try_write_with, write_bytes, write_with};
pub use draft::{Draft, DraftFile};
pub use error::{Error, Result};
pub use left_behind::{is_left_behind, sweep};
pub use stray::is_stray;
