//! Image sequences: a folder of PNG files or a video.

use std::path::{Path, PathBuf};

use image::{ColorType, DynamicImage, ImageDecoder as _, ImageReader, Limits};
use rogs_worker::StageResult;

use crate::checks::{io_error, wrong};
use crate::video::{self, VideoInfo};

/// Largest side of an image file, pixels.
const MAX_SIDE: u32 = 8192;
/// Most memory for decoding one image file, bytes.
const MAX_ALLOC: u64 = 512 << 20;

/// Where the images of a camera come from.
#[derive(Debug, Clone)]
pub(crate) enum FrameSource {
    /// `000000.png`, `000001.png`, ... in a folder.
    Folder(PathBuf),
    /// Frames of a video file.
    Video {
        path: PathBuf,
        info: VideoInfo,
        /// Frame of the file that is episode frame 0.
        first: u64,
    },
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
    /// A folder or video of an own episode, with exactly `frame_count` frames of the size.
    pub(crate) fn open(path: PathBuf, frame_count: u32, size: (u32, u32)) -> StageResult<Self> {
        if !is_video(&path) {
            check_folder(&path, frame_count)?;
            return Ok(Self::Folder(path));
        }
        let info = video::probe(&path)?;
        check_size(&path, (info.width, info.height), size)?;
        if info.frames != u64::from(frame_count) {
            return Err(wrong(
                &path,
                format!("it has {} frames, the episode {frame_count}", info.frames),
            ));
        }
        Ok(Self::Video { path, info, first: 0 })
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
                first: offset,
            } => {
                let range = (offset + u64::from(first), u64::from(step), u64::from(count));
                let warning = video::decode(path, info, range, |_, frame| {
                    take(frame);
                    Ok(())
                })?;
                Ok(warning.map(|warning| format!("`{}`: the decoder complained: {warning}", path.display())))
            }
            Self::Folder(folder) => {
                for index in 0..count {
                    take(&read_rgb(&folder.join(numbered(first + index * step, "png")), size)?);
                }
                Ok(None)
            }
        }
    }
}

/// `000012.png`
pub(crate) fn numbered(index: u32, extension: &str) -> String {
    format!("{index:06}.{extension}")
}

/// A folder must hold exactly the frames of the episode.
fn check_folder(folder: &Path, frame_count: u32) -> StageResult<()> {
    let entries = std::fs::read_dir(folder).map_err(|error| io_error(folder, &error))?;
    let is_png = |entry: &std::fs::DirEntry| entry.path().extension().is_some_and(|extension| extension == "png");
    let found = entries.filter_map(Result::ok).filter(is_png).count();
    if found != frame_count as usize {
        return Err(wrong(
            folder,
            format!("it has {found} PNG files, the episode {frame_count} frames"),
        ));
    }
    Ok(())
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

/// One 8-bit RGB or grey image of the expected size. `[h, w, 3]`
fn read_rgb(path: &Path, size: (u32, u32)) -> StageResult<Vec<u8>> {
    let image = read_image(path, size)?;
    match image.color() {
        ColorType::Rgb8 | ColorType::L8 => Ok(image.into_rgb8().into_raw()),
        ColorType::Rgba8
            if image
                .as_rgba8()
                .is_some_and(|rgba| rgba.pixels().all(|pixel| pixel.0[3] == 255)) =>
        {
            Ok(image.into_rgb8().into_raw())
        }
        ColorType::Rgba8 | ColorType::La8 => Err(wrong(path, "the image is partly transparent; save it without alpha")),
        other => Err(wrong(path, format!("pixels are {other:?}, expected 8-bit RGB or grey"))),
    }
}

/// A 16-bit grey image of the expected size. `[h, w]`
pub(crate) fn read_grey16(path: &Path, size: (u32, u32)) -> StageResult<Vec<u16>> {
    match read_image(path, size)? {
        DynamicImage::ImageLuma16(image) => Ok(image.into_raw()),
        other => Err(wrong(
            path,
            format!("pixels are {:?}, expected 16-bit grey (millimetres)", other.color()),
        )),
    }
}

fn read_image(path: &Path, size: (u32, u32)) -> StageResult<DynamicImage> {
    let bad = |error: image::ImageError| wrong(path, format!("not a readable PNG image: {error}"));
    let mut reader = ImageReader::open(path).map_err(|error| io_error(path, &error))?;
    reader.set_format(image::ImageFormat::Png);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_ALLOC);
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(bad)?;
    check_size(path, decoder.dimensions(), size)?;
    DynamicImage::from_decoder(decoder).map_err(bad)
}
