//! Time and memory of a refinement at the size of a full clip: 15 source views of 154 x 280 pixels, 646,800 Gaussians.
//!
//! `cargo run --release -p rogs-refine --example cost -- PRESET [UPDATES] [HEIGHT WIDTH]`
//! The clip is made from formulas and the network has a random head; neither changes the amount of work.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "../tests/support/mod.rs"]
mod support;

use std::collections::BTreeMap;
use std::time::Instant;

use rogs_refine::{RefineParams, refine};
use rogs_worker::Observer;
use support::{Sizes, example_of, random_network};

/// Seconds by what was said to come next.
struct Clock {
    seconds: BTreeMap<String, f64>,
    phase: String,
    since: Instant,
}

impl Observer for Clock {
    fn progress(&mut self, _fraction: f64, what: &str) {
        let phase = what.rsplit(": ").next().unwrap_or(what).to_owned();
        let ended = std::mem::replace(&mut self.phase, phase);
        *self.seconds.entry(ended).or_default() += self.since.elapsed().as_secs_f64();
        self.since = Instant::now();
    }
}

fn main() -> Result<(), String> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let number = |index: usize| {
        arguments
            .get(index)
            .map(|text| text.parse::<u32>().map_err(|error| format!("`{text}`: {error}")))
            .transpose()
    };
    let preset = arguments.first().cloned().unwrap_or_else(|| "ci".into());
    let (height, width) = (number(2)?.unwrap_or(154), number(3)?.unwrap_or(280));
    let example = example_of(
        Sizes {
            height,
            width,
            frames: 17,
            step: 4,
        },
        1,
    );
    let network = random_network(&preset, 1);
    let params = RefineParams {
        preset: preset.clone(),
        updates: number(1)?,
        ..RefineParams::default()
    };
    let start = Instant::now();
    let mut clock = Clock {
        seconds: BTreeMap::new(),
        phase: String::new(),
        since: start,
    };
    let refinement = refine(example.inputs(), &network, &params, &mut clock).map_err(|error| error.to_string())?;
    clock.progress(1.0, "");
    let Clock { seconds, .. } = clock;
    let touched = refinement
        .steps
        .last()
        .map_or(0, |step| step.touched.iter().filter(|&&flag| flag != 0).count());
    println!(
        "preset {preset}, {} updates, {} Gaussians, {touched} corrected",
        refinement.updates,
        example.field.len()
    );
    for (phase, seconds) in seconds.iter().filter(|(phase, _)| !phase.is_empty()) {
        println!("{seconds:8.2} s  {phase}");
    }
    println!(
        "{:8.2} s  in all, {} threads",
        start.elapsed().as_secs_f64(),
        rayon::current_num_threads()
    );
    println!(
        "{:8.2} GiB peak resident, the clip included",
        rogs_worker::peak_rss_bytes() as f64 / f64::from(1u32 << 30)
    );
    Ok(())
}
