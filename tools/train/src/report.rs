//! Curves and samples of a run in one HTML page without outside references.

use std::path::{Path, PathBuf};

use maud::{Markup, html};
use rogs_pages::{Plot, PlotPoint, Series, picture};
use serde_json::Value;

use crate::checkpoint::RunFolder;
use crate::error::{Error, Result};

/// Points of a curve; longer series are averaged in bins.
const BINS: usize = 200;

const STYLE: &str = "body{font:14px sans-serif;margin:24px;max-width:1500px}\
                     figure{display:inline-block;margin:4px}figcaption{font-weight:600}img{max-width:100%}\
                     td,th{padding:2px 10px;text-align:right}pre{background:#fafafa;padding:8px}";

/// What a run's folder says about it.
struct Run<'a> {
    /// Updates the run is going to make.
    steps: u64,
    /// The settings file.
    settings: String,
    /// Lines of the metrics about held-out clips: `{"step": .., "evaluation": {..}}`.
    evaluations: Vec<&'a Value>,
    /// Lines of the metrics about updates: `{"step": .., "loss": .., "terms": {..}}`.
    updates: Vec<&'a Value>,
    /// What the samples show.
    caption: &'a str,
    /// Updates that had been made, as words, and PNG bytes; the last sample first.
    samples: Vec<(String, Vec<u8>)>,
}

/// Writes `report.html` of a run's folder. `caption` says what the samples show.
///
/// # Errors
/// When reading or writing fails.
pub(crate) fn write(folder: &RunFolder, title: &str, caption: &str, steps: u64) -> Result<()> {
    let lines = folder.lines("metrics.jsonl")?;
    let (evaluations, updates) = lines.iter().partition(|line| line.get("evaluation").is_some());
    let settings = folder.path("settings.toml");
    let run = Run {
        steps,
        settings: std::fs::read_to_string(&settings).map_err(Error::io(&settings))?,
        evaluations,
        updates,
        caption,
        samples: samples(&folder.path("samples"))?,
    };
    let page = rogs_pages::page(title, STYLE, &body(&run)).into_string();
    Ok(rogs_files::write_bytes(&folder.path("report.html"), page.as_bytes())?)
}

/// The last and the first sample.
fn samples(folder: &Path) -> Result<Vec<(String, Vec<u8>)>> {
    let mut pictures: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(Error::io(folder))?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "png"))
        .collect();
    pictures.sort();
    let shown: Vec<&PathBuf> = match pictures.as_slice() {
        [] => Vec::new(),
        [one] => vec![one],
        [first, .., last] => vec![last, first],
    };
    let read = |path: &PathBuf| {
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let bytes = std::fs::read(path).map_err(Error::io(path))?;
        Ok((name.trim_start_matches('0').to_owned(), bytes))
    };
    shown.into_iter().map(read).collect()
}

fn body(run: &Run<'_>) -> Markup {
    html! {
        p { (run.updates.len()) " of " (run.steps) " updates." }
        details { summary { "Settings" } pre { (run.settings) } }
        h2 { "Held-out clips" }
        (held_out(&run.evaluations))
        h2 { "Losses" }
        (losses(&run.updates))
        h2 { "Samples" }
        p { (run.caption) }
        @for (updates, bytes) in &run.samples {
            h3 { "after " (updates) " updates" }
            (picture("sample", "image/png", bytes))
        }
    }
}

/// A curve a score, then the first and last value of each.
fn held_out(evaluations: &[&Value]) -> Markup {
    let scores = evaluations.last().and_then(|last| last["evaluation"].as_object());
    let keys = scores
        .into_iter()
        .flatten()
        .map(|(key, _)| key)
        .filter(|key| *key != "clips");
    let scores: Vec<(&String, Vec<[f64; 2]>)> = keys
        .map(|key| (key, points(evaluations, |line| line["evaluation"][key].as_f64())))
        .collect();
    html! {
        @for (key, points) in &scores { (curve(key, points)) }
        table {
            tr { th {} th { "first" } th { "last" } }
            @for (key, points) in &scores {
                @if let (Some([_, first]), Some([_, last])) = (points.first(), points.last()) {
                    tr { th { (key) } td { (format!("{first:.4}")) } td { (format!("{last:.4}")) } }
                }
            }
        }
    }
}

/// The loss, then each of its terms.
fn losses(updates: &[&Value]) -> Markup {
    let terms = updates.first().and_then(|first| first["terms"].as_object());
    html! {
        (curve("loss", &in_bins(&points(updates, |line| line["loss"].as_f64()))))
        @for (key, _) in terms.into_iter().flatten() {
            (curve(key, &in_bins(&points(updates, |line| line["terms"][key].as_f64()))))
        }
    }
}

/// Update and value of the lines that have one.
fn points(lines: &[&Value], value: impl Fn(&Value) -> Option<f64>) -> Vec<[f64; 2]> {
    let point = |line: &&Value| Some([line["step"].as_f64()?, value(line)?]);
    lines.iter().filter_map(point).collect()
}

/// A series averaged so that at most [`BINS`] points are left.
fn in_bins(points: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let mean = |points: &[[f64; 2]]| {
        let count = points.len() as f64;
        [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / count)
    };
    points.chunks(points.len().div_ceil(BINS).max(1)).map(mean).collect()
}

/// One curve as a figure; nothing without points.
fn curve(title: &str, points: &[[f64; 2]]) -> Markup {
    let point = |&[x, y]: &[f64; 2]| PlotPoint {
        x,
        y,
        ..PlotPoint::default()
    };
    let plot = Plot {
        title: title.to_owned(),
        x_label: "updates".to_owned(),
        series: vec![Series {
            label: String::new(),
            points: points.iter().map(point).collect(),
        }],
        lines: true,
        bare: true,
        ..Plot::default()
    };
    plot.figure().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use expect_test::expect_file;
    use serde_json::json;

    use super::*;

    #[test]
    fn the_page_of_a_small_run() {
        let evaluation = |step: u64, psnr: f64| json!({ "step": step, "evaluation": { "clips": 2, "psnr": psnr } });
        let update = |step: u64| {
            let loss = 1.0 / (1.0 + step as f64);
            json!({ "step": step, "loss": loss, "terms": { "depth <m>": 0.25 * loss, "rgb": 0.75 * loss } })
        };
        let (evaluations, updates) = ([evaluation(2, 14.0), evaluation(4, 15.5)], [0, 1, 2, 3].map(update));
        let run = Run {
            steps: 8,
            settings: "seed = 7 # \"<b>\"\n".to_owned(),
            evaluations: evaluations.iter().collect(),
            updates: updates.iter().collect(),
            caption: "Input & render.",
            samples: vec![("4".to_owned(), vec![4]), ("2".to_owned(), vec![2])],
        };
        let page = rogs_pages::page("Training of <Stage 1>", STYLE, &body(&run)).into_string();
        expect_file!["../tests/expected/report.html"].assert_eq(&(page.replace("><", ">\n<") + "\n"));
    }

    #[test]
    fn long_series_are_averaged() {
        let points: Vec<[f64; 2]> = (0..500).map(|step| [f64::from(step), 1.0]).collect();
        let binned = in_bins(&points);
        assert_eq!((binned.len(), binned[0]), (167, [1.0, 1.0]));
        assert!(in_bins(&[]).is_empty());
    }
}
