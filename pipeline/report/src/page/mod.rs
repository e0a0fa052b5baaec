//! The pages of a run. The first has players, facts, plots, tables, failures and warnings, then its clips, and what is
//! folded. A few clips are sections of it; of many, each has a page of its own, so that every page opens at once.

pub(crate) mod agreement;
mod clip;
mod failure;
mod index;

use std::collections::BTreeSet;

use maud::{Markup, html};
use rogs_schemas::records::clip::ROLLOUT;
use rogs_score::tables::{Table, TableId};

use crate::forms::to_html;
use crate::players::{self, Player};
use crate::plots::{bars, plots, rollout_plots};
use crate::results::{ClipResults, RunResults};
use crate::scenes::RobotMesh;

pub(crate) const STYLE: &str = include_str!("style.css");

/// Clips of a run that are on its page; of more, each has a page of its own.
const MOST_SECTIONS: usize = 6;

/// What the pages of a run are made of.
pub(crate) struct Pages<'a> {
    pub(crate) results: &'a RunResults,
    /// The first so many clips have pictures.
    pub(crate) picture_clips: usize,
    /// The robot, for pictures.
    pub(crate) mesh: Option<&'a RobotMesh>,
}

impl Pages<'_> {
    /// Where the page of a clip lies beside that of the run; none where the run's page has it.
    pub(crate) fn address(&self, index: usize) -> Option<String> {
        (self.results.clips.len() > MOST_SECTIONS).then(|| format!("clips/{:04}.html", index + 1))
    }

    /// The page of the run.
    pub(crate) fn index(&self, tables: &[Table], players: &[Player]) -> Markup {
        let clips = &self.results.clips;
        let apart = clips.len() > MOST_SECTIONS;
        let body = html! {
            (players::section(players))
            (facts(self.results))
            (untrained_banner(self.results))
            (figures(self.results))
            @for table in tables.iter().filter(|table| !is_folded(table)) { (to_html(table)) }
            (failures(clips))
            (index::warnings(clips))
            @if apart {
                (index::clips(self.results, &|index| self.address(index).unwrap_or_default()))
            } @else {
                @for index in 0..clips.len() { (self.section(index, index == 0)) }
            }
            @if tables.iter().any(is_folded) {
                details {
                    summary { "Provenance and timings" }
                    @for table in tables.iter().filter(|table| is_folded(table)) { (to_html(table)) }
                }
            }
        };
        players::page(&self.title(), STYLE, &body, players, false)
    }

    /// The page of one clip.
    pub(crate) fn clip(&self, index: usize) -> Markup {
        let clips = &self.results.clips;
        let name = |index: usize| clips.get(index).map(|clip| clip.id.as_str()).unwrap_or_default();
        let beside = |index: usize| format!("{:04}.html", index + 1);
        let body = html! {
            nav {
                a href="../index.html#clips" { (self.title()) }
                @if index > 0 { a href=(beside(index - 1)) { "← " (name(index - 1)) } }
                @if index + 1 < clips.len() { a href=(beside(index + 1)) { (name(index + 1)) " →" } }
            }
            (self.section(index, true))
        };
        players::page_of_pictures(name(index), STYLE, &body)
    }

    fn section(&self, index: usize, open: bool) -> Markup {
        let clip = &self.results.clips[index];
        clip::section(clip, open, index < self.picture_clips, self.mesh)
    }

    fn title(&self) -> String {
        format!("rogs: {}", self.results.plan.name)
    }
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
    let mut plots = plots(&results.sheets);
    if results.agreements.iter().any(|own| own.setting == ROLLOUT) {
        plots.extend(rollout_plots(&results.agreements, &results.sheets));
    }
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
