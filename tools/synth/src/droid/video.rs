//! `recordings/MP4/SERIAL.mp4` and `SERIAL-stereo.mp4`, packed by the program `ffmpeg` as DROID's are: H.264, 4:2:0.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;
use rogs_files::Draft;

use super::{DroidEpisode, Peculiar};
use crate::error::{Error, Result};
use crate::render::View;

/// Quantiser of x264: losses of a few grey levels.
const QUANTISER: &str = "6";

/// Writes the videos of an episode.
pub(super) fn write(draft: &Draft, episode: &DroidEpisode) -> Result<()> {
    let truth = &episode.truth;
    let late = usize::from(episode.peculiar == Peculiar::Late);
    let frames = truth.frame_count() - late;
    let drawn: Vec<Vec<View>> = (0..frames)
        .into_par_iter()
        .map(|frame| truth.render_frame(frame).views)
        .collect();
    for (camera, serial) in episode.serials.into_iter().enumerate() {
        if camera == 2 && episode.peculiar == Peculiar::MissingCamera {
            continue;
        }
        let lens = &truth.cameras[camera].lens;
        let (width, height) = (lens.width as usize, lens.height as usize);
        let left = || drawn.iter().map(|views| views[camera].rgb.clone());
        let both = || {
            drawn
                .iter()
                .map(|views| beside(&views[camera].rgb, &views[camera + 3].rgb, width))
        };
        let put = |name: String, width: usize, pictures: &mut dyn Iterator<Item = Vec<u8>>| {
            let bytes = packed([width, height], truth.config.fps, pictures)?;
            Ok::<(), Error>(draft.write(format!("recordings/MP4/{name}"), &bytes)?)
        };
        if episode.peculiar != Peculiar::StereoOnly {
            put(format!("{serial}.mp4"), width, &mut left())?;
        }
        if episode.peculiar != Peculiar::MonoOnly {
            put(format!("{serial}-stereo.mp4"), 2 * width, &mut both())?;
        }
    }
    Ok(())
}

/// Two pictures side by side.
fn beside(left: &[u8], right: &[u8], width: usize) -> Vec<u8> {
    let rows = left.chunks_exact(3 * width).zip(right.chunks_exact(3 * width));
    rows.flat_map(|(left, right)| left.iter().chain(right))
        .copied()
        .collect()
}

/// A file that goes away with the value.
struct Scratch(PathBuf);

impl Drop for Scratch {
    fn drop(&mut self) {
        // Nothing can be done where it fails.
        let _ = std::fs::remove_file(&self.0);
    }
}

fn packed([width, height]: [usize; 2], fps: f64, pictures: &mut dyn Iterator<Item = Vec<u8>>) -> Result<Vec<u8>> {
    // The program needs a file in which it can go back.
    static NUMBER: AtomicU32 = AtomicU32::new(0);
    let number = NUMBER.fetch_add(1, Ordering::Relaxed);
    let scratch = Scratch(std::env::temp_dir().join(format!("rogs-synth-{}-{number}.mp4", std::process::id())));
    let path = &scratch.0;
    let mut command = Command::new("ffmpeg");
    command.args(["-v", "error", "-nostdin", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
    command.args([
        "-s",
        &format!("{width}x{height}"),
        "-r",
        &fps.to_string(),
        "-i",
        "pipe:0",
    ]);
    command.args([
        "-sws_flags",
        "accurate_rnd+full_chroma_int+bitexact",
        "-pix_fmt",
        "yuv420p",
    ]);
    command.args([
        "-c:v", "libx264", "-preset", "veryfast", "-qp", QUANTISER, "-threads", "1",
    ]);
    command.args(["-fflags", "+bitexact", "-flags:v", "+bitexact", "-f", "mp4"]);
    command
        .arg(path)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let failed = |source| Error::io(path, source);
    let mut child = command
        .spawn()
        .map_err(|source| Error::program("ffmpeg", source.to_string()))?;
    let mut sent = Ok(());
    if let Some(mut input) = child.stdin.take() {
        for picture in pictures {
            sent = input.write_all(&picture);
            if sent.is_err() {
                break;
            }
        }
    }
    let output = child.wait_with_output().map_err(failed)?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(Error::program(
            "ffmpeg",
            said.lines().last().unwrap_or("it gave no reason").to_owned(),
        ));
    }
    sent.map_err(failed)?;
    read(path)
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(|source| Error::io(path, source))
}
