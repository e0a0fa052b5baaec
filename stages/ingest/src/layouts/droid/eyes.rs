//! Videos of a camera: the left eye by itself (`SERIAL.mp4`), both side by side (`SERIAL-stereo.mp4`).

use std::path::{Path, PathBuf};

use rogs_worker::StageResult;

use super::tree::VIDEOS;
use crate::fault::{inside, wrong};
use crate::images::Part;
use crate::media::VideoInfo;
use crate::video;

/// One eye: a part of a video.
#[derive(Debug, Clone)]
pub(super) struct Eye {
    pub(super) path: PathBuf,
    pub(super) info: VideoInfo,
    pub(super) part: Option<Part>,
}

/// The eyes of a camera.
#[derive(Debug)]
pub(super) struct Eyes {
    pub(super) left: Eye,
    pub(super) right: Option<Eye>,
    /// Size of the images of one eye.
    pub(super) size: (u32, u32),
    /// Frames that all videos have.
    pub(super) frames: u64,
}

/// The videos of a camera; `None` when there are none.
pub(super) fn open(root: &Path, serial: &str) -> StageResult<Option<Eyes>> {
    let video = |name: String| -> StageResult<Option<(PathBuf, VideoInfo)>> {
        let path = inside(root, &format!("{VIDEOS}/{name}"), root)?;
        if !path.is_file() {
            return Ok(None);
        }
        let info = video::probe(&path)?;
        Ok(Some((path, info)))
    };
    let (mono, stereo) = (video(format!("{serial}.mp4"))?, video(format!("{serial}-stereo.mp4"))?);
    let pair = match stereo {
        None => None,
        Some((path, info)) => {
            let half = info.width / 2;
            let side_by_side = |width: u32| info.width == 2 * width;
            let fits = match &mono {
                Some((_, mono)) => side_by_side(mono.width) && info.height == mono.height,
                // Without the left eye beside it: two images that are wider than high.
                None => info.width % 2 == 0 && half >= info.height,
            };
            if !fits {
                let text = format!(
                    "pictures of {}x{} are no two images of a camera side by side{}",
                    info.width,
                    info.height,
                    mono.as_ref()
                        .map(|(_, mono)| format!(" ({}x{} each)", mono.width, mono.height))
                        .unwrap_or_default()
                );
                return Err(wrong(&path, text));
            }
            let part = |left: u32| Part {
                left,
                top: 0,
                width: half,
                height: info.height,
            };
            let eye = |left: u32| Eye {
                path: path.clone(),
                info: info.clone(),
                part: Some(part(left)),
            };
            Some((eye(0), eye(half)))
        }
    };
    let mono = mono.map(|(path, info)| Eye { path, info, part: None });
    Ok(match (mono, pair) {
        (None, None) => None,
        (Some(left), None) => Some(Eyes {
            size: (left.info.width, left.info.height),
            frames: left.info.frames,
            left,
            right: None,
        }),
        (None, Some((left, right))) => Some(Eyes {
            size: (left.info.width / 2, left.info.height),
            frames: left.info.frames,
            left,
            right: Some(right),
        }),
        (Some(left), Some((beside, right))) => {
            check_side(&left, &beside, &right)?;
            Some(Eyes {
                size: (left.info.width, left.info.height),
                frames: left.info.frames.min(right.info.frames),
                left,
                right: Some(right),
            })
        }
    })
}

/// Refuses a video that shows the right half of the stereo video rather than the left one.
fn check_side(alone: &Eye, left: &Eye, right: &Eye) -> StageResult<()> {
    let mut shown = Vec::new();
    for eye in [alone, left] {
        let mut picture = Vec::new();
        video::decode(&eye.path, &eye.info, (0, 1, 1), |_, frame| {
            picture = frame.to_vec();
            Ok(())
        })?;
        shown.push(picture);
    }
    let [alone_rgb, both] = &shown[..] else { return Ok(()) };
    let off = |eye: &Eye| {
        let half = eye.part.map(|part| part.of(both, eye.info.width)).unwrap_or_default();
        let sum: u64 = half
            .iter()
            .zip(alone_rgb)
            .map(|(a, b)| u64::from(a.abs_diff(*b)).pow(2))
            .sum();
        sum as f64 / half.len().max(1) as f64
    };
    let (from_left, from_right) = (off(left), off(right));
    // Packing loses a few grey levels; the other eye is tens away.
    if from_left > 4.0 * from_right + 4.0 {
        let text = format!("it shows the right eye of `{}`, not the left one", left.path.display());
        return Err(wrong(&alone.path, text).with_hint("the poses are those of the left eye: exchange the videos"));
    }
    Ok(())
}
