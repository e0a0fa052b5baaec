//! Seconds and peak memory of the parts of an update:
//! `cargo run -p rogs-train --example speed SETTINGS.toml [UPDATES]`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use std::path::Path;
use std::time::Instant;

use burn::tensor::Device;
use rogs_train::stream::batches;
use rogs_train::{Stage1Trainer, Stage1Training, Trainer};

fn main() -> rogs_train::Result<()> {
    rogs_worker::keep_memory();
    let mut arguments = std::env::args().skip(1);
    let settings = match arguments.next() {
        Some(path) => Stage1Training::read(Path::new(&path))?,
        None => Stage1Training::default(),
    };
    let updates = arguments.next().and_then(|count| count.parse().ok()).unwrap_or(6);
    let mut stream = batches(&settings, 0);
    let mut trainer = Stage1Trainer::new(settings, &Device::flex())?;
    println!(
        "network {:.2} GiB",
        rogs_worker::peak_rss_bytes() as f64 / f64::from(1 << 30)
    );
    for _ in 0..updates {
        let start = Instant::now();
        let Some(batch) = stream.next_item() else { break };
        let (batch, waited, start) = (batch?, start.elapsed(), Instant::now());
        let report = trainer.update(&batch)?;
        let took = start.elapsed();
        println!(
            "clips {waited:.2?}  update {took:.2?}  peak {:.2} GiB  {report:?}",
            rogs_worker::peak_rss_bytes() as f64 / f64::from(1 << 30)
        );
    }
    Ok(())
}
