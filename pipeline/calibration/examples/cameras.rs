//! How near procedural cameras come to where they stand, from starts 3 cm and 3 degrees off:
//! `cargo run --release -p rogs-calibration --example cameras -- COUNT [FIRST]`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::too_many_lines)]

#[path = "../tests/clips/mod.rs"]
mod clips;
#[path = "../../agreement/tests/common/mod.rs"]
mod common;
#[path = "../tests/starts/mod.rs"]
mod starts;

fn main() {
    let mut numbers = std::env::args().skip(1).map(|text| text.parse().unwrap());
    let count = numbers.next().unwrap_or(20);
    let first = numbers.next().unwrap_or(0);
    let ends = starts::three_off(&common::Machine::new(), first..first + count);
    println!("{}", starts::summary(&ends));
}
