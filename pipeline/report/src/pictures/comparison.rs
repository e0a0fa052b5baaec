//! The same views by every method, side by side.

use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::scores::Scores;
use rogs_schemas::{CameraIndex, FrameIndex};

use super::colours::{FULL_ERROR, error_map};
use super::frames::{observation, target};
use super::picture::{Figure, Picture};

/// A table of pictures: the same views by every method.
#[derive(Default)]
pub(crate) struct Comparison {
    pub(crate) columns: Vec<String>,
    /// Label and one cell a column.
    pub(crate) rows: Vec<(String, Vec<Option<Figure>>)>,
    /// What a reader must know.
    pub(crate) note: String,
}

/// Methods of a comparison at most; all of them have sheets of their own below it.
const MAX_METHODS: usize = 6;

/// Reference, prediction and error map of source and held-out cameras at an input time and at another one, where the query
/// plan has both.
pub(crate) fn comparison(clip: &Clip, scores: &[&(String, Scores)]) -> Comparison {
    let methods = with_renders(scores);
    let mut comparison = Comparison {
        columns: vec!["reference".to_owned()],
        rows: Vec::new(),
        note: format!(
            "Error maps: mean absolute difference of the three channels, black 0 to yellow {FULL_ERROR} of 255 and more. \
             Input times were given to the method, the others were not."
        ),
    };
    if methods.is_empty() {
        return comparison;
    }
    for (method, _) in &methods {
        comparison.columns.extend([method.clone(), "error".to_owned()]);
    }
    let times = [
        (middle(clip, true), "input time"),
        (middle(clip, false), "not an input time"),
    ];
    for (index, camera) in CameraIndex::first(clip.cameras.len()).zip(&clip.cameras) {
        let group = if camera.partner.is_some() { "novel" } else { "source" };
        for (frame, kind) in times.iter().filter_map(|(frame, kind)| Some(((*frame)?, kind))) {
            let Some(reference) = target(clip, index, frame) else {
                continue;
            };
            let mut cells = vec![reference.jpeg(format!("{} reference", camera.id))];
            for (method, scores) in &methods {
                let mut views = scores.renders.iter();
                let view = views.find(|view| view.camera == camera.id && view.frame == frame);
                let own = view.and_then(|view| Picture::from_rgb(view.width, view.height, &view.rgb));
                let error = own.as_ref().and_then(|own| error_map(&reference, own));
                cells.push(own.and_then(|own| own.jpeg(format!("{} by {method}", camera.id))));
                cells.push(error.and_then(|error| error.jpeg(format!("{} error of {method}", camera.id))));
            }
            let label = format!("{} ({group}), frame {frame}, {kind}", camera.id);
            comparison.rows.push((label, cells));
        }
    }
    comparison
}

/// The methods that have renders, as many as are shown.
fn with_renders<'a>(scores: &[&'a (String, Scores)]) -> Vec<&'a (String, Scores)> {
    let shown = scores.iter().filter(|(_, scores)| !scores.renders.is_empty());
    shown.take(MAX_METHODS).copied().collect()
}

/// A query time in the middle of the plan, an input time or not: at the ends the first input frame hides what time does.
pub(super) fn middle(clip: &Clip, input: bool) -> Option<FrameIndex> {
    let all = clip.query_frames.iter().copied();
    let frames: Vec<FrameIndex> = all
        .filter(|frame| clip.source_frames.contains(frame) == input)
        .collect();
    frames.get(frames.len() / 2).copied()
}

/// A rollout: what was recorded, what every method made of the generated frames, and in the last row the generated frames
/// themselves, which held-out cameras have none of. Empty for recorded clips.
pub(crate) fn rollout(clip: &Clip, scores: &[&(String, Scores)]) -> Comparison {
    let methods = with_renders(scores);
    let mut comparison = Comparison {
        note: "* not an input time: the method was not given this frame. The last row is what the world model made; the first \
               is what scores compare with."
            .to_owned(),
        ..Comparison::default()
    };
    if clip.rollout.is_none() || methods.is_empty() {
        return comparison;
    }
    let times = [middle(clip, true), middle(clip, false)];
    let views: Vec<(CameraIndex, FrameIndex)> = CameraIndex::first(clip.cameras.len())
        .flat_map(|camera| times.into_iter().flatten().map(move |frame| (camera, frame)))
        .filter(|&(camera, frame)| clip.target(camera, frame).is_some())
        .collect();
    let name = |&(camera, frame): &(CameraIndex, FrameIndex)| {
        let star = if clip.source_frames.contains(&frame) { "" } else { "*" };
        format!("{}, frame {frame}{star}", clip.cameras[camera.at()].id)
    };
    comparison.columns = views.iter().map(name).collect();
    let cells = |picture: &dyn Fn(CameraIndex, FrameIndex) -> Option<Picture>, what: &str| -> Vec<Option<Figure>> {
        let cell = |view: &(CameraIndex, FrameIndex)| picture(view.0, view.1)?.jpeg(format!("{} {what}", name(view)));
        views.iter().map(cell).collect()
    };
    comparison.rows.push((
        "recorded".to_owned(),
        cells(&|camera, frame| target(clip, camera, frame), "recorded"),
    ));
    for (method, scores) in methods {
        let render = |camera: CameraIndex, frame: FrameIndex| {
            let id = &clip.cameras[camera.at()].id;
            let view = scores
                .renders
                .iter()
                .find(|view| view.camera == *id && view.frame == frame)?;
            Picture::from_rgb(view.width, view.height, &view.rgb)
        };
        comparison
            .rows
            .push((method.clone(), cells(&render, &format!("by {method}"))));
    }
    let generated = cells(&|camera, frame| observation(clip, camera, frame), "generated");
    comparison.rows.push(("generated".to_owned(), generated));
    comparison
}
