//! How near procedural cameras come to where they stand, from starts 3 cm and 3 degrees off:
//! `cargo run --release -p rogs-calibration --example cameras -- COUNT [FIRST] [clip]`;
//! of whole episodes, or with `clip` of their frames 7 to 23.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::too_many_lines)]

#[path = "../tests/clips/mod.rs"]
mod clips;
#[path = "../../agreement/tests/common/mod.rs"]
mod common;
#[path = "../tests/starts/mod.rs"]
mod starts;

fn main() {
    let mut numbers = std::env::args().skip(1).filter_map(|text| text.parse().ok());
    let count = numbers.next().unwrap_or(20);
    let first = numbers.next().unwrap_or(0);
    let frames = match std::env::args().any(|word| word == "clip") {
        true => starts::Frames::Clip,
        false => starts::Frames::Whole,
    };
    let ends = starts::three_off(&common::Machine::new(), first..first + count, frames);
    println!("{}", starts::summary(&ends));
}
