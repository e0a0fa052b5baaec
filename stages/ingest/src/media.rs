//! What a video says about itself, and, for `rogs doctor`, what can be decoded on this machine.

use rogs_video::program::{FFMPEG, FFPROBE, printed};
use serde::Serialize;

/// What a video file says about its first video stream.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct VideoInfo {
    /// Codec name, `h264`.
    pub(crate) codec: String,
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Frames in the file, counted without decoding.
    pub(crate) frames: u64,
    /// Frames per second.
    pub(crate) fps: f64,
    /// Quarter turns by which players show it, as its display matrix says; `width` and `height` are those of the turned
    /// images.
    pub(crate) quarter_turns: u32,
    /// What a person should know about it.
    pub(crate) notes: Vec<String>,
}

impl VideoInfo {
    /// What to say where the video has another rate than the episode.
    pub(crate) fn other_rate(&self, fps: f64) -> Option<String> {
        /// Rates such as 29.97 for 30 are the same, and so are those of recorders that do not keep time exactly.
        const TOLERANCE: f64 = 0.02;
        let differs = self.fps > 0.0 && (self.fps / fps - 1.0).abs() > TOLERANCE;
        differs.then(|| {
            format!(
                "it says {:.2} frames a second, the episode {fps}: frames are taken by number, one for every row; check \
                 `fps` and that images and states belong together",
                self.fps
            )
        })
    }
}

/// The video programs and what they can do.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct MediaReport {
    /// Version line of `ffmpeg`, where it is on the PATH.
    pub ffmpeg: Option<String>,
    /// Version line of `ffprobe`, where it is on the PATH.
    pub ffprobe: Option<String>,
    /// H.264 can be decoded.
    pub h264: bool,
    /// HEVC can be decoded.
    pub hevc: bool,
    /// AV1 can be decoded (most LeRobot data sets).
    pub av1: bool,
    /// What is missing and what to do; empty when all is well.
    pub problems: Vec<String>,
}

/// Looks for the video programs. Episodes with PNG images need none of them.
#[must_use]
pub fn media_report() -> MediaReport {
    let first_line = |program: &str| Some(printed(program, &["-version"])?.lines().next()?.to_owned());
    let (ffmpeg, ffprobe) = (first_line(FFMPEG), first_line(FFPROBE));
    let decoders = printed(FFMPEG, &["-hide_banner", "-decoders"]).unwrap_or_default();
    // Lines such as ` V....D libdav1d             dav1d AV1 decoder by VideoLAN (codec av1)`.
    let decodes = |codec: &str| {
        let named = format!("(codec {codec})");
        decoders.lines().any(|line| {
            line.trim_start().starts_with('V')
                && (line.contains(&named) || line.split_whitespace().nth(1) == Some(codec))
        })
    };
    let (h264, hevc, av1) = (decodes("h264"), decodes("hevc"), decodes("av1"));
    let mut problems = Vec::new();
    for (program, found) in [(FFMPEG, &ffmpeg), (FFPROBE, &ffprobe)] {
        if found.is_none() {
            problems.push(format!(
                "`{program}` is not on the PATH: episodes with videos cannot be read; install ffmpeg"
            ));
        }
    }
    if ffmpeg.is_some() {
        for (codec, found) in [("h264", h264), ("av1", av1)] {
            if !found {
                problems.push(format!("this ffmpeg cannot decode {codec}; install a build that can"));
            }
        }
    }
    MediaReport {
        ffmpeg,
        ffprobe,
        h264,
        hevc,
        av1,
        problems,
    }
}
