//! Rollouts: frames of a world model in place of the recorded ones (`docs/rollouts.md`).
//!
//! A rollout is one video, or one folder, for a clip. It must be of the clip that it is given for: as many frames, at the
//! clip's rate or a multiple of it, and the first generated frame of every camera that of the recording. Generated frames
//! become the clip's observations; recorded frames, reference depth and tracks stay what they are.

mod grid;
mod pairing;
mod place;

use std::path::Path;

use rogs_schemas::EpisodeFrame;
use rogs_schemas::records::clip::{CameraRole, ClipCamera, Rollout};
use rogs_worker::{StageError, StageResult};

pub use self::grid::compose;
use self::grid::{Rect, psnr};
use self::place::{Footage, Place};
use crate::fault::wrong;
use crate::params::{Params, RolloutParams};
use crate::resize::Mapping;
use crate::source::{Source, SourceCamera};

/// The clip that a rollout is for, before its images are there.
pub(crate) struct Wanted<'a> {
    /// The episode.
    pub(crate) source: &'a Source,
    /// Frames of the clip.
    pub(crate) frames: u32,
    /// Episode frame of clip frame 0.
    pub(crate) start: EpisodeFrame,
    /// Episode frames from one clip frame to the next.
    pub(crate) step: u32,
    /// Frames per second of the clip.
    pub(crate) fps: f64,
}

/// Reads a rollout into the cameras of a clip; says what it is, and what a person should know.
///
/// # Errors
/// When it is not of this clip, or cannot be read; the message names the file.
pub(crate) fn read(
    path: &Path,
    wanted: &Wanted<'_>,
    cameras: &mut [ClipCamera],
    params: &Params,
) -> StageResult<(Rollout, Vec<String>)> {
    let options = &params.rollout;
    let sources: Vec<&SourceCamera> = sources(wanted.source).collect();
    let place = place::find(path, &sources, options)?;
    if let Some((episode, start)) = &place.says {
        check_claim(path, wanted, episode, *start)?;
    }
    let mut warnings = Vec::new();
    let mut step = None;
    for footage in &place.footage {
        let own = step_of(footage, &place, wanted.fps, options)?;
        if *step.get_or_insert(own) != own {
            let what = format!("one of its views has {own} frames for a frame of the clip, another {step:?}");
            return Err(wrong(&footage.path, what));
        }
        check_length(footage, own, wanted, options)?;
        let range = (options.first_frame, own, wanted.frames);
        read_footage(footage, range, &sources, cameras, params, &mut warnings)?;
    }
    if options.min_first_frame_psnr_db > 0.0
        && let Some(instead) = pairing::instead(wanted, &sources, cameras, params)?
    {
        let what = format!(
            "its first frame is not the first recorded one of camera `{}` ({:.1} dB) but {} ({:.1} dB)",
            cameras[instead.camera].id, instead.db[0], instead.what, instead.db[1]
        );
        return Err(wrong(path, what).with_hint(instead.hint));
    }
    let first_frame_psnr_db = compare_first(path, cameras, params)?;
    let rollout = Rollout {
        model: options.model.clone(),
        layout: place.layout.to_owned(),
        frames: [options.first_frame, step.unwrap_or(1)],
        first_frame_psnr_db,
    };
    if first_frame_is_unknown(cameras) {
        warnings
            .push("no camera has recorded images: whether the rollout begins where the clip does is not known".into());
    }
    Ok((rollout, warnings))
}

/// Source cameras, which come first in the clip, in its order.
fn sources(source: &Source) -> impl Iterator<Item = &SourceCamera> {
    source.cameras.iter().filter(|camera| camera.role == CameraRole::Source)
}

/// Refuses a file whose name says that it is of another episode or of another start.
fn check_claim(path: &Path, wanted: &Wanted<'_>, episode: &str, start: EpisodeFrame) -> StageResult<()> {
    let Wanted { source, .. } = wanted;
    if episode != source.episode_id {
        let what = format!(
            "its name says episode `{episode}`, the clip is of `{}`",
            source.episode_id
        );
        return Err(wrong(path, what));
    }
    if start != wanted.start {
        let what = format!(
            "its name says that it starts at frame {start}, the clip starts at {}",
            wanted.start
        );
        return Err(wrong(path, what).with_hint(format!("set `start_frame = {start}` under [ingest]")));
    }
    Ok(())
}

/// Generated frames from one clip frame to the next.
fn step_of(footage: &Footage, place: &Place, clip_fps: f64, options: &RolloutParams) -> StageResult<u32> {
    // Relative; headers round rates such as 30000/1001.
    const TOLERANCE: f64 = 0.01;
    let Some(fps) = options.fps.or(footage.fps.filter(|_| place.rate_is_told)) else {
        return Ok(1);
    };
    let ratio = fps / clip_fps;
    let step = ratio.round();
    if step < 1.0 || (ratio / step - 1.0).abs() > TOLERANCE {
        let what = format!("it runs at {fps} frames per second, the clip at {clip_fps}");
        let hint =
            "a rollout has the clip's rate or a multiple of it; where a header is wrong, set `fps` under [rollouts]";
        return Err(wrong(&footage.path, what).with_hint(hint));
    }
    Ok(step as u32)
}

/// As many frames as the clip needs, or as many as the parameters say that there are.
fn check_length(footage: &Footage, step: u32, wanted: &Wanted<'_>, options: &RolloutParams) -> StageResult<()> {
    let needed = u64::from(options.first_frame) + u64::from(wanted.frames - 1) * u64::from(step) + 1;
    let expected = options.frames.map_or(needed, u64::from);
    if footage.frames == expected && needed <= expected {
        return Ok(());
    }
    let what = format!(
        "it has {} frames, the {} frames of the clip need {needed}{}",
        footage.frames,
        wanted.frames,
        match options.frames {
            Some(frames) => format!(" and `frames` says {frames}"),
            None => String::new(),
        }
    );
    let hint = "where every rollout is longer than the clip, set `frames` under [rollouts] to its length, and `first-frame` \
                to the frame that shows the start of the clip";
    Err(wrong(&footage.path, what).with_hint(hint))
}

/// Decodes the frames of one file and gives every camera its part, at the size and cut of the clip.
fn read_footage(
    footage: &Footage,
    range: (u32, u32, u32),
    sources: &[&SourceCamera],
    cameras: &mut [ClipCamera],
    params: &Params,
    warnings: &mut Vec<String>,
) -> StageResult<()> {
    let target = (params.width, params.height);
    let views: Vec<(usize, Rect, Mapping)> = footage
        .views
        .iter()
        .map(|(camera, rect)| {
            let own = sources[*camera];
            let recorded = Mapping::new((own.width, own.height), target, params.fit);
            (*camera, *rect, recorded.of_size((rect.width, rect.height)))
        })
        .collect();
    let length = range.2 as usize * params.width as usize * params.height as usize * 3;
    let mut images: Vec<Vec<u8>> = views.iter().map(|_| Vec::with_capacity(length)).collect();
    let said = footage.images.read(range, footage.size, |frame| {
        for ((_, rect, mapping), images) in views.iter().zip(&mut images) {
            images.extend(mapping.rgb(&rect.cut(frame, footage.size.0)));
        }
    })?;
    warnings.extend(said);
    for ((camera, ..), images) in views.into_iter().zip(images) {
        cameras[camera].generated = Some(images);
    }
    Ok(())
}

/// How far the first generated image is the first recorded one, by camera; refuses one that shows something else.
fn compare_first(path: &Path, cameras: &[ClipCamera], params: &Params) -> StageResult<Vec<Option<f64>>> {
    let area = params.width as usize * params.height as usize * 3;
    let least = params.rollout.min_first_frame_psnr_db;
    let figure = |camera: &ClipCamera| -> StageResult<Option<f64>> {
        let first = |images: &Option<Vec<u8>>| {
            images
                .as_ref()
                .and_then(|images| images.get(..area))
                .map(<[u8]>::to_vec)
        };
        let (Some(generated), Some(recorded)) = (first(&camera.generated), first(&camera.recorded)) else {
            return Ok(None);
        };
        let found = psnr(&generated, &recorded);
        if found < least {
            let what = format!(
                "its first frame is not the first recorded one of camera `{}`: {found:.1} dB, at least {least} expected",
                camera.id
            );
            let hint = "is it a rollout of this episode and start, with its views in the right places? Where the model \
                        changes the first frame this much, lower `min-first-frame-psnr-db` under [rollouts]";
            return Err(wrong(path, what).with_hint(hint));
        }
        Ok(Some(found))
    };
    cameras.iter().map(figure).collect()
}

fn first_frame_is_unknown(cameras: &[ClipCamera]) -> bool {
    !cameras
        .iter()
        .any(|camera| camera.generated.is_some() && camera.recorded.is_some())
}

/// No rollout was given for a clip that is to be one.
pub(crate) fn missing(source: &Source) -> StageError {
    StageError::bad_input(format!("there is no rollout of episode `{}`", source.episode_id)).with_hint(
        "in a run: a video or folder in the folder of [rollouts], named by the clip's id or the episode's (docs/rollouts.md)",
    )
}
