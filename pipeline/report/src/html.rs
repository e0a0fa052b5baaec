//! HTML of the report: tables, sections. No scripts.

use std::fmt::Write as _;

use rogs_pages::{Plot, escape, inlined, svg};
use rogs_schemas::records::clip::{CameraMount, Clip};
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::scores::ScoreSheet;

use crate::page::{ClipReport, FailureReport, ReportTable, TimingReport};
use crate::pictures::{Comparison, Figure};

const STYLE: &str = "
:root{color-scheme:light dark}
body{font:15px/1.45 system-ui,sans-serif;max-width:1480px;margin:2em auto;padding:0 1em}
h1{font-size:1.6em} h2{font-size:1.25em;margin-top:2em} h3{font-size:1.05em}
table{border-collapse:collapse;margin:.6em 0} td,th{padding:.25em .7em;border-bottom:1px solid #8885;text-align:right}
td:first-child,th:first-child{text-align:left}
figure{margin:.4em 0} figcaption{font-size:.85em;opacity:.75} img{max-width:100%;height:auto;image-rendering:auto}
.banner{border:3px solid #c60;background:#fa03;padding:.8em 1em;font-weight:600;margin:1em 0}
.failure{border-left:4px solid #c22;padding:.3em .8em;margin:.5em 0;background:#c221}
.warning{border-left:4px solid #c90;padding:.2em .8em;margin:.3em 0}
.plots{display:flex;flex-wrap:wrap;gap:1em} .plots figcaption{font-weight:600;opacity:1}
.grid td,.grid th{border:0;padding:2px;text-align:center;font-weight:500;font-size:.85em} .grid th:first-child{text-align:right;max-width:11em}
.note{opacity:.75} details{border-top:1px solid #8885;padding:.6em 0} summary{cursor:pointer;font-size:1.15em;font-weight:600}
";

/// A cell for an optional number.
fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |value| format!("{value:.digits$}"))
}

/// Mean of the values that exist.
fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let (sum, count) = values
        .flatten()
        .fold((0.0, 0u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// The page.
pub(crate) struct Page {
    html: String,
}

impl Page {
    pub(crate) fn new(run_name: &str) -> Self {
        let title = escape(run_name);
        let html = format!(
            "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n\
             <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">\n\
             <meta name=\"viewport\" content=\"width=device-width\">\n\
             <title>rogs: {title}</title><style>{STYLE}</style></head><body>\n<h1>rogs: {title}</h1>\n"
        );
        Self { html }
    }

    pub(crate) fn facts(&mut self, facts: &[(String, String)]) {
        self.html.push_str("<table>\n");
        for (name, value) in facts {
            let _ = writeln!(
                self.html,
                "<tr><th>{}</th><td>{}</td></tr>",
                escape(name),
                escape(value)
            );
        }
        self.html.push_str("</table>\n");
    }

    /// A loud banner when some weights are not trained: the numbers then say nothing about the method.
    pub(crate) fn untrained_banner<'a>(&mut self, weights: impl Iterator<Item = &'a WeightsInfo>) {
        let mut names: Vec<String> = weights
            .filter(|info| !info.trained)
            .map(|info| format!("{} ({})", info.configuration, info.description))
            .collect();
        names.sort();
        names.dedup();
        if !names.is_empty() {
            let _ = writeln!(
                self.html,
                "<div class=\"banner\">UNTRAINED WEIGHTS: {}. Fields made with seeded random weights exercise the pipeline; \
                 their renders and scores say nothing about the method.</div>",
                escape(&names.join("; "))
            );
        }
    }

    pub(crate) fn table(&mut self, table: &ReportTable) {
        let _ = writeln!(self.html, "<h2>{}</h2>\n<table><tr>", escape(&table.title));
        for column in &table.columns {
            let _ = write!(self.html, "<th>{}</th>", escape(column));
        }
        self.html.push_str("</tr>\n");
        for row in &table.rows {
            self.html.push_str("<tr>");
            for cell in row {
                let _ = write!(self.html, "<td>{}</td>", escape(cell));
            }
            self.html.push_str("</tr>\n");
        }
        self.html.push_str("</table>\n");
        for footnote in &table.footnotes {
            let _ = writeln!(self.html, "<p class=\"note\">{}</p>", escape(footnote));
        }
    }

    pub(crate) fn plots(&mut self, plots: &[Plot]) {
        let drawn: Vec<(&Plot, String)> = plots.iter().map(|plot| (plot, svg(plot))).collect();
        if drawn.iter().all(|(_, svg)| svg.is_empty()) {
            return;
        }
        self.html.push_str("<h2>Figures</h2>\n<div class=\"plots\">\n");
        for (plot, svg) in drawn.iter().filter(|(_, svg)| !svg.is_empty()) {
            let title = escape(&plot.title);
            let _ = writeln!(self.html, "<figure><figcaption>{title}</figcaption>{svg}</figure>");
        }
        self.html.push_str("</div>\n");
    }

    pub(crate) fn failures(&mut self, clips: &[ClipReport]) {
        if clips.iter().all(|clip| clip.failures.is_empty()) {
            return;
        }
        self.html.push_str("<h2>Failures</h2>\n");
        for clip in clips {
            for failure in &clip.failures {
                self.html
                    .push_str(&failure_html(&format!("{}, {}", clip.clip_id, failure.stage), failure));
            }
        }
    }

    pub(crate) fn raw(&mut self, html: &str) {
        self.html.push_str(html);
    }

    pub(crate) fn finish(mut self) -> String {
        self.html.push_str("</body></html>\n");
        self.html
    }
}

fn failure_html(place: &str, failure: &FailureReport) -> String {
    let hint = failure
        .hint
        .as_ref()
        .map(|hint| format!("<br>→ {}", escape(hint)))
        .unwrap_or_default();
    format!(
        "<div class=\"failure\"><b>{}</b>: {}{hint}</div>\n",
        escape(place),
        escape(&failure.message)
    )
}

/// The part of one clip.
pub(crate) struct Section {
    html: String,
}

impl Section {
    pub(crate) fn new(clip_id: &str, open: bool) -> Self {
        let open = if open { " open" } else { "" };
        Self {
            html: format!("<details{open}><summary>{}</summary>\n", escape(clip_id)),
        }
    }

    pub(crate) fn note(&mut self, text: &str) {
        let _ = writeln!(self.html, "<p class=\"note\">{}</p>", escape(text));
    }

    pub(crate) fn failures(&mut self, failures: &[FailureReport]) {
        for failure in failures {
            self.html.push_str(&failure_html(&failure.stage, failure));
        }
    }

    pub(crate) fn warnings(&mut self, warnings: &[(String, String)]) {
        for (stage, warning) in warnings {
            let _ = writeln!(
                self.html,
                "<div class=\"warning\">{}: {}</div>",
                escape(stage),
                escape(warning)
            );
        }
    }

    pub(crate) fn clip_facts(&mut self, clip: &Clip) {
        let mounts: Vec<String> = clip
            .cameras
            .iter()
            .map(|camera| {
                let mount = match &camera.mount {
                    CameraMount::Fixed { .. } => "fixed".to_owned(),
                    CameraMount::Trajectory { .. } => "trajectory".to_owned(),
                    CameraMount::HandEye { link, .. } => format!("on {link}"),
                };
                format!("{} ({:?}, {mount})", camera.id, camera.role)
            })
            .collect();
        let frames = |frames: &[u32]| frames.iter().map(u32::to_string).collect::<Vec<_>>().join(" ");
        let rows = [
            ("episode", clip.episode_id.clone()),
            ("layout", clip.layout.clone()),
            ("task", clip.task.clone()),
            ("calibration", clip.calibration_note.clone()),
            ("cameras", mounts.join(", ")),
            ("source frames", frames(&clip.source_frames)),
            ("query frames", frames(&clip.query_frames)),
        ];
        self.html.push_str("<table>");
        for (name, value) in rows.iter().filter(|(_, value)| !value.is_empty()) {
            let _ = writeln!(
                self.html,
                "<tr><th>{name}</th><td style=\"text-align:left\">{}</td></tr>",
                escape(value)
            );
        }
        self.html.push_str("</table>\n");
    }

    pub(crate) fn scores(&mut self, method: &str, sheet: &ScoreSheet) {
        let _ = writeln!(
            self.html,
            "<h3>{}</h3><table><tr><th>views</th><th>PSNR dB</th><th>SSIM</th><th>LPIPS</th><th>AbsRel</th><th>RMSE m</th><th>δ1 %</th><th>images</th></tr>",
            escape(method)
        );
        for (name, source) in [("source", true), ("novel", false)] {
            let images: Vec<_> = sheet
                .images
                .iter()
                .filter(|image| image.source_view == source)
                .collect();
            let _ = writeln!(
                self.html,
                "<tr><td>{name}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                number(mean(images.iter().map(|image| image.psnr)), 2),
                number(mean(images.iter().map(|image| image.ssim)), 3),
                number(mean(images.iter().map(|image| image.lpips)), 3),
                number(mean(images.iter().map(|image| image.absrel)), 3),
                number(mean(images.iter().map(|image| image.rmse_m)), 3),
                number(
                    mean(images.iter().map(|image| image.delta1.map(|value| 100.0 * value))),
                    1
                ),
                images.len(),
            );
        }
        let _ = writeln!(
            self.html,
            "</table><p>robot EPE {} mm, robot depth error {} mm{}</p>",
            number(mean(sheet.tracks.iter().map(|track| track.epe_mm)), 2),
            number(mean(sheet.robot_depth.iter().map(|depth| depth.robot_depth_mm)), 1),
            sheet
                .lpips_note
                .as_ref()
                .map(|note| format!("; LPIPS: {}", escape(note)))
                .unwrap_or_default(),
        );
    }

    pub(crate) fn figures(&mut self, title: &str, figures: Vec<Figure>) {
        if figures.is_empty() {
            return;
        }
        let _ = writeln!(self.html, "<h3>{}</h3>", escape(title));
        for figure in figures {
            let caption = escape(&figure.caption);
            let _ = writeln!(
                self.html,
                "<figure><figcaption>{caption}</figcaption><img alt=\"{caption}\" src=\"{}\"></figure>",
                inlined(figure.media_type, &figure.bytes)
            );
        }
    }

    /// Reference, predictions and error maps of chosen views, methods side by side.
    pub(crate) fn comparison(&mut self, comparison: &Comparison) {
        if comparison.rows.is_empty() {
            return;
        }
        self.html
            .push_str("<h3>Reference, predictions, errors</h3>\n<table class=\"grid\"><tr><th></th>");
        for column in &comparison.columns {
            let _ = write!(self.html, "<th>{}</th>", escape(column));
        }
        self.html.push_str("</tr>\n");
        for (label, cells) in &comparison.rows {
            let _ = write!(self.html, "<tr><th>{}</th>", escape(label));
            for cell in cells {
                match cell {
                    Some(figure) => {
                        let _ = write!(
                            self.html,
                            "<td><img alt=\"{}\" src=\"{}\"></td>",
                            escape(&figure.caption),
                            inlined(figure.media_type, &figure.bytes)
                        );
                    }
                    None => self.html.push_str("<td>–</td>"),
                }
            }
            self.html.push_str("</tr>\n");
        }
        let _ = writeln!(
            self.html,
            "</table><p class=\"note\">Error maps: mean absolute difference of the three channels, black 0 to yellow {} of 255 \
             and more. Input times were given to the method, the others were not.</p>",
            crate::pictures::FULL_ERROR
        );
    }

    pub(crate) fn timings(&mut self, timings: &[TimingReport]) {
        if timings.is_empty() {
            return;
        }
        self.html
            .push_str("<h3>Cost</h3><table><tr><th>stage</th><th>seconds</th><th>peak memory MiB</th></tr>\n");
        for timing in timings {
            let _ = writeln!(
                self.html,
                "<tr><td>{}</td><td>{:.2}</td><td>{}</td></tr>",
                escape(&timing.stage),
                timing.seconds,
                timing.peak_rss_bytes >> 20
            );
        }
        self.html.push_str("</table>\n");
    }

    pub(crate) fn finish(mut self) -> String {
        self.html.push_str("</details>\n");
        self.html
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_break_out_of_the_page() {
        let html = Section::new("<script>alert(1)</script>", false).finish();
        assert!(!html.contains("<script>"));
        assert_eq!(escape("a\"b'c&"), "a&quot;b&#39;c&amp;");
    }

    #[test]
    fn a_mean_over_nothing_is_a_dash() {
        assert_eq!(number(mean([None, None].into_iter()), 2), "–");
        assert_eq!(number(mean([Some(1.0), None, Some(2.0)].into_iter()), 2), "1.50");
    }
}
