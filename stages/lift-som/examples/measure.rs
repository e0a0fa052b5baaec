//! What a clip costs: processor seconds and Gaussians as the optimisation goes on.
//!
//! `cargo run --release -p rogs-lift-som --example measure -- CLIP_FOLDER SIDECARS ['{"epochs": 20, ...}'] [CAMERA]`
//! The clip's folder is one in a run, with `clip.r4c` and `robot.r4c`; with a camera's id it alone is measured.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr)]

#[path = "../../../tests/support/bench.rs"]
mod bench;

use std::path::Path;

use bench::{peak_memory_mib, processor_seconds};
use rogs_lift_som::{ClipInputs, LiftSomParams, reconstruct};
use rogs_r4c::read_record;
use rogs_schemas::records::clip::{CameraRole, Clip};
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::Observer;

/// Prints what it is told, with the processor's clock.
struct Clock;

impl Observer for Clock {
    fn progress(&mut self, _: f64, what: &str) {
        println!("{:8.1} s  {what}", processor_seconds());
    }
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = Path::new(&arguments[0]);
    let mut clip: Clip = read_record(&folder.join("clip.r4c")).unwrap().0;
    let robot: RobotMaps = read_record(&folder.join("robot.r4c")).unwrap().0;
    let params: LiftSomParams = serde_json::from_str(arguments.get(2).map_or("{}", String::as_str)).unwrap();
    if let Some(only) = arguments.get(3) {
        let others = clip.cameras.iter_mut().filter(|camera| camera.id != *only);
        others.for_each(|camera| camera.role = CameraRole::Evaluation);
    }
    let inputs = ClipInputs {
        clip: &clip,
        robot: &robot,
        sidecars: Path::new(&arguments[1]),
    };
    let field = reconstruct(inputs, &params, None, &mut Clock).unwrap();
    for (camera, own) in &field.cameras {
        println!(
            "camera {camera}: {} Gaussians, {} of them move",
            own.len(),
            own.foreground()
        );
    }
    println!(
        "{:.1} processor seconds, {:.0} MiB",
        processor_seconds(),
        peak_memory_mib()
    );
}
