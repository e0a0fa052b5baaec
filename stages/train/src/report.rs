//! Curves and samples of a run in one HTML page without outside references.

use std::fmt::Write;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value;

use crate::checkpoint::{RunFolder, replace};
use crate::error::{Error, Result};

const WIDTH: f64 = 460.0;
const HEIGHT: f64 = 170.0;
const MARGIN: f64 = 42.0;
/// Points of a curve; longer series are averaged in bins.
const BINS: usize = 200;

/// Writes `report.html` of a run's folder.
///
/// # Errors
/// When reading or writing fails.
pub(crate) fn write(folder: &RunFolder, title: &str, picture: &str, steps: u64) -> Result<()> {
    let lines = folder.lines("metrics.jsonl")?;
    let (evaluations, updates): (Vec<&Value>, Vec<&Value>) =
        lines.iter().partition(|line| line.get("evaluation").is_some());
    let mut page = format!(
        "<!doctype html><meta charset=\"utf-8\"><title>{title}</title><style>body{{font:14px sans-serif;margin:24px;\
         max-width:1500px}}svg{{background:#fafafa;margin:4px}}img{{max-width:100%}}td,th{{padding:2px 10px;\
         text-align:right}}pre{{background:#fafafa;padding:8px}}</style><h1>{title}</h1><p>{} of {steps} updates.</p>",
        updates.len()
    );
    let path = folder.path("settings.toml");
    let settings = std::fs::read_to_string(&path).map_err(Error::io(&path))?;
    let _ = write!(
        page,
        "<details><summary>Settings</summary><pre>{}</pre></details>",
        escaped(&settings)
    );
    page.push_str("<h2>Held-out clips</h2>");
    let mut table = String::new();
    if let Some(last) = evaluations.last() {
        for (key, _) in last["evaluation"]
            .as_object()
            .into_iter()
            .flatten()
            .filter(|(key, _)| *key != "clips")
        {
            let points: Vec<[f64; 2]> = evaluations
                .iter()
                .filter_map(|line| Some([line["step"].as_f64()?, line["evaluation"][key].as_f64()?]))
                .collect();
            page.push_str(&curve(key, &points));
            if let (Some(first), Some(last)) = (points.first(), points.last()) {
                let _ = write!(table, "<tr><th>{}<td>{:.4}<td>{:.4}", escaped(key), first[1], last[1]);
            }
        }
    }
    let _ = write!(page, "<table><tr><th><th>first<th>last{table}</table><h2>Losses</h2>");
    page.push_str(&curve("loss", &series(&updates, |line| line["loss"].as_f64())));
    if let Some(first) = updates.first() {
        for (key, _) in first["terms"].as_object().into_iter().flatten() {
            page.push_str(&curve(key, &series(&updates, |line| line["terms"][key].as_f64())));
        }
    }
    let _ = write!(page, "<h2>Samples</h2><p>{}</p>", escaped(picture));
    let samples = folder.path("samples");
    let mut pictures: Vec<_> = std::fs::read_dir(&samples)
        .map_err(Error::io(&samples))?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "png"))
        .collect();
    pictures.sort();
    let first_and_last: Vec<_> = match pictures.as_slice() {
        [] => Vec::new(),
        [one] => vec![one],
        [first, .., last] => vec![last, first],
    };
    for path in first_and_last {
        let bytes = std::fs::read(path).map_err(Error::io(path))?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let _ = write!(
            page,
            "<h3>after {} updates</h3><img alt=\"sample\" src=\"data:image/png;base64,{}\">",
            escaped(name.trim_start_matches('0')),
            STANDARD.encode(bytes)
        );
    }
    replace(&folder.path("report.html"), page.as_bytes())
}

/// A series over updates, averaged in bins.
fn series(updates: &[&Value], value: impl Fn(&Value) -> Option<f64>) -> Vec<[f64; 2]> {
    let points: Vec<[f64; 2]> = updates
        .iter()
        .filter_map(|line| Some([line["step"].as_f64()?, value(line)?]))
        .collect();
    let bin = points.len().div_ceil(BINS).max(1);
    let mean = |points: &[[f64; 2]]| {
        let count = points.len() as f64;
        [0, 1].map(|axis| points.iter().map(|point| point[axis]).sum::<f64>() / count)
    };
    points.chunks(bin).map(mean).collect()
}

/// One curve as SVG.
fn curve(title: &str, points: &[[f64; 2]]) -> String {
    let finite: Vec<[f64; 2]> = points.iter().copied().filter(|point| point[1].is_finite()).collect();
    let extent = |axis: usize| {
        let values = finite.iter().map(|point| point[axis]);
        let (low, high) = (
            values.clone().fold(f64::INFINITY, f64::min),
            values.fold(f64::NEG_INFINITY, f64::max),
        );
        if high > low {
            [low, high]
        } else {
            [low - 0.5, low + 0.5]
        }
    };
    if finite.is_empty() {
        return String::new();
    }
    let ([x0, x1], [y0, y1]) = (extent(0), extent(1));
    let place = |point: &[f64; 2]| {
        let x = MARGIN + (point[0] - x0) / (x1 - x0) * (WIDTH - MARGIN - 10.0);
        let y = HEIGHT - 22.0 - (point[1] - y0) / (y1 - y0) * (HEIGHT - 46.0);
        format!("{x:.1},{y:.1}")
    };
    let line: Vec<String> = finite.iter().map(place).collect();
    let title = escaped(title);
    let bottom = HEIGHT - 22.0;
    format!(
        "<svg width=\"{WIDTH}\" height=\"{HEIGHT}\" font-size=\"11\"><text x=\"{MARGIN}\" y=\"14\" font-weight=\"bold\">{title}\
         </text><text x=\"2\" y=\"30\">{y1:.3}</text><text x=\"2\" y=\"{bottom}\">{y0:.3}</text><text x=\"{MARGIN}\" y=\"{}\">{x0:.0}\
         </text><text x=\"{}\" y=\"{}\" text-anchor=\"end\">{x1:.0} updates</text><polyline fill=\"none\" stroke=\"#1763b0\" \
         stroke-width=\"1.5\" points=\"{}\"/></svg>",
        HEIGHT - 6.0,
        WIDTH - 10.0,
        HEIGHT - 6.0,
        line.join(" ")
    )
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}
