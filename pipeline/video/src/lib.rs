//! Video by the programs `ffmpeg` and `ffprobe`: no library of them is linked.
//!
//! [`program`] is the one place that starts them; whoever reads videos builds its commands on it (`rogs-ingest`). [`Film`]
//! writes pictures as MP4, WebM or GIF by `ffmpeg`, or as a folder of PNG images without it. A film appears whole or not
//! at all.
//!
//! ```
//! use rogs_video::{Film, FilmForm};
//!
//! let folder = tempfile::tempdir()?;
//! let frames = folder.path().join("frames");
//! let mut film = Film::begin(&frames, FilmForm::Images, [2, 1], 10.0)?;
//! film.frame(&[255, 0, 0, 0, 0, 255])?;
//! film.finish()?;
//! assert!(frames.join("000000.png").is_file());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod film;
pub mod program;

pub use error::{Error, Result};
pub use film::{Film, FilmForm};
