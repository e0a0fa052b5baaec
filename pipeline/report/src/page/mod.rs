//! The page of a run: facts, tables, plots, failures, then a section a clip. No scripts.

pub(crate) mod agreement;
mod clip;
mod failure;

use std::collections::BTreeSet;

use maud::{Markup, html};
use rogs_score::tables::Table;

use crate::forms::to_html;
use crate::plots::{bars, plots};
use crate::results::{ClipResults, RunResults};

pub(crate) const STYLE: &str = include_str!("style.css");

/// The page with these tables; the first `picture_clips` clips have pictures, the others are listed.
pub(crate) fn page(results: &RunResults, tables: &[Table], picture_clips: usize) -> Markup {
    let body = html! {
        (facts(results))
        (untrained_banner(results))
        @for table in tables { (to_html(table)) }
        (figures(results))
        (failures(&results.clips))
        @for (index, clip) in results.clips.iter().enumerate() {
            (clip::section(clip, index == 0, index < picture_clips))
        }
    };
    rogs_pages::page(&format!("rogs: {}", results.plan.name), STYLE, &body)
}

/// Most lines about which frames of their episodes the clips are.
const INTERVALS: usize = 4;

/// What was run, and by which version.
fn facts(results: &RunResults) -> Markup {
    let failed = results.clips.iter().filter(|clip| !clip.failures.is_empty()).count();
    let clips = format!("{} without failures, {failed} with", results.clips.len() - failed);
    html! {
        table {
            tr { th { "clips" } td { (clips) } }
            @if let Some(selection) = &results.plan.selection { tr { th { "selection" } td { (selection.describe()) } } }
            @for interval in results.plan.clip_intervals().iter().take(INTERVALS) {
                tr { th { "frames" } td { (interval) } }
            }
            tr { th { "setting" } td { (results.plan.setting) } }
            tr { th { "variants" } td { (results.plan.variants.join(", ")) } }
            tr { th { "program" } td { "rogs " (env!("CARGO_PKG_VERSION")) } }
        }
    }
}

/// A loud banner when some weights are not trained: the numbers then say nothing about the method.
fn untrained_banner(results: &RunResults) -> Markup {
    let weights = results.sheets.iter().flat_map(|sheet| &sheet.weights);
    let names: BTreeSet<String> = weights
        .filter(|info| !info.trained)
        .map(|info| format!("{} ({})", info.configuration, info.description))
        .collect();
    html! {
        @if !names.is_empty() {
            div.banner {
                "UNTRAINED WEIGHTS: " (names.into_iter().collect::<Vec<_>>().join("; "))
                ". Fields made with seeded random weights exercise the pipeline; \
                 their renders and scores say nothing about the method."
            }
        }
    }
}

fn figures(results: &RunResults) -> Markup {
    let bars = bars(&results.sheets);
    let plots = plots(&results.sheets);
    let plots = plots.iter().filter_map(rogs_pages::Plot::figure);
    let figures: Vec<Markup> = bars.iter().filter_map(rogs_pages::Bars::figure).chain(plots).collect();
    html! {
        @if !figures.is_empty() {
            h2 { "Figures" }
            div.plots { @for figure in figures { (figure) } }
        }
    }
}

fn failures(clips: &[ClipResults]) -> Markup {
    html! {
        @if clips.iter().any(|clip| !clip.failures.is_empty()) {
            h2 { "Failures" }
            @for failure in clips.iter().flat_map(|clip| &clip.failures) {
                (failure::failure(&format!("{}, {}", failure.clip, failure.node), &failure.failure))
            }
        }
    }
}
