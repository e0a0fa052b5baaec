//! The section of one clip: what went wrong, what it is, pictures, scores, cost.

use std::path::Path;

use maud::{Markup, html};
use rogs_r4c::{Record, read_record};
use rogs_schemas::ledger::{Attempt, Failure};
use rogs_schemas::protocol::FailureCode;
use rogs_schemas::records::agreement::Agreements;
use rogs_schemas::records::clip::{CameraMount, Clip, ClipCamera, Rollout};
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::{ScoreSheet, Scores};
use rogs_schemas::{EpisodeFrame, FrameIndex, shown};
use rogs_score::origins;
use rogs_score::summary::ImageMetric::{AbsRel, Delta1, Lpips, Psnr, Rmse, Ssim};
use rogs_score::summary::{ImageMetric, Metric, clip_value};
use rogs_score::tables::heading;

use super::failure::failure;
use super::{agreement, index};
use crate::pictures::{self, Comparison, FieldFigures, Figure};
use crate::results::ClipResults;
use crate::scenes::RobotMesh;

/// The section of a clip, unfolded when `open`, with pictures when `with_pictures`; some of them show the robot's mesh.
pub(super) fn section(clip: &ClipResults, open: bool, with_pictures: bool, mesh: Option<&RobotMesh>) -> Markup {
    html! {
        details open[open] {
            summary { (clip.id) }
            @for own in &clip.failures { (failure(&own.node, &own.failure)) }
            @for (node, warning) in index::warnings_of(clip) { div.warning { (node) ": " (shown::line(warning)) } }
            @if with_pictures {
                (contents(clip, mesh))
            } @else {
                p.note { "Pictures are made for the first clips only; `rogs inspect` shows the files of this one." }
            }
            (costs(&clip.attempts))
        }
    }
}

/// What is in the files of a clip. Those that cannot be read are named.
fn contents(own: &ClipResults, mesh: Option<&RobotMesh>) -> Markup {
    let mut unreadable = Vec::new();
    let robot = read::<RobotMaps>(own.robot.as_deref(), "robot-maps", &mut unreadable);
    let mut scores = Vec::new();
    for (method, path) in &own.scores {
        let record = read::<Scores>(Some(path), "score", &mut unreadable);
        scores.extend(record.map(|record| (method.clone(), record)));
    }
    let agreements: Vec<Agreements> = (own.agreements.iter())
        .filter_map(|path| read(Some(path), "agreement", &mut unreadable))
        .collect();
    let records = [&own.clip, &own.rollout];
    let records = records.map(|path| read::<Clip>(path.as_deref(), "ingest", &mut unreadable));
    let both = records.iter().all(Option::is_some);
    let settings: Vec<Markup> = (records.iter().flatten())
        .map(|clip| {
            let figures = robot
                .as_ref()
                .map(|robot| field_figures(clip, robot, mesh, own, &mut unreadable));
            html! {
                @if both { h3 { (heading(clip.setting())) } }
                (of_setting(clip, robot.as_ref(), &agreements, &scores, &figures.unwrap_or_default()))
            }
        })
        .collect();
    html! {
        @for (stage, why) in &unreadable { (failure(stage, why)) }
        @for setting in settings { (setting) }
    }
}

/// The figures of the fields of a clip. One field is in memory at a time, with the times that are shown.
fn field_figures(
    clip: &Clip,
    robot: &RobotMaps,
    mesh: Option<&RobotMesh>,
    own: &ClipResults,
    unreadable: &mut Vec<(&'static str, Failure)>,
) -> Vec<(&'static str, Comparison)> {
    let wanted = pictures::wanted(&own.fields, clip.rollout.is_some());
    let mut figures = FieldFigures::new(clip, robot, mesh, &wanted);
    for file in figures.read_by(&wanted) {
        let added = figures.field(file).map_err(|error| not_read(&error));
        let added = added.and_then(|field| figures.add(file, &field).map_err(|error| not_read(&error)));
        unreadable.extend(added.err().map(|why| ("lift", why)));
    }
    figures.finish()
}

/// A clip as it was recorded or with generated observations, and what was made of it.
fn of_setting(
    clip: &Clip,
    robot: Option<&RobotMaps>,
    agreements: &[Agreements],
    scores: &[(String, Scores)],
    of_fields: &[(&'static str, Comparison)],
) -> Markup {
    let own = scores
        .iter()
        .filter(|(_, scores)| scores.summary.setting == clip.setting());
    let own: Vec<&(String, Scores)> = own.collect();
    let agreements = agreements
        .iter()
        .find(|agreements| agreements.setting == clip.setting());
    html! {
        (facts(clip))
        @if let Some(agreements) = agreements { (agreement::table(agreements)) }
        (figures("Inputs with the outline of the robot mesh", &pictures::inputs(clip, robot)))
        @if let Some(robot) = robot.filter(|_| clip.rollout.is_none()) {
            (figures("Mesh depth (camera z) and link ids at the source times", &pictures::robot(clip, robot)))
        }
        (comparison("Reference, predictions, errors", &pictures::comparison(clip, &own)))
        (comparison("Recorded, predicted, generated", &pictures::rollout(clip, &own)))
        @for (title, figure) in of_fields { (comparison(title, figure)) }
        @for (method, scores) in own {
            (score_table(method, &scores.summary))
            (figures(
                &format!("{method}: reference, render, error, rendered depth at query times"),
                &pictures::renders(clip, scores),
            ))
        }
    }
}

/// A record; a note on the file when it cannot be read.
fn read<R: Record>(
    path: Option<&Path>,
    stage: &'static str,
    unreadable: &mut Vec<(&'static str, Failure)>,
) -> Option<R> {
    let (record, _) = read_record::<R>(path?)
        .map_err(|error| unreadable.push((stage, not_read(&error))))
        .ok()?;
    Some(record)
}

/// A file that is there and cannot be read.
fn not_read(error: &dyn std::error::Error) -> Failure {
    Failure {
        code: FailureCode::Io,
        message: error.to_string(),
        hint: Some("`rogs verify --repair RUN` makes it again".to_owned()),
    }
}

/// Where the clip comes from and what it holds.
fn facts(clip: &Clip) -> Markup {
    let cameras: Vec<String> = clip.cameras.iter().map(camera).collect();
    let frames = |frames: &[FrameIndex]| frames.iter().map(FrameIndex::to_string).collect::<Vec<_>>().join(" ");
    let rows = [
        ("episode", clip.episode_id.clone()),
        ("layout", clip.layout.clone()),
        ("task", clip.task.clone()),
        ("calibration", clip.calibration_note.clone()),
        ("cameras", cameras.join(", ")),
        (
            "observations",
            clip.rollout
                .as_ref()
                .map_or("recorded images".to_owned(), |own| generated(clip, own)),
        ),
        ("frames of the episode", interval(&clip.episode_frames)),
        ("source frames, counted in the clip", frames(&clip.source_frames)),
        ("query frames, counted in the clip", frames(&clip.query_frames)),
    ];
    html! {
        table.facts {
            @for (name, value) in rows.iter().filter(|(_, value)| !value.is_empty()) {
                tr { th { (name) } td { (shown::line(value)) } }
            }
        }
    }
}

/// Frames that are evenly apart, in words.
fn interval(frames: &[EpisodeFrame]) -> String {
    match frames {
        [first, .., last] => format!("{first} to {last}, {} of them", frames.len()),
        [only] => only.to_string(),
        [] => String::new(),
    }
}

/// Which model, and how near its first frames are to the recorded ones.
fn generated(clip: &Clip, rollout: &Rollout) -> String {
    let model = if rollout.model.is_empty() {
        "a world model"
    } else {
        &rollout.model
    };
    let figures = clip.cameras.iter().zip(&rollout.first_frame_psnr_db);
    let figures: Vec<String> = figures
        .filter_map(|(camera, figure)| Some(format!("{} {:.1} dB", camera.id, (*figure)?)))
        .collect();
    format!(
        "frames of {model} ({} on disk); first frame against the first recorded one: {}",
        rollout.layout,
        if figures.is_empty() {
            "not known".to_owned()
        } else {
            figures.join(", ")
        }
    )
}

fn camera(camera: &ClipCamera) -> String {
    let mount = match &camera.mount {
        CameraMount::Fixed { .. } => "fixed".to_owned(),
        CameraMount::Trajectory { .. } => "trajectory".to_owned(),
        CameraMount::HandEye { link, .. } => format!("on {link}"),
    };
    format!("{} ({:?}, {mount})", camera.id, camera.role)
}

fn figures(title: &str, figures: &[Figure]) -> Markup {
    html! {
        @if !figures.is_empty() {
            h3 { (title) }
            @for figure in figures { figure { figcaption { (figure.caption) } (image(figure)) } }
        }
    }
}

fn image(figure: &Figure) -> Markup {
    rogs_pages::picture(&figure.caption, figure.media_type, &figure.bytes)
}

/// Reference, predictions and error maps of chosen views, methods side by side.
fn comparison(title: &str, comparison: &Comparison) -> Markup {
    html! {
        @if !comparison.rows.is_empty() {
            h3 { (title) }
            table.grid {
                tr { th {} @for column in &comparison.columns { th { (column) } } }
                @for (label, cells) in &comparison.rows {
                    tr {
                        th { (label) }
                        @for cell in cells {
                            td { @if let Some(figure) = cell { (image(figure)) } @else { "–" } }
                        }
                    }
                }
            }
            p.note { (comparison.note) }
        }
    }
}

/// Column head, metric and digits of the scores of one clip.
const COLUMNS: [(&str, ImageMetric, usize); 6] = [
    ("PSNR dB", Psnr, 2),
    ("SSIM", Ssim, 3),
    ("LPIPS", Lpips, 3),
    ("AbsRel", AbsRel, 3),
    ("RMSE m", Rmse, 3),
    ("δ1 %", Delta1, 1),
];

/// The metric of a group of images.
type OfImages = fn(ImageMetric) -> Metric;

/// The scores of one method on the clip.
fn score_table(method: &str, sheet: &ScoreSheet) -> Markup {
    let groups: [(&str, bool, OfImages); 2] = [("source", true, Metric::Source), ("novel", false, Metric::Novel)];
    let images = |source: bool| sheet.images.iter().filter(|image| image.source_view == source).count();
    html! {
        h3 { (method) }
        table {
            tr { th { "views" } @for (name, ..) in COLUMNS { th { (name) } } th { "images" } }
            @for (name, source, of_group) in groups {
                tr {
                    td { (name) }
                    @for (_, metric, digits) in COLUMNS { td { (number(clip_value(sheet, of_group(metric)), digits)) } }
                    td { (images(source)) }
                }
            }
        }
        p {
            "robot EPE " (number(clip_value(sheet, Metric::RobotEpe), 2))
            " mm, robot depth error " (number(clip_value(sheet, Metric::RobotDepth), 1)) " mm"
            @if let Some(note) = &sheet.lpips_note { "; LPIPS: " (note) }
            @for note in origins::described(sheet) { "; " (note) }
        }
    }
}

/// Seconds and memory of every unit.
fn costs(attempts: &[(String, Attempt)]) -> Markup {
    let total = |attempt: &Attempt| attempt.seconds.get("total").copied().unwrap_or_default();
    html! {
        @if !attempts.is_empty() {
            h3 { "Cost" }
            table {
                tr { th { "stage" } th { "seconds" } th { "peak memory MiB" } }
                @for (node, attempt) in attempts {
                    tr {
                        td { (node) }
                        td { (number(Some(total(attempt)), 2)) }
                        td { (attempt.peak_rss_bytes >> 20) }
                    }
                }
            }
        }
    }
}

/// A cell for an optional number.
fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_break_out_of_the_page() {
        let clip = ClipResults {
            id: "<script>alert(1)</script>".to_owned(),
            ..ClipResults::default()
        };
        let html = section(&clip, false, true, None).into_string();
        assert!(!html.contains("<script>") && html.contains("&lt;script&gt;"), "{html}");
    }
}
