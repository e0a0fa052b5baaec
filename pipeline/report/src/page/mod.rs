//! The page of a run: players, facts, plots, tables, failures, then a section a clip, and what is folded.

pub(crate) mod agreement;
mod clip;
mod failure;

use std::collections::BTreeSet;

use maud::{Markup, html};
use rogs_score::tables::{Table, TableId};

use crate::forms::to_html;
use crate::players::{self, Player};
use crate::plots::{bars, plots};
use crate::results::{ClipResults, RunResults};

pub(crate) const STYLE: &str = include_str!("style.css");

/// The page with these tables and players; the first `picture_clips` clips have pictures, the others are listed.
pub(crate) fn page(results: &RunResults, tables: &[Table], players: &[Player], picture_clips: usize) -> Markup {
    let body = html! {
        (players::section(players))
        (facts(results))
        (untrained_banner(results))
        (figures(results))
        @for table in tables.iter().filter(|table| !is_folded(table)) { (to_html(table)) }
        (failures(&results.clips))
        @for (index, clip) in results.clips.iter().enumerate() {
            (clip::section(clip, index == 0, index < picture_clips))
        }
        @if tables.iter().any(is_folded) {
            details {
                summary { "Provenance and timings" }
                @for table in tables.iter().filter(|table| is_folded(table)) { (to_html(table)) }
            }
        }
    };
    players::page(&format!("rogs: {}", results.plan.name), STYLE, &body, players, false)
}

/// A page that has these players and nothing else, for a server that answers their addresses.
#[must_use]
pub fn viewer_page(title: &str, players: &[Player]) -> Markup {
    players::page(title, STYLE, &players::section(players), players, true)
}

/// Whether a table is for those who ask how the numbers came about.
fn is_folded(table: &Table) -> bool {
    matches!(table.id, TableId::Inputs | TableId::Timing)
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
