//! Seconds of the parts of an update: `cargo run -p rogs-train --example speed HEIGHT WIDTH IMAGES TIMES QUERIES`.
use burn::tensor::Device;
use rogs_train::stream::batches;
use rogs_train::{Course, Stage1Trainer, Stage1Training};
use std::time::Instant;
fn main() {
    let mut settings = Stage1Training::default();
    let arguments: Vec<u32> = std::env::args().skip(1).map(|a| a.parse().unwrap()).collect();
    settings.data.size = [arguments[0], arguments[1]];
    settings.data.images_per_step = arguments[2];
    settings.data.source_times = [arguments[3]; 2];
    settings.data.queries = arguments[4];
    settings.optimiser.rate = 4e-4;
    let mut stream = batches(&settings, 0);
    let mut trainer = Stage1Trainer::new(settings, &Device::flex()).unwrap();
    for _ in 0..6 {
        let start = Instant::now();
        let batch = stream.next_item().unwrap().unwrap();
        let waited = start.elapsed();
        let start = Instant::now();
        let report = trainer.update(&batch).unwrap();
        println!("data {waited:?} update {:?} {report:?}", start.elapsed());
    }
}
