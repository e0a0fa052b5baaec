//! All link transforms of the Panda with its gripper, random configurations: the batched kernel beside the `k` crate in
//! the same run (goal G-FK: at least 3 times the `k` crate at 2 threads, 5 times is the target).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::{panda, peak_memory_mib, seconds};
use rayon::ThreadPoolBuilder;
use rogs_robot::RobotModel;
use rogs_robot::batch::{BatchFk, BatchTransforms};

const STATES: usize = 100_000;
const STATES_OF_K: usize = 20_000;

fn main() {
    let Some(urdf) = panda() else { return };
    let model = RobotModel::load(&urdf).expect("the reference robot loads");
    let text = std::fs::read_to_string(&urdf).expect("the URDF can be read");
    let robot = urdf_rs::read_from_string(&text).expect("the URDF parses");
    let chains: Vec<k::Chain<f32>> = (0..2).map(|_| k::Chain::from(&robot)).collect();
    let degrees = chains[0].dof();
    let mut state = 1u64;
    let mut next = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32 * 1.2 - 0.6
    };
    let for_k: Vec<f32> = (0..STATES_OF_K * degrees).map(|_| next()).collect();
    let run_k = |chain: &k::Chain<f32>, range: std::ops::Range<usize>| {
        let mut sum = 0.0f32;
        for index in range {
            chain.set_joint_positions_unchecked(&for_k[index * degrees..(index + 1) * degrees]);
            sum += chain
                .update_transforms()
                .iter()
                .map(|pose| pose.translation.x)
                .sum::<f32>();
        }
        std::hint::black_box(sum);
    };
    let fk = BatchFk::new(&model);
    let positions: Vec<f32> = (0..STATES * fk.driven_joints().len()).map(|_| next()).collect();
    let mut transforms = BatchTransforms::default();
    println!(
        "{} links, {} joints of `k`, {} driven joints of ours (5 mimic joints follow)",
        model.links.len(),
        degrees,
        fk.driven_joints().len()
    );
    for threads in [1usize, 2] {
        let pool = ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("a thread pool");
        let share = STATES_OF_K / threads;
        let k_seconds = seconds(7, || {
            std::thread::scope(|scope| {
                for (index, chain) in chains[..threads].iter().enumerate() {
                    let run_k = &run_k;
                    scope.spawn(move || run_k(chain, index * share..(index + 1) * share));
                }
            });
        });
        let ours = seconds(15, || pool.install(|| fk.run_into(&positions, STATES, &mut transforms)));
        let rate =
            |(median, least): (f64, f64), count: usize| (count as f64 / median / 1e6, count as f64 / least / 1e6);
        let (k_rate, our_rate) = (rate(k_seconds, STATES_OF_K), rate(ours, STATES));
        println!(
            "{threads} thread(s): `k` {:.2} M/s (best {:.2}), ours {:.2} M/s (best {:.2}): {:.1} times (best against best {:.1})",
            k_rate.0,
            k_rate.1,
            our_rate.0,
            our_rate.1,
            our_rate.0 / k_rate.0,
            our_rate.1 / k_rate.1
        );
    }
    println!(
        "largest difference to the f64 kinematics over 200 states: {:.1e} m",
        worst_difference(&model, &fk, &positions, &transforms)
    );
    println!(
        "peak memory {:.0} MiB, of which the transforms {:.0} MiB",
        peak_memory_mib(),
        transforms.data.len() as f64 * 4.0 / 1048576.0
    );
}

fn worst_difference(model: &RobotModel, fk: &BatchFk, positions: &[f32], transforms: &BatchTransforms) -> f64 {
    let mut worst = 0.0f64;
    for index in 0..200 {
        let value = |column: usize| f64::from(positions[column * STATES + index]);
        let named = fk
            .driven_joints()
            .iter()
            .enumerate()
            .map(|(column, &joint)| (model.joints[joint].name.as_str(), value(column)));
        let state = model.joint_state(named).expect("the names are the model's own");
        for (link, pose) in model.fk(&state).iter().enumerate() {
            let ours = transforms.get(index, link);
            for axis in 0..3 {
                worst = worst.max((f64::from(ours[axis * 4 + 3]) - pose.translation[axis]).abs());
            }
        }
    }
    worst
}
