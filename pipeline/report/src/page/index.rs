//! What a page says of many clips: a row a clip, and warnings that several have in common.

use std::collections::{BTreeMap, BTreeSet};

use maud::{Markup, html};
use rogs_schemas::records::scores::ScoreSheet;
use rogs_schemas::shown;
use rogs_score::summary::{ImageMetric, Metric, clip_value};
use rogs_score::tables::heading;

use crate::results::{ClipResults, RunResults};

/// Methods that have a column.
const MOST_METHODS: usize = 4;
/// Kinds of warnings that are listed.
const MOST_WARNINGS: usize = 40;

/// A row a clip, each with the page of the clip.
pub(super) fn clips(results: &RunResults, address: &dyn Fn(usize) -> String) -> Markup {
    let plain = results.sheets.iter().filter(|sheet| !sheet.method.contains('/'));
    let methods: BTreeSet<(&str, &str)> = plain.map(|sheet| (&*sheet.setting, &*sheet.method)).collect();
    let several = methods
        .iter()
        .any(|(setting, _)| methods.iter().any(|(other, _)| other != setting));
    let methods: Vec<(&str, &str)> = methods.into_iter().take(MOST_METHODS).collect();
    let mut sheets: BTreeMap<(&str, &str, &str), &ScoreSheet> = BTreeMap::new();
    for sheet in &results.sheets {
        sheets.insert((sheet.clip_id.as_str(), &sheet.setting, &sheet.method), sheet);
    }
    let name = |(setting, method): &(&str, &str)| match several {
        true => format!("{}, {method}", heading(setting)),
        false => (*method).to_owned(),
    };
    let psnr = |clip: &str, (setting, method): &(&str, &str), metric| {
        let sheet = sheets.get(&(clip, *setting, *method));
        let value = sheet.and_then(|sheet| clip_value(sheet, metric));
        value.map_or_else(|| "–".to_owned(), |value| format!("{value:.2}"))
    };
    html! {
        h2 id="clips" { "Clips" }
        table {
            tr {
                th { "clip" } th { "failures" } th { "warnings" }
                @for method in &methods { th { (name(method)) br; "source, novel PSNR dB" } }
            }
            @for (index, clip) in results.clips.iter().enumerate() {
                tr {
                    td { a href=(address(index)) { (clip.id) } }
                    td { (clip.failures.len()) }
                    td { (warnings_of(clip).count()) }
                    @for method in &methods {
                        td {
                            (psnr(&clip.id, method, Metric::Source(ImageMetric::Psnr))) ", "
                            (psnr(&clip.id, method, Metric::Novel(ImageMetric::Psnr)))
                        }
                    }
                }
            }
        }
    }
}

/// Warnings of a clip with the node that said them.
pub(super) fn warnings_of(clip: &ClipResults) -> impl Iterator<Item = (&str, &str)> {
    let attempts = clip.attempts.iter();
    attempts.flat_map(|(node, attempt)| attempt.warnings.iter().map(move |text| (node.as_str(), text.as_str())))
}

/// Every warning once, with the number of clips that have it.
pub(super) fn warnings(clips: &[ClipResults]) -> Markup {
    let mut found: BTreeMap<(&str, &str), BTreeSet<&str>> = BTreeMap::new();
    for clip in clips {
        for warning in warnings_of(clip) {
            found.entry(warning).or_default().insert(&clip.id);
        }
    }
    let count = found.len();
    let mut found: Vec<_> = found.into_iter().collect();
    found.sort_by_key(|(_, clips)| std::cmp::Reverse(clips.len()));
    html! {
        @if !found.is_empty() {
            h2 { "Warnings" }
            @for ((node, text), clips) in found.iter().take(MOST_WARNINGS) {
                div.warning { b { (node) } ": " (shown::line(text)) " (" (of_clips(clips)) ")" }
            }
            @if count > MOST_WARNINGS { p.note { (count - MOST_WARNINGS) " more kinds; those of a clip are on its page." } }
        }
    }
}

fn of_clips(clips: &BTreeSet<&str>) -> String {
    match clips.iter().next() {
        Some(only) if clips.len() == 1 => (*only).to_owned(),
        _ => format!("{} clips", clips.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warning_of_several_clips_is_told_once() {
        let clip = |id: &str, warnings: &[&str]| {
            let attempt = serde_json::json!({
                "unix_ms": 1, "clip_id": "x", "stage": "lift", "output": "o", "key": "0".repeat(32), "worker": "w",
                "outcome": "done", "seconds": {}, "peak_rss_bytes": 0, "threads": 1, "output_bytes": 0,
                "warnings": warnings,
            });
            ClipResults {
                id: id.to_owned(),
                attempts: vec![("lift".to_owned(), serde_json::from_value(attempt).unwrap())],
                ..ClipResults::default()
            }
        };
        let html = warnings(&[clip("cup", &["dark"]), clip("lid", &["dark", "<i>"])]).into_string();
        assert_eq!(html.matches("dark").count(), 1, "{html}");
        assert!(
            html.contains("dark (2 clips)") && html.contains("&lt;i&gt; (lid)"),
            "{html}"
        );
        assert!(warnings(&[]).into_string().is_empty());
    }
}
