//! Curves and samples of a run in one HTML page without outside references.

use std::fmt::Write;

use rogs_pages::{Plot, PlotPoint, Series, escape, inlined, svg};
use serde_json::Value;

use crate::checkpoint::{RunFolder, replace};
use crate::error::{Error, Result};

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
         max-width:1500px}}figure{{display:inline-block;margin:4px}}figcaption{{font-weight:600}}img{{max-width:100%}}td,th{{padding:2px 10px;\
         text-align:right}}pre{{background:#fafafa;padding:8px}}</style><h1>{title}</h1><p>{} of {steps} updates.</p>",
        updates.len()
    );
    let path = folder.path("settings.toml");
    let settings = std::fs::read_to_string(&path).map_err(Error::io(&path))?;
    let _ = write!(
        page,
        "<details><summary>Settings</summary><pre>{}</pre></details>",
        escape(&settings)
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
                let _ = write!(table, "<tr><th>{}<td>{:.4}<td>{:.4}", escape(key), first[1], last[1]);
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
    let _ = write!(page, "<h2>Samples</h2><p>{}</p>", escape(picture));
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
            "<h3>after {} updates</h3><img alt=\"sample\" src=\"{}\">",
            escape(name.trim_start_matches('0')),
            inlined("image/png", &bytes)
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

/// One curve as a figure.
fn curve(title: &str, points: &[[f64; 2]]) -> String {
    let point = |&[x, y]: &[f64; 2]| PlotPoint {
        x,
        y,
        name: String::new(),
    };
    let plot = svg(&Plot {
        title: title.to_owned(),
        x_label: "updates".to_owned(),
        series: vec![Series {
            label: String::new(),
            points: points.iter().map(point).collect(),
        }],
        lines: true,
        bare: true,
        ..Plot::default()
    });
    if plot.is_empty() {
        return plot;
    }
    format!("<figure><figcaption>{}</figcaption>{plot}</figure>", escape(title))
}
