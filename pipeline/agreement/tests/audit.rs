//! Planted mistakes on procedural clips: what the audit says of them.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;
mod planted;

use common::Machine;
use planted::{KINDS, Outcome, counts, outcomes, table};

#[test]
fn planted_mistakes_are_found_and_named() {
    let machine = Machine::new();
    let asked = std::env::var("ROGS_AUDIT_EPISODES").map_or(1, |count| count.parse().unwrap());
    let all: Vec<Outcome> = (0..asked).flat_map(|seed| outcomes(&machine, &KINDS, seed)).collect();
    println!("{}", table(&all));
    for kind in KINDS {
        let [clips, flagged, named] = counts(&all, kind);
        let share = |count: usize| count as f64 / clips as f64;
        match kind {
            "right" => assert!(share(flagged) <= 0.02, "{flagged} false alarms"),
            _ => assert!(
                share(flagged) >= 0.95 && share(named) >= 0.9,
                "{kind}: {flagged}, {named} of {clips}"
            ),
        }
    }
}
