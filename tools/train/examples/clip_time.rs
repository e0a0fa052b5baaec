//! Temporary: time and hash of clips.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
use rogs_train::Stage1Training;
use rogs_train::stream::batches;
use std::path::Path;
use std::time::Instant;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let settings = Stage1Training::read(Path::new(&arguments.next().unwrap())).unwrap();
    let updates: usize = arguments.next().and_then(|count| count.parse().ok()).unwrap_or(10);
    let start = Instant::now();
    let mut stream = batches(&settings, 0);
    let mut hash = 0xcbf2_9ce4_8422_2325u64;
    let mut add = |bits: u32| hash = (hash ^ u64::from(bits)).wrapping_mul(0x100_0000_01b3);
    let (mut clips, mut views) = (0, 0);
    for _ in 0..updates {
        for clip in stream.next_item().unwrap().unwrap().clips {
            clips += 1;
            views += clip.views.len() + clip.queries.iter().map(|q| q.targets.len()).sum::<usize>();
            for v in clip
                .images
                .iter()
                .chain(&clip.depth_iu)
                .chain(&clip.mesh_depth_iu)
                .chain(&clip.support)
            {
                add(v.to_bits());
            }
            for q in &clip.queries {
                for v in q.kappa.iter().chain(&q.displacement_iu).chain(&q.fk_slope) {
                    add(v.to_bits());
                }
                for t in &q.targets {
                    for v in t.rgb.iter().chain(&t.depth_iu).chain(&t.support) {
                        add(v.to_bits());
                    }
                }
            }
        }
    }
    let took = start.elapsed().as_secs_f64();
    println!(
        "{clips} clips, {views} views, {:.1} ms a clip, {:.2} ms a view, hash {hash:016x}",
        1000.0 * took / f64::from(clips),
        1000.0 * took / views as f64
    );
}
