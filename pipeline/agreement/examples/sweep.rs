//! What the audit says of mistakes planted in procedural episodes, as a table:
//! `cargo run --release -p rogs-agreement --example sweep -- EPISODES [FIRST [KIND...]]`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::too_many_lines)]

#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../tests/planted/mod.rs"]
mod planted;

use planted::{KINDS, Outcome, outcomes, table};

fn main() {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let number = |at: usize, or: u64| words.get(at).map_or(or, |word| word.parse().unwrap());
    let (count, first) = (number(0, 5), number(1, 0));
    let asked = words.get(2..).unwrap_or_default();
    let kinds: Vec<&'static str> = KINDS
        .into_iter()
        .filter(|kind| asked.is_empty() || asked.iter().any(|word| word == kind))
        .collect();
    let machine = common::Machine::new();
    let all: Vec<Outcome> = (first..first + count)
        .flat_map(|seed| outcomes(&machine, &kinds, seed))
        .collect();
    println!("{}", table(&all));
}
