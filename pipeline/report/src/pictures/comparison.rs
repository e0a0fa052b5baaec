//! The same views by every method, side by side.

use rogs_schemas::FrameIndex;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::scores::Scores;

use super::colours::error_map;
use super::frames::frame_rgb;
use super::picture::{Figure, Picture};

/// A table of pictures: the same views by every method.
#[derive(Default)]
pub(crate) struct Comparison {
    pub(crate) columns: Vec<String>,
    /// Label and one cell a column.
    pub(crate) rows: Vec<(String, Vec<Option<Figure>>)>,
}

/// Methods of a comparison at most; all of them have sheets of their own below it.
const MAX_METHODS: usize = 6;

/// Reference, prediction and error map of source and held-out cameras at an input time and at another one, where the query
/// plan has both.
pub(crate) fn comparison(clip: &Clip, scores: &[(String, Scores)]) -> Comparison {
    let methods: Vec<_> = scores
        .iter()
        .filter(|(_, scores)| !scores.renders.is_empty())
        .take(MAX_METHODS)
        .collect();
    let mut comparison = Comparison {
        columns: vec!["reference".to_owned()],
        rows: Vec::new(),
    };
    if methods.is_empty() {
        return comparison;
    }
    for (method, _) in &methods {
        comparison.columns.extend([method.clone(), "error".to_owned()]);
    }
    // Times in the middle of the plan: at the ends the first input frame hides what time does.
    let middle = |input: bool| {
        let frames: Vec<FrameIndex> = (clip.query_frames.iter().copied())
            .filter(|frame| clip.source_frames.contains(frame) == input)
            .collect();
        frames.get(frames.len() / 2).copied()
    };
    let times = [(middle(true), "input time"), (middle(false), "not an input time")];
    let cameras = clip.cameras.iter().filter(|camera| camera.rgb.is_some());
    for camera in cameras {
        let group = if camera.partner.is_some() { "novel" } else { "source" };
        for (frame, kind) in times.iter().filter_map(|(frame, kind)| Some(((*frame)?, kind))) {
            let Some(reference) = frame_rgb(clip, camera, frame) else {
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
