//! The clip workload on a GPU, beside the CPU in the same run:
//! `cargo bench -p rogs-splat --features gpu --bench gpu`. Prints the device, the times and their ratios.
//!
//! `ROGS_BENCH_PARTS` (single, clip, contributions), `ROGS_BENCH_ROUNDS` and `ROGS_BENCH_SIZE` (Gaussians a source image,
//! as WIDTHxHEIGHT) choose what runs. The clip is 8 query times x 6 cameras of 154 x 280 (rows x columns): per time the
//! centres are replaced, all else stays on the device; images are read back.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "../tests/common/room.rs"]
mod room;

use std::time::Instant;

use rogs_splat::{
    Eligible, Gaussians, GpuDevice, GpuScene, RasterCamera, RasterConfig, RenderGradient, backward_views, gpu,
    render_views, render_views_with_contributions, render_views_with_tape,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let device = match GpuDevice::open() {
        Ok(device) => device,
        Err(error) => {
            println!("skipped: {error}");
            return Ok(());
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    println!("device: {}; processor: {threads} threads", device.name());
    let rounds = std::env::var("ROGS_BENCH_ROUNDS")
        .ok()
        .and_then(|v| v.parse().ok())
        .unwrap_or(5);
    let size = std::env::var("ROGS_BENCH_SIZE").unwrap_or_else(|_| "280x154".into());
    let (width, height) = size.split_once('x').ok_or("ROGS_BENCH_SIZE is WIDTHxHEIGHT")?;
    let scene = room::scene(3, 5, width.parse()?, height.parse()?);
    println!("{} Gaussians, best of {rounds} rounds, milliseconds", scene.len());
    let bench = Bench {
        scene: &scene,
        config: RasterConfig {
            near: 0.01,
            far: 1e10,
            ..RasterConfig::default()
        },
        rounds,
        device,
    };
    if part("single") {
        bench.single(280, 154)?;
        bench.single(640, 352)?;
    }
    if part("clip") {
        bench.clip()?;
    }
    if part("contributions") {
        bench.contributions()?;
    }
    Ok(())
}

fn part(name: &str) -> bool {
    std::env::var("ROGS_BENCH_PARTS").map_or(true, |parts| parts.split(',').any(|p| p == name))
}

type Outcome = Result<(), Box<dyn std::error::Error>>;

struct Bench<'a> {
    scene: &'a Gaussians,
    config: RasterConfig,
    rounds: usize,
    device: GpuDevice,
}

impl Bench<'_> {
    /// Best time after one warming round, in which kernels are compiled.
    fn best(&self, mut f: impl FnMut() -> rogs_splat::Result<()>) -> rogs_splat::Result<f64> {
        f()?;
        let mut best = f64::INFINITY;
        for _ in 0..self.rounds {
            let start = Instant::now();
            f()?;
            best = best.min(start.elapsed().as_secs_f64() * 1e3);
        }
        Ok(best)
    }

    fn report(&self, what: &str, gpu: f64, cpu: f64) {
        println!("{what:44} device {gpu:9.2}   processor {cpu:9.2}   {:.2}x", cpu / gpu);
    }

    fn single(&self, width: u32, height: u32) -> Outcome {
        let Self { scene, config, .. } = self;
        let cameras = [room::camera(width, height)];
        let rgb = room::normals(3 * cameras[0].pixels(), 1);
        let gradient = [RenderGradient {
            rgb: &rgb,
            ..RenderGradient::default()
        }];
        let on_device = GpuScene::upload(&self.device, scene)?;
        let upload = self.best(|| GpuScene::upload(&self.device, scene).map(drop))?;
        println!("upload of the scene {upload:.2}");
        let forward = self.best(|| gpu::render_views(&on_device, &cameras, config).map(drop))?;
        let both = self.best(|| {
            let (_, tape) = gpu::render_views_with_tape(&on_device, &cameras, config)?;
            gpu::backward_views(&tape, &gradient).map(drop)
        })?;
        let cpu_forward = self.best(|| render_views(scene, &cameras, config).map(drop))?;
        let cpu_both = self.best(|| {
            let (_, tapes) = render_views_with_tape(scene, &cameras, config)?;
            backward_views(scene, config, &tapes, &gradient).map(drop)
        })?;
        self.report(&format!("{height}x{width} forward"), forward, cpu_forward);
        self.report(&format!("{height}x{width} forward + backward"), both, cpu_both);
        let ours = gpu::render_views(&on_device, &cameras, config)?;
        let reference = render_views(scene, &cameras, config)?;
        println!("images agree to {:.1} dB", room::psnr(&ours[0].rgb, &reference[0].rgb));
        Ok(())
    }

    /// 8 query times x 6 cameras.
    fn clip(&self) -> Outcome {
        let Self { scene, config, .. } = self;
        let cameras: Vec<RasterCamera> = (0..6)
            .map(|k| room::camera_from([0.84 - 0.02 * f64::from(k), 0.96 - 0.05 * f64::from(k), 0.8], 280, 154))
            .collect();
        let times: Vec<Gaussians> = (0..8)
            .map(|time| {
                let mut moved = (*scene).clone();
                moved.means.iter_mut().for_each(|v| *v += 1e-3 * time as f32);
                moved
            })
            .collect();
        let mut on_device = GpuScene::upload(&self.device, scene)?;
        let gpu = self.best(|| {
            for time in &times {
                on_device.set_means(&time.means)?;
                gpu::render_views(&on_device, &cameras, config)?;
            }
            Ok(())
        })?;
        let cpu = self.best(|| {
            times
                .iter()
                .try_for_each(|time| render_views(time, &cameras, config).map(drop))
        })?;
        self.report("clip of 8 times x 6 cameras, 154x280", gpu, cpu);
        println!("goal on an H100: 150");
        Ok(())
    }

    fn contributions(&self) -> Outcome {
        let Self { scene, config, .. } = self;
        let cameras = [room::camera(280, 154)];
        let per = scene.len() / 15;
        let eligible = Eligible::Ranges([0, 5, 10].map(|view| view * per..(view + 1) * per).to_vec());
        let features = room::normals(cameras[0].pixels() * 256, 3);
        let on_device = GpuScene::upload(&self.device, scene)?;
        let record = |pool: bool| {
            let (_, sums) = gpu::render_views_with_contributions(&on_device, &cameras, config, &eligible)?;
            if pool {
                sums.pool(&features, 256).map(drop)
            } else {
                Ok(())
            }
        };
        let cpu_record = |pool: bool| {
            let (_, sums) = render_views_with_contributions(scene, &cameras, config, &eligible)?;
            if pool {
                sums.pool(&features, 256).map(drop)
            } else {
                Ok(())
            }
        };
        self.report(
            "render + contributions",
            self.best(|| record(false))?,
            self.best(|| cpu_record(false))?,
        );
        self.report(
            "the same + pooling 256 channels",
            self.best(|| record(true))?,
            self.best(|| cpu_record(true))?,
        );
        Ok(())
    }
}
