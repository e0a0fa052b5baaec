//! Six-camera frames per second at 154 x 280: `cargo bench -p rogs-synth`.

use std::time::Instant;

use rogs_synth::{SynthConfig, generate_episode};

fn main() -> rogs_synth::Result<()> {
    let config = SynthConfig::default();
    let start = Instant::now();
    let episodes = (1..=4)
        .map(|seed| generate_episode(&config, seed))
        .collect::<rogs_synth::Result<Vec<_>>>()?;
    println!(
        "episode without pictures: {:.1} ms",
        start.elapsed().as_secs_f64() * 1000.0 / 4.0
    );
    let threads = rayon::current_num_threads();
    for round in 0..3 {
        let start = Instant::now();
        let mut frames = 0;
        let mut bytes = 0;
        for frame in episodes.iter().flat_map(|episode| episode.frames()) {
            frames += 1;
            bytes += frame.views.iter().map(|view| view.rgb.len()).sum::<usize>();
        }
        let seconds = start.elapsed().as_secs_f64();
        println!(
            "round {round}: {:.1} six-camera frames/s on {threads} threads ({bytes} bytes of RGB)",
            frames as f64 / seconds
        );
    }
    Ok(())
}
