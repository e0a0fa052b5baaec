//! Are the matcher's settings good for more than the pairs they were chosen with? A grid of settings is searched on some
//! procedural episodes; the best of it and the defaults are judged on episodes of other seeds and on recorded pairs, beside
//! OpenCV's SGBM where `ROGS_PEER_PYTHON` names a Python that has it. Then AbsRel against coverage on the recorded pairs, by
//! the evidence that is asked for.
//!
//! `ROGS_PEER_PYTHON=PYTHON cargo run --release -p rogs-stereo --example held_out`
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of benchmarks may be left half-written")]

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../tests/common/pairs.rs"]
mod pairs;

use common::Agreement;
use pairs::{CAMERAS, HELD_OUT, Pair, TUNED, mean, procedural, recorded};
use rayon::prelude::*;
use rogs_stereo::MatcherParams;

/// Most that a wrong pixel costs, and what an unknown one costs.
const WRONG: f64 = 0.1;
const UNKNOWN: f64 = 0.05;

/// The mean cost of a pixel with truth in 0.1 to 5 m: its relative error up to [`WRONG`], or [`UNKNOWN`].
fn cost(pair: &Pair, found: &[f64]) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for (&found, &truth) in found.iter().zip(&pair.truth_m) {
        if truth.is_finite() && truth > 0.1 && truth < 5.0 {
            let error = (found - truth).abs() / truth;
            sum += if found.is_finite() { error.min(WRONG) } else { UNKNOWN };
            count += 1;
        }
    }
    sum / count.max(1) as f64
}

/// Settings for a pair: those of the grid, with the nearest depth of the pair.
fn on(pair: &Pair, settings: MatcherParams) -> MatcherParams {
    MatcherParams {
        near_m: pair.params.near_m,
        ..settings
    }
}

fn costs(pairs: &[Pair], settings: MatcherParams) -> f64 {
    let all = pairs.iter().map(|pair| cost(pair, &pair.matched(&on(pair, settings))));
    all.sum::<f64>() / pairs.len() as f64
}

fn agreement(pairs: &[Pair], settings: MatcherParams) -> Agreement {
    let all: Vec<Agreement> = pairs
        .iter()
        .map(|pair| pair.agreement(&pair.matched(&on(pair, settings))))
        .collect();
    mean(&all)
}

fn told(settings: MatcherParams) -> String {
    format!(
        "steps {} and {}, uniqueness {} %, evidence {}",
        settings.small_step, settings.large_step, settings.uniqueness_percent, settings.evidence_bits
    )
}

fn line(what: &str, cost: f64, own: Agreement) {
    let Agreement {
        absrel,
        median,
        coverage,
        ..
    } = own;
    println!("{what}: cost {cost:.4}, AbsRel {absrel:.4}, median {median:.4}, coverage {coverage:.3}");
}

fn main() {
    let all = |seeds: &[u64]| -> Vec<Pair> { CAMERAS.iter().flat_map(|camera| procedural(camera, seeds)).collect() };
    let (tuned, held_out) = (all(&TUNED), all(&HELD_OUT));
    let defaults = MatcherParams::default();
    let mut grid = Vec::new();
    for small_step in [15, 30, 60] {
        for large_step in [100, 200, 400] {
            for uniqueness_percent in [4, 8, 12] {
                for evidence_bits in [1.0, 2.0, 3.0] {
                    grid.push(MatcherParams {
                        small_step,
                        large_step,
                        uniqueness_percent,
                        evidence_bits,
                        ..defaults
                    });
                }
            }
        }
    }
    let mut found: Vec<(f64, MatcherParams)> = grid
        .into_par_iter()
        .map(|settings| (costs(&tuned, settings), settings))
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let rank = found.iter().position(|(_, settings)| *settings == defaults).unwrap() + 1;
    println!(
        "{} settings on seeds {TUNED:?}; the defaults are number {rank}",
        found.len()
    );
    for (cost, settings) in &found[..5] {
        println!("  cost {cost:.4}: {}", told(*settings));
    }

    let best = found[0].1;
    let groups = [
        (format!("procedural, seeds {TUNED:?} (chosen with)"), tuned),
        (format!("procedural, seeds {HELD_OUT:?} (held out)"), held_out),
        ("recorded, LBR (held out by the grid)".to_owned(), recorded()),
    ];
    let peers = std::env::var_os("ROGS_PEER_PYTHON").is_some();
    for (name, pairs) in &groups {
        println!("{name}, {} pairs", pairs.len());
        for (what, settings) in [("defaults", defaults), ("best of the grid", best)] {
            line(&format!("  {what}"), costs(pairs, settings), agreement(pairs, settings));
        }
        if peers {
            let found = Pair::peers(pairs);
            let all: Vec<Agreement> = pairs
                .iter()
                .zip(&found)
                .map(|(pair, own)| pair.agreement(own))
                .collect();
            let costs = pairs.iter().zip(&found).map(|(pair, own)| cost(pair, own)).sum::<f64>();
            line("  SGBM", costs / pairs.len() as f64, mean(&all));
        }
    }
    println!("recorded, AbsRel against coverage");
    for evidence_bits in [0.0, 0.5, 1.0, 1.5, 2.0, 3.0] {
        for uniqueness_percent in [0, 4, 8] {
            let settings = MatcherParams {
                evidence_bits,
                uniqueness_percent,
                ..defaults
            };
            let own = agreement(&groups[2].1, settings);
            println!(
                "  evidence {evidence_bits}, uniqueness {uniqueness_percent} %: coverage {:.3}, AbsRel {:.4}, median {:.4}",
                own.coverage, own.absrel, own.median
            );
        }
    }
}
