//! The clip workload of the rasteriser: one Gaussian per pixel of 15 source images of a synthetic room, 646,800 in all,
//! seen from beside a source camera at 154x280 and 352x640 (rows x columns).
//!
//! `cargo bench -p rogs-splat` prints times of forward, forward + backward and pooled contributions for 1 and 2 threads.
//! With `ROGS_GSREF` set to the shared library of an AVX-512 sketch with the same rules (C function `gsref`), the sketch
//! is timed in turns with ours and ratios are printed. `ROGS_BENCH_ROUNDS` sets the number of rounds (default 7).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(missing_docs)]

use std::time::Instant;

use rogs_splat::{
    Colour, Eligible, Gaussians, Gradients, RasterCamera, RasterConfig, RenderGradient, SimdLevel, Tape, backward,
    backward_into, backward_views, render, render_views, render_views_with_tape, render_with_contributions,
    render_with_tape,
};

#[path = "../tests/common/room.rs"]
mod room;

fn main() {
    // `cargo test --benches` passes --test; there is nothing to test here.
    if std::env::args().any(|a| a == "--test") {
        return;
    }
    let rounds: usize = std::env::var("ROGS_BENCH_ROUNDS")
        .ok()
        .and_then(|v| v.parse().ok())
        .unwrap_or(7);
    let scene = room::scene(3, 5, 280, 154);
    println!(
        "{} Gaussians, levels {:?}, best of {rounds} rounds",
        scene.len(),
        SimdLevel::available()
    );
    let sketch = sketch::Sketch::load();
    for (width, height) in [(280, 154), (640, 352)] {
        if !part("forward") && !part("backward") {
            break;
        }
        let camera = room::camera(width, height);
        bench_forward(&scene, &camera, rounds, sketch.as_ref());
    }
    if part("views") {
        bench_views(&scene, rounds);
    }
    if part("contributions") {
        bench_contributions(&scene, rounds);
    }
    if part("levels") {
        bench_levels(&scene, rounds);
    }
}

/// Whether a part is asked for: `ROGS_BENCH_PARTS`, a list of forward, backward, views, contributions, levels; all by default.
fn part(name: &str) -> bool {
    std::env::var("ROGS_BENCH_PARTS").map_or(true, |parts| parts.split(',').any(|p| p == name))
}

/// Wall and CPU times of one contender, milliseconds. CPU times say more on a machine that others use too.
#[derive(Default)]
struct Times {
    wall: Vec<f64>,
    cpu: Vec<f64>,
}

impl Times {
    fn run<T>(&mut self, f: impl FnOnce() -> T) -> T {
        let (start, cpu) = (Instant::now(), cpu_ms());
        let result = f();
        self.wall.push(start.elapsed().as_secs_f64() * 1e3);
        self.cpu.push(cpu_ms() - cpu);
        result
    }

    fn best(&self) -> f64 {
        self.wall.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn best_cpu(&self) -> f64 {
        self.cpu.iter().copied().fold(f64::INFINITY, f64::min)
    }

    fn median(&self) -> f64 {
        let mut sorted = self.wall.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[sorted.len() / 2]
    }
}

/// Processor time of this process so far.
#[allow(unsafe_code)] // a clock that std does not offer
fn cpu_ms() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: `time` is a valid place for the answer.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &raw mut time) };
    time.tv_sec as f64 * 1e3 + time.tv_nsec as f64 / 1e6
}

fn threads() -> Vec<usize> {
    let listed = std::env::var("ROGS_BENCH_THREADS").unwrap_or_else(|_| "1,2".into());
    listed.split(',').filter_map(|t| t.parse().ok()).collect()
}

fn pool(threads: usize) -> rayon::ThreadPool {
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("a thread pool")
}

fn bench_forward(scene: &Gaussians, camera: &RasterCamera, rounds: usize, sketch: Option<&sketch::Sketch>) {
    let config = RasterConfig {
        near: 0.01,
        far: 1e10,
        ..RasterConfig::default()
    };
    let pixels = camera.pixels();
    let gradient_rgb: Vec<f32> = room::normals(3 * pixels, 1);
    let gradient = RenderGradient {
        rgb: &gradient_rgb,
        ..RenderGradient::default()
    };
    for threads in threads() {
        let pool = pool(threads);
        let (mut forward, mut both, mut with_tape) = (Times::default(), Times::default(), Times::default());
        let (mut theirs, mut theirs_both) = (Times::default(), Times::default());
        let mut psnr = f64::NAN;
        for _ in 0..rounds {
            let image = forward
                .run(|| pool.install(|| render(scene, camera, &config)))
                .expect("a render");
            if let Some(sketch) = sketch {
                let reference = theirs.run(|| sketch.run(scene, camera, threads, None));
                psnr = room::psnr(&image.rgb, &reference);
            }
            if !part("backward") {
                continue;
            }
            let (_, tape) = with_tape
                .run(|| pool.install(|| render_with_tape(scene, camera, &config)))
                .expect("a tape");
            drop(tape);
            both.run(|| {
                pool.install(|| {
                    let (_, tape) = render_with_tape(scene, camera, &config)?;
                    backward(scene, &config, &tape, &gradient)
                })
            })
            .expect("gradients");
            if let Some(sketch) = sketch {
                theirs_both.run(|| sketch.run(scene, camera, threads, Some(&gradient_rgb)));
            }
        }
        let name = format!("{}x{} {threads} thread(s)", camera.height, camera.width);
        let line = |what: &str, ours: &Times, theirs: &Times| {
            let cpu = ours.best_cpu();
            print!(
                "{name:24} {what:22} {:7.1} ms (median {:.1}, cpu {cpu:.1})",
                ours.best(),
                ours.median()
            );
            if sketch.is_some() && !theirs.wall.is_empty() {
                let (best, median) = (theirs.best() / ours.best(), theirs.median() / ours.median());
                let (wall, cpu, ratio) = (theirs.best(), theirs.best_cpu(), theirs.best_cpu() / cpu);
                print!("   sketch {wall:7.1} ms (cpu {cpu:.1})   {best:.2}x (median {median:.2}x, cpu {ratio:.2}x)");
            }
            println!();
        };
        line("forward", &forward, &theirs);
        if part("backward") {
            line("forward for backward", &with_tape, &Times::default());
            line("forward + backward", &both, &theirs_both);
        }
        if sketch.is_some() {
            println!("{name:24} image against the sketch: {psnr:.1} dB");
        }
    }
}

/// Six cameras at once against one after the other.
fn bench_views(scene: &Gaussians, rounds: usize) {
    let config = RasterConfig {
        near: 0.01,
        far: 1e10,
        ..RasterConfig::default()
    };
    let cameras: Vec<RasterCamera> = (0..6)
        .map(|k| room::camera_from([0.84 - 0.02 * f64::from(k), 0.96 - 0.05 * f64::from(k), 0.8], 280, 154))
        .collect();
    let gradient_rgb = room::normals(3 * cameras[0].pixels(), 1);
    let gradient = RenderGradient {
        rgb: &gradient_rgb,
        ..RenderGradient::default()
    };
    for threads in threads() {
        let pool = pool(threads);
        let mut times: [Times; 4] = Default::default();
        for _ in 0..rounds {
            let [single, together, single_both, both] = &mut times;
            single.run(|| pool.install(|| cameras.iter().for_each(|camera| drop(render(scene, camera, &config)))));
            together
                .run(|| pool.install(|| render_views(scene, &cameras, &config)))
                .expect("renders");
            single_both.run(|| {
                pool.install(|| {
                    // A loss needs all images, so all tapes are there when the backward pass begins.
                    let tape = |camera| render_with_tape(scene, camera, &config).expect("a tape").1;
                    let tapes: Vec<Tape> = cameras.iter().map(tape).collect();
                    let mut sum = Gradients::zeros(scene);
                    for tape in &tapes {
                        backward_into(scene, &config, tape, &gradient, &mut sum).expect("gradients");
                    }
                    sum
                })
            });
            both.run(|| {
                pool.install(|| {
                    let (_, tapes) = render_views_with_tape(scene, &cameras, &config).expect("tapes");
                    backward_views(scene, &config, &tapes, &[gradient; 6]).expect("gradients")
                })
            });
        }
        let names = [
            "forward, one by one",
            "forward, together",
            "both, one by one",
            "both, together",
        ];
        for (name, times) in names.iter().zip(&times) {
            let (wall, cpu) = (times.best() / 6.0, times.best_cpu() / 6.0);
            println!("6 views {threads} thread(s) {name:24} {wall:7.1} ms a view (cpu {cpu:.1})");
        }
    }
}

fn bench_contributions(scene: &Gaussians, rounds: usize) {
    let camera = room::camera(280, 154);
    let config = RasterConfig {
        near: 0.01,
        far: 1e10,
        ..RasterConfig::default()
    };
    // The Gaussians of one source time: one range per source view.
    let per = scene.len() / 15;
    let eligible = Eligible::Ranges([0, 5, 10].map(|view| view * per..(view + 1) * per).to_vec());
    let features = room::normals(camera.pixels() * 256, 3);
    let mut pooled: Vec<f32> = Vec::new();
    for threads in threads() {
        let pool = pool(threads);
        let (mut record, mut pooling) = (Times::default(), Times::default());
        let mut entries = 0;
        for _ in 0..rounds {
            let (_, contributions) = record
                .run(|| pool.install(|| render_with_contributions(scene, &camera, &config, &eligible)))
                .expect("contributions");
            entries = contributions.len();
            pooled.resize(contributions.rows.len() * 256, 0.0);
            pooling
                .run(|| pool.install(|| contributions.pool_into(&features, 256, &mut pooled)))
                .expect("pooled features");
        }
        let name = format!("154x280 {threads} thread(s)");
        println!(
            "{name:24} render + contributions {:8.1} ms ({:.1})",
            record.best(),
            record.median()
        );
        println!(
            "{name:24} pool 256 channels      {:8.1} ms ({:.1}), {entries} entries",
            pooling.best(),
            pooling.median()
        );
    }
}

fn bench_levels(scene: &Gaussians, rounds: usize) {
    let camera = room::camera(280, 154);
    let pool = pool(2);
    for simd in SimdLevel::available() {
        if simd == SimdLevel::Portable && std::env::var_os("ROGS_BENCH_PORTABLE").is_none() {
            continue;
        }
        let config = RasterConfig {
            near: 0.01,
            far: 1e10,
            simd,
            ..RasterConfig::default()
        };
        let mut times = Times::default();
        for _ in 0..rounds.min(5) {
            times
                .run(|| pool.install(|| render(scene, &camera, &config)))
                .expect("a render");
        }
        println!(
            "154x280 2 thread(s)      forward on {simd:?}: {:.1} ms ({:.1})",
            times.best(),
            times.median()
        );
    }
}

/// The sketch, loaded from a shared library at run time.
mod sketch {
    #![allow(unsafe_code)] // a C function in a library that only the person running the benchmark names

    use super::{Colour, Gaussians, RasterCamera};

    type Gsref = unsafe extern "C" fn(
        n: i32,
        mean: *const f32,
        scale: *const f32,
        quat: *const f32,
        opacity: *const f32,
        colour: *const f32,
        view: *const f32,
        fx: f32,
        fy: f32,
        cx: f32,
        cy: f32,
        width: i32,
        height: i32,
        out: *mut f32,
        threads: i32,
        backward: i32,
        gout: *const f32,
        ggrad: *mut f32,
        stats: *mut i64,
        times: *mut f64,
    ) -> i32;

    pub(super) struct Sketch(Gsref);

    impl Sketch {
        pub(super) fn load() -> Option<Self> {
            let path = std::env::var("ROGS_GSREF").ok()?;
            let path = std::ffi::CString::new(path).ok()?;
            // SAFETY: the library is named by the person running the benchmark and stays loaded.
            let symbol = unsafe {
                let library = libc::dlopen(path.as_ptr(), libc::RTLD_NOW);
                if library.is_null() {
                    println!("ROGS_GSREF cannot be loaded");
                    return None;
                }
                libc::dlsym(library, c"gsref".as_ptr())
            };
            // SAFETY: `gsref` has this signature.
            (!symbol.is_null()).then(|| Self(unsafe { std::mem::transmute::<*mut libc::c_void, Gsref>(symbol) }))
        }

        /// Returns the image as RGB.
        pub(super) fn run(
            &self,
            scene: &Gaussians,
            camera: &RasterCamera,
            threads: usize,
            gout: Option<&[f32]>,
        ) -> Vec<f32> {
            let Colour::Rgb(rgb) = &scene.colour else {
                return Vec::new();
            };
            let r = &camera.rotation;
            let t = &camera.translation;
            let view = [r[0], r[1], r[2], t[0], r[3], r[4], r[5], t[1], r[6], r[7], r[8], t[2]].map(|v| v as f32);
            let mut out = vec![0.0_f32; 4 * camera.pixels()];
            let mut gradient = if gout.is_some() {
                vec![0.0_f32; 9 * scene.len()]
            } else {
                Vec::new()
            };
            let (mut stats, mut times) = ([0_i64; 4], [0.0_f64; 4]);
            // SAFETY: all arrays have the lengths that the function reads and writes.
            unsafe {
                (self.0)(
                    scene.len() as i32,
                    scene.means.as_ptr(),
                    scene.scales.as_ptr(),
                    scene.quats.as_ptr(),
                    scene.opacities.as_ptr(),
                    rgb.as_ptr(),
                    view.as_ptr(),
                    camera.fx as f32,
                    camera.fy as f32,
                    camera.cx as f32,
                    camera.cy as f32,
                    camera.width as i32,
                    camera.height as i32,
                    out.as_mut_ptr(),
                    threads as i32,
                    i32::from(gout.is_some()),
                    gout.map_or(std::ptr::null(), <[f32]>::as_ptr),
                    if gradient.is_empty() {
                        std::ptr::null_mut()
                    } else {
                        gradient.as_mut_ptr()
                    },
                    stats.as_mut_ptr(),
                    times.as_mut_ptr(),
                );
            }
            if std::env::var_os("ROGS_BENCH_STATS").is_some() {
                println!("  sketch stats {stats:?} seconds {times:?}");
            }
            out.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect()
        }
    }
}
