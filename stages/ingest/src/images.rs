//! Image sequences: a folder of PNG files or a video.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use image::{ColorType, DynamicImage};
use rogs_arrays::Png;
use rogs_worker::{StageError, StageResult};

use crate::fault::{io_error, unreadable, wrong};
use crate::media::VideoInfo;
use crate::video;

/// Where the images of a camera come from.
#[derive(Debug, Clone)]
pub(crate) enum FrameSource {
    /// Images in order.
    Files(Vec<PathBuf>),
    /// `000000.png`, `000001.png`, ... in a folder.
    Folder(PathBuf),
    /// `0.png`, `1.png`, ... in a folder.
    Numbered(PathBuf),
    /// Frames of a video file.
    Video {
        path: PathBuf,
        info: VideoInfo,
        order: FrameOrder,
        /// The part of every picture that is the camera's image; `None`: all of it.
        part: Option<Part>,
    },
}

/// Which frame of a video file is which episode frame.
#[derive(Debug, Clone)]
pub(crate) enum FrameOrder {
    /// Episode frame 0 is this frame of the file, and so on.
    From(u64),
    /// The frame of the file for every episode frame; never descending.
    Listed(Vec<u64>),
}

impl FrameOrder {
    fn frame(&self, frame: u32) -> Option<u64> {
        match self {
            Self::From(first) => Some(first + u64::from(frame)),
            Self::Listed(frames) => frames.get(frame as usize).copied(),
        }
    }
}

/// A rectangle of a picture, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Part {
    pub(crate) left: u32,
    pub(crate) top: u32,
    pub(crate) width: u32,
    pub(crate) height: u32,
}

impl Part {
    /// The part of a picture of this width. `[h, w, 3]`
    pub(crate) fn of(self, picture: &[u8], width: u32) -> Vec<u8> {
        let rows = picture.chunks_exact(3 * width as usize);
        let rows = rows.skip(self.top as usize).take(self.height as usize);
        let (from, to) = (3 * self.left as usize, 3 * (self.left + self.width) as usize);
        rows.flat_map(|row| row.get(from..to).unwrap_or_default())
            .copied()
            .collect()
    }
}

/// Extensions of video files.
const VIDEOS: [&str; 6] = ["mp4", "mkv", "webm", "avi", "mov", "m4v"];

/// True when the path names a video file.
pub(crate) fn is_video(path: &Path) -> bool {
    let extension = path
        .extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default();
    VIDEOS.iter().any(|known| extension.eq_ignore_ascii_case(known))
}

impl FrameSource {
    /// A folder or video of an own episode, with exactly `frame_count` frames of the size, `fps` of them a second.
    pub(crate) fn open(path: PathBuf, (frame_count, fps): (u32, f64), size: (u32, u32)) -> StageResult<Self> {
        if !is_video(&path) {
            return frames_of(&path, frame_count).map(Self::Files);
        }
        let mut info = video::probe(&path)?;
        check_size(&path, (info.width, info.height), size).map_err(|error| match info.notes.first() {
            Some(note) => error.with_hint(format!(
                "{note}; the episode's width and height are those of such images"
            )),
            None => error,
        })?;
        if info.frames != u64::from(frame_count) {
            let error = wrong(
                &path,
                format!("it has {} frames, the episode {frame_count}", info.frames),
            );
            return Err(match info.notes.first() {
                Some(note) => error.with_hint(note.clone()),
                None => error,
            });
        }
        info.notes.extend(info.other_rate(fps));
        Ok(Self::Video {
            path,
            info,
            order: FrameOrder::From(0),
            part: None,
        })
    }

    /// Hands the images of these episode frames, which are `step` apart, to `take` in order. `[h, w, 3]`
    pub(crate) fn read(
        &self,
        (first, step, count): (u32, u32, u32),
        size: (u32, u32),
        mut take: impl FnMut(&[u8]),
    ) -> StageResult<Option<String>> {
        match self {
            Self::Video {
                path,
                info,
                order,
                part,
            } => {
                let wanted: Option<Vec<u64>> = (0..count).map(|index| order.frame(first + index * step)).collect();
                let wanted = wanted.ok_or_else(|| wrong(path, "it has no frame for every frame of the episode"))?;
                let warning = read_video(path, info, &wanted, |picture| match part {
                    None => take(picture),
                    Some(part) => take(&part.of(picture, info.width)),
                })?;
                let complaint = warning.map(|warning| format!("the decoder complained: {warning}"));
                let told: Vec<String> = info.notes.iter().cloned().chain(complaint).collect();
                Ok(said(path, &told))
            }
            Self::Files(files) => {
                let file = |index: u32| files.get((first + index * step) as usize).cloned();
                let chosen: Option<Vec<PathBuf>> = (0..count).map(file).collect();
                let chosen = chosen.ok_or_else(|| StageError::internal("a frame beyond those that were listed"))?;
                read_files(chosen.into_iter(), size, take)
            }
            Self::Folder(folder) => {
                let files = (0..count).map(|index| folder.join(numbered(first + index * step, "png")));
                read_files(files, size, take)
            }
            Self::Numbered(folder) => {
                let files = (0..count).map(|index| folder.join(format!("{}.png", first + index * step)));
                read_files(files, size, take)
            }
        }
    }
}

/// Hands these images to `take` in order; what the first of them that says something says.
fn read_files(
    files: impl Iterator<Item = PathBuf>,
    size: (u32, u32),
    mut take: impl FnMut(&[u8]),
) -> StageResult<Option<String>> {
    let mut told = None;
    for file in files {
        let (pixels, notes) = read_rgb(&file, size)?;
        take(&pixels);
        told = told.or_else(|| said(&file, &notes));
    }
    Ok(told)
}

/// What a file says, for a warning.
pub(crate) fn said(path: &Path, notes: &[String]) -> Option<String> {
    (!notes.is_empty()).then(|| format!("`{}`: {}", path.display(), notes.join("; ")))
}

/// Hands these frames of a video, which never descend, to `take` in order.
fn read_video(
    path: &Path,
    info: &VideoInfo,
    wanted: &[u64],
    mut take: impl FnMut(&[u8]),
) -> StageResult<Option<String>> {
    let (Some(&first), Some(&last)) = (wanted.first(), wanted.last()) else {
        return Ok(None);
    };
    let step = wanted.get(1).map_or(1, |second| second.saturating_sub(first));
    if step > 0 && wanted.windows(2).all(|pair| pair[1] == pair[0] + step) {
        return video::decode(path, info, (first, step, wanted.len() as u64), |_, frame| {
            take(frame);
            Ok(())
        });
    }
    let (mut at, mut next) = (first, wanted.iter().peekable());
    video::decode(path, info, (first, 1, last - first + 1), |_, frame| {
        while next.next_if(|wanted| **wanted <= at).is_some() {
            take(frame);
        }
        at += 1;
        Ok(())
    })
}

/// `000012.png`
pub(crate) fn numbered(index: u32, extension: &str) -> String {
    format!("{index:06}.{extension}")
}

/// The frames of an episode in a folder, in order: exactly so many PNG files, whose names end in numbers without a gap.
fn frames_of(folder: &Path, frame_count: u32) -> StageResult<Vec<PathBuf>> {
    let entries = rogs_files::entries(folder).map_err(|error| io_error(folder, &error))?;
    let names = entries.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let (mut frames, mut others) = (Vec::new(), Vec::new());
    for name in names.filter(|name| is_image(name)) {
        match frame_number(&name) {
            Some((stem, number)) => frames.push((stem.to_owned(), number, name)),
            None => others.push(name),
        }
    }
    frames.sort();
    let follow = |pair: &[(String, u32, String)]| {
        // Numbers are all padded to one length, or none is padded.
        let padded = pair
            .iter()
            .any(|(stem, _, name)| name[stem.len()..].starts_with('0') && pair[0].1 > 0);
        let alike = !padded || pair[0].2.len() == pair[1].2.len();
        alike && pair[0].0 == pair[1].0 && pair[0].1.checked_add(1) == Some(pair[1].1)
    };
    if frames.len() == frame_count as usize && others.is_empty() && frames.windows(2).all(follow) {
        return Ok(frames.into_iter().map(|(.., name)| folder.join(name)).collect());
    }
    let found = frames.len()
        + others
            .iter()
            .filter(|name| name.to_lowercase().ends_with(".png"))
            .count();
    let have: BTreeSet<&str> = frames.iter().map(|(.., name)| name.as_str()).collect();
    let (there, missing): (Vec<String>, Vec<String>) = (0..frame_count)
        .map(|frame| numbered(frame, "png"))
        .partition(|name| have.contains(name.as_str()));
    let more = match missing.first().filter(|_| !there.is_empty()) {
        Some(missing) => format!("; `{missing}` is missing"),
        None if there.is_empty() && found == frame_count as usize => {
            ", whose names do not end in numbers without a gap".to_owned()
        }
        None => String::new(),
    };
    others.sort();
    let error = wrong(
        folder,
        format!("it has {found} PNG files, the episode {frame_count} frames{more}"),
    );
    let usual = format!("frames are {}, {}, ...", numbered(0, "png"), numbered(1, "png"));
    Err(match (others.first(), frames.windows(2).find(|pair| !follow(pair))) {
        (Some(other), _) => error.with_hint(format!(
            "{usual}; it also holds `{other}`{}: remove what is none of them, or save them as PNG or as one video",
            match others.len() {
                1 => String::new(),
                count => format!(" and {} more images", count - 1),
            }
        )),
        (None, Some([before, after])) => error.with_hint(format!("{usual}; behind `{}` comes `{}`", before.2, after.2)),
        _ => error.with_hint(usual),
    })
}

/// What stands before the number of a PNG file's name, and the number.
fn frame_number(name: &str) -> Option<(&str, u32)> {
    let (stem, ending) = name.rsplit_once('.')?;
    let before = stem.trim_end_matches(|c: char| c.is_ascii_digit());
    let number = stem[before.len()..].parse().ok()?;
    ending.eq_ignore_ascii_case("png").then_some((before, number))
}

/// True for the name of an image that a person may have meant as a frame.
fn is_image(name: &str) -> bool {
    const ENDINGS: [&str; 8] = ["png", "jpg", "jpeg", "webp", "bmp", "tif", "tiff", "ppm"];
    let ending = name.rsplit_once('.').map(|(_, ending)| ending.to_ascii_lowercase());
    ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str()))
}

fn check_size(path: &Path, found: (u32, u32), expected: (u32, u32)) -> StageResult<()> {
    if found == expected {
        return Ok(());
    }
    let text = format!(
        "images are {}x{}, the episode says {}x{}",
        found.0, found.1, expected.0, expected.1
    );
    Err(wrong(path, text).with_hint("intrinsics belong to the stated size; correct both"))
}

/// One 8-bit RGB or grey image of the expected size, and what it says of its pixels. `[h, w, 3]`
fn read_rgb(path: &Path, size: (u32, u32)) -> StageResult<(Vec<u8>, Vec<String>)> {
    let mut png = open_png(path, size)?;
    let notes = std::mem::take(&mut png.remarks.notes);
    let image = png.decode().map_err(unreadable)?;
    match image.color() {
        ColorType::Rgb8 | ColorType::L8 => Ok((image.into_rgb8().into_raw(), notes)),
        ColorType::Rgba8 | ColorType::La8 if is_opaque(&image) => Ok((image.into_rgb8().into_raw(), notes)),
        ColorType::Rgba8 | ColorType::La8 => Err(wrong(path, "the image is partly transparent; save it without alpha")),
        other => Err(wrong(path, format!("pixels are {other:?}, expected 8-bit RGB or grey"))),
    }
}

/// Whether every pixel of an 8-bit image with alpha is opaque.
fn is_opaque(image: &DynamicImage) -> bool {
    let bytes = image.as_bytes();
    let channels = usize::from(image.color().channel_count()).max(1);
    bytes
        .iter()
        .skip(channels - 1)
        .step_by(channels)
        .all(|&alpha| alpha == 255)
}

/// A 16-bit grey image of the expected size, and what it says of its pixels. `[h, w]`
pub(crate) fn read_grey16(path: &Path, size: (u32, u32)) -> StageResult<(Vec<u16>, Vec<String>)> {
    let mut png = open_png(path, size)?;
    let notes = std::mem::take(&mut png.remarks.notes);
    Ok((png.decode_grey16().map_err(unreadable)?, notes))
}

fn open_png(path: &Path, size: (u32, u32)) -> StageResult<Png> {
    let png = Png::open(path).map_err(unreadable)?;
    check_size(path, (png.width, png.height), size).map_err(|error| match png.remarks.notes.first() {
        Some(note) => error.with_hint(format!(
            "{note}; the episode's width and height are those of such images"
        )),
        None => error,
    })?;
    Ok(png)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_cut_out_of_every_row() {
        let picture: Vec<u8> = (0..4 * 3 * 3).collect();
        let part = Part {
            left: 2,
            top: 1,
            width: 2,
            height: 2,
        };
        assert_eq!(part.of(&picture, 4), [18, 19, 20, 21, 22, 23, 30, 31, 32, 33, 34, 35]);
    }

    #[test]
    #[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
    fn frames_are_files_whose_names_count() {
        let said = |names: &[&str]| {
            let folder = tempfile::tempdir().unwrap();
            for name in names {
                std::fs::write(folder.path().join(name), b"").unwrap();
            }
            let frames = frames_of(folder.path(), 3).map_err(|error| format!("{error} {:?}", error.hint))?;
            let name = |path: &PathBuf| path.file_name().unwrap().to_string_lossy().into_owned();
            Ok::<Vec<String>, String>(frames.iter().map(name).collect())
        };
        for names in [
            ["000000.png", "000001.png", "000002.png"],
            ["000001.png", "000002.png", "000003.png"],
            ["frame_9.png", "frame_10.png", "frame_11.png"],
            ["rgb-000.PNG", "rgb-001.PNG", "rgb-002.PNG"],
        ] {
            assert_eq!(said(&names).unwrap(), names);
        }
        let strays = [
            "0.png",
            "1.png",
            "2.png",
            "._0.png",
            "Thumbs.db",
            "3.png.part",
            "times.txt",
            "2.png~",
        ];
        assert_eq!(said(&strays).unwrap(), ["0.png", "1.png", "2.png"]);
        for (names, words) in [
            (&["0.png", "1.png"][..], "it has 2 PNG files, the episode 3 frames"),
            (&["0.png", "1.png", "3.png"], "behind `1.png` comes `3.png`"),
            (
                &["000000.png", "000001.png", "2.png"],
                "3 frames; `000002.png` is missing",
            ),
            (&["000000.png", "000001.png", "000003.png"], "`000002.png` is missing"),
            (&["a0.png", "a1.png", "b2.png"], "do not end in numbers"),
            (&["0.png", "1.png", "2.png", "2 copy.png"], "it also holds `2 copy.png`"),
            (&["0.jpg", "1.jpg", "2.jpg"], "it also holds `0.jpg` and 2 more images"),
            (&["0.png", "1.png", "2.png", "2.webp"], "`2.webp`"),
            (&["a.png", "b.png", "c.png"], "do not end in numbers"),
        ] {
            let told = said(names).unwrap_err();
            assert!(told.contains(words), "{names:?}: {told}");
        }
    }

    #[test]
    fn orders_name_the_frame_of_the_file() {
        assert_eq!(FrameOrder::From(5).frame(3), Some(8));
        let listed = FrameOrder::Listed(vec![0, 2, 2]);
        assert_eq!((listed.frame(2), listed.frame(3)), (Some(2), None));
    }
}
