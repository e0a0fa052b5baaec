//! What lies in the data of people: every row of the table of bad inputs in `docs/faults.md`, through the program, with the
//! message that a person sees. One bad episode or file never stops, changes or hides another.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "../support/mod.rs"]
mod support;

mod bounds;
mod cameras;
mod cases;
mod environments;
mod files;
mod images;
mod kinds;
mod manifests;
mod names;
mod places;
mod reports;
mod robots;
mod states;
mod streams;
mod videos;
