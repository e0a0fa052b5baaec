//! Films: pictures in order, as a video or as a folder of images.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{ChildStdin, Stdio};
use std::thread::JoinHandle;

use rogs_arrays::png_bytes;
use rogs_files::Draft;

use crate::error::{Error, Result};
use crate::program::{FFMPEG, Running, command, heard, last_line, listen, url};

/// Largest side of a film, pixels.
const MAX_SIDE: u32 = 16_384;
/// Most frames per second.
const MAX_RATE: f64 = 240.0;

/// What a film is written as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FilmForm {
    /// H.264, which every player and browser shows.
    Mp4,
    /// VP9.
    WebM,
    /// A GIF of 256 colours.
    Gif,
    /// A folder of PNG images `000000.png`, ...: nothing is lost, and no program is needed.
    Images,
}

impl FilmForm {
    /// The form that a name asks for, by its ending; a name without one is a folder of images.
    ///
    /// # Errors
    /// When the ending is another.
    pub fn of(path: &Path) -> Result<Self> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
        match ending.as_deref() {
            None => Ok(Self::Images),
            Some("mp4") => Ok(Self::Mp4),
            Some("webm") => Ok(Self::WebM),
            Some("gif") => Ok(Self::Gif),
            Some(_) => Err(Error::Form(path.to_owned())),
        }
    }

    /// How `ffmpeg` encodes it. Odd sides get a black row or column where the form needs
    /// even ones. One thread, so that the bytes do not depend on how many the machine has.
    fn arguments(self) -> &'static [&'static str] {
        match self {
            Self::Mp4 => &[
                "-vf",
                "pad=ceil(iw/2)*2:ceil(ih/2)*2",
                "-c:v",
                "libx264",
                "-preset",
                "veryfast",
                "-crf",
                "16",
                "-pix_fmt",
                "yuv420p",
                "-movflags",
                "+faststart",
                "-f",
                "mp4",
            ],
            Self::WebM => &[
                "-c:v",
                "libvpx-vp9",
                "-crf",
                "20",
                "-b:v",
                "0",
                "-deadline",
                "realtime",
                "-cpu-used",
                "6",
                "-pix_fmt",
                "yuv420p",
                "-f",
                "webm",
            ],
            Self::Gif => &[
                "-filter_complex",
                "split[a][b];[a]palettegen=stats_mode=diff[p];[b][p]paletteuse=dither=sierra2_4a",
                "-loop",
                "0",
                "-f",
                "gif",
            ],
            Self::Images => &[],
        }
    }
}

/// A film that is being written. It appears under its name when [`finish`](Self::finish) returns; dropped before, it leaves
/// nothing.
pub struct Film {
    draft: Draft,
    path: PathBuf,
    size: [u32; 2],
    frames: usize,
    encoder: Option<Encoder>,
}

struct Encoder {
    // Closed before the program is waited for.
    pictures: Option<ChildStdin>,
    complaints: Option<JoinHandle<std::io::Result<Vec<u8>>>>,
    running: Running,
}

/// Name of the film inside its draft.
const INSIDE: &str = "film";

impl Film {
    /// Begins a film of `[width, height]` pixels and `rate` frames per second.
    ///
    /// # Errors
    /// When the size or rate is none, the program cannot be run, or something is where a folder is to be.
    pub fn begin(path: &Path, form: FilmForm, size: [u32; 2], rate: f64) -> Result<Self> {
        let [width, height] = size;
        if !size.iter().all(|side| (1..=MAX_SIDE).contains(side)) {
            return Err(Error::Setting(format!(
                "invalid size {width}x{height} of a film: sides are 1 to {MAX_SIDE} pixels"
            )));
        }
        if !(rate > 0.0 && rate <= MAX_RATE) {
            return Err(Error::Setting(format!(
                "invalid rate {rate}: expected above 0 and at most {MAX_RATE} frames per second"
            )));
        }
        if form == FilmForm::Images && path.exists() {
            return Err(Error::Taken(path.to_owned()));
        }
        let draft = Draft::begin(path)?;
        let encoder = match form {
            FilmForm::Images => None,
            other => Some(Encoder::start(other, size, rate, &draft.path_of(INSIDE))?),
        };
        Ok(Self {
            draft,
            path: path.to_owned(),
            size,
            frames: 0,
            encoder,
        })
    }

    /// Appends a picture. `[H, W, 3]`
    ///
    /// # Errors
    /// When it has another size, the program fails, or the operating system refuses.
    pub fn frame(&mut self, rgb: &[u8]) -> Result<()> {
        let [width, height] = self.size;
        if rgb.len() as u64 != u64::from(width) * u64::from(height) * 3 {
            return Err(Error::Setting(format!(
                "frame {} has {} bytes, a picture of {width}x{height} has 3 for each pixel",
                self.frames,
                rgb.len()
            )));
        }
        match &mut self.encoder {
            None => {
                let name = format!("{:06}.png", self.frames);
                let bytes = png_bytes((width, height), rgb).map_err(|error| Error::Setting(error.to_string()))?;
                self.draft.write(name, &bytes)?;
            }
            Some(encoder) => {
                let sent = encoder.pictures.as_mut().map(|pictures| pictures.write_all(rgb));
                if !matches!(sent, Some(Ok(()))) {
                    return Err(encoder.failed(&self.path));
                }
            }
        }
        self.frames += 1;
        Ok(())
    }

    /// Number of pictures so far.
    #[must_use]
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// Ends the film and gives it its name.
    ///
    /// # Errors
    /// When it has no picture, the program fails, or the operating system refuses.
    pub fn finish(self) -> Result<()> {
        if self.frames == 0 {
            return Err(Error::Setting("a film needs a picture".to_owned()));
        }
        match self.encoder {
            None => self.draft.publish()?,
            Some(mut encoder) => {
                drop(encoder.pictures.take());
                let ended = encoder.running.0.wait().map_err(Error::NoProgram)?;
                if !ended.success() {
                    return Err(encoder.failed(&self.path));
                }
                self.draft.publish_file(INSIDE)?;
            }
        }
        Ok(())
    }
}

impl Encoder {
    fn start(form: FilmForm, [width, height]: [u32; 2], rate: f64, to: &Path) -> Result<Self> {
        let mut command = command(FFMPEG);
        command.args(["-y", "-f", "rawvideo", "-pix_fmt", "rgb24"]);
        command.args([
            "-s",
            &format!("{width}x{height}"),
            "-r",
            &rate.to_string(),
            "-i",
            "pipe:0",
        ]);
        command.args([
            "-sws_flags",
            "bicubic+accurate_rnd+full_chroma_int+bitexact",
            "-threads",
            "1",
        ]);
        command.args(["-fflags", "+bitexact", "-flags:v", "+bitexact"]);
        command.args(form.arguments()).arg(url(to));
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let mut running = Running(command.spawn().map_err(Error::NoProgram)?);
        let pictures = running.0.stdin.take();
        let complaints = running.0.stderr.take().map(listen);
        Ok(Self {
            pictures,
            complaints,
            running,
        })
    }

    /// What the program said when it stopped.
    fn failed(&mut self, path: &Path) -> Error {
        drop(self.pictures.take());
        let _ = self.running.0.wait();
        let said = self.complaints.take().map(heard).unwrap_or_default();
        Error::Program {
            path: path.to_owned(),
            said: last_line(&said),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(width: u32, height: u32, shade: u8) -> Vec<u8> {
        [shade, 128, 255 - shade].repeat((width * height) as usize)
    }

    fn entries(folder: &Path) -> usize {
        std::fs::read_dir(folder).unwrap().count()
    }

    #[test]
    fn the_ending_says_the_form() {
        let form = |name: &str| FilmForm::of(Path::new(name));
        assert_eq!(form("a.MP4").unwrap(), FilmForm::Mp4);
        assert_eq!(form("frames").unwrap(), FilmForm::Images);
        assert!(form("a.mov").unwrap_err().to_string().contains(".mp4, .webm or .gif"));
    }

    #[test]
    fn images_appear_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("frames");
        let mut film = Film::begin(&place, FilmForm::Images, [3, 2], 10.0).unwrap();
        film.frame(&picture(3, 2, 0)).unwrap();
        assert!(film.frame(&[0; 5]).is_err() && film.frames() == 1 && !place.exists());
        drop(film);
        assert_eq!(entries(folder.path()), 0);

        let mut film = Film::begin(&place, FilmForm::Images, [3, 2], 10.0).unwrap();
        film.frame(&picture(3, 2, 0)).unwrap();
        film.frame(&picture(3, 2, 9)).unwrap();
        film.finish().unwrap();
        assert_eq!(entries(&place), 2);
        let again = Film::begin(&place, FilmForm::Images, [3, 2], 10.0);
        assert!(again.err().unwrap().to_string().contains("there already"));
        assert!(Film::begin(&place, FilmForm::Mp4, [0, 2], 10.0).is_err());
        assert!(Film::begin(&place, FilmForm::Mp4, [2, 2], f64::NAN).is_err());
    }

    /// Frames that `ffprobe` counts, and the size it tells.
    fn probed(path: &Path) -> String {
        let path = path.to_str().unwrap();
        let entries = "stream=nb_read_frames,width,height";
        let arguments = [
            "-v",
            "error",
            "-count_frames",
            "-show_entries",
            entries,
            "-of",
            "csv=p=0",
            path,
        ];
        crate::program::printed(crate::program::FFPROBE, &arguments)
            .unwrap()
            .trim()
            .to_owned()
    }

    #[rogs_needs::needs(ffmpeg)]
    #[test]
    fn videos_hold_the_frames_they_were_given() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, size: [u32; 2]| {
            let path = folder.path().join(name);
            let mut film = Film::begin(&path, FilmForm::of(&path).unwrap(), size, 12.0).unwrap();
            for shade in [0, 80, 160, 240] {
                film.frame(&picture(size[0], size[1], shade)).unwrap();
            }
            film.finish().unwrap();
            path
        };
        assert_eq!(probed(&write("even.mp4", [32, 16])), "32,16,4");
        assert_eq!(probed(&write("odd.mp4", [33, 17])), "34,18,4", "sides become even");
        assert_eq!(probed(&write("a.gif", [32, 16])), "32,16,4");
        let first = std::fs::read(folder.path().join("even.mp4")).unwrap();
        let again = write("even.mp4", [32, 16]);
        assert!(first == std::fs::read(again).unwrap(), "the same bytes again");
        assert_eq!(entries(folder.path()), 3, "nothing but the films");
    }

    #[rogs_needs::needs(ffmpeg)]
    #[test]
    fn a_film_that_cannot_be_written_says_why_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("no/such/folder/a.mp4");
        assert!(Film::begin(&missing, FilmForm::Mp4, [8, 8], 10.0).is_err());
        let path = folder.path().join("a.mp4");
        let film = Film::begin(&path, FilmForm::Mp4, [8, 8], 10.0).unwrap();
        assert!(film.finish().unwrap_err().to_string().contains("needs a picture"));
        assert_eq!(entries(folder.path()), 0);
    }
}
