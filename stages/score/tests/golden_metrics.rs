//! The metric library against values of numpy, scikit-image and torchmetrics. Prints the worst error of each group
//! (`cargo test -p rogs-score --test golden_metrics -- --nocapture`).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use rogs_random::Pcg64;
use rogs_score::metrics::{
    DisplacementMap, Pixels, RgbView, SsimVariant, TrackSample, bootstrap_interval, bootstrap_means, depth_scores,
    depth_support, far_support, mean, median_scale, mse, psnr, robot_core, robot_depth_error, ssim, track_error_m,
};
use safetensors::SafeTensors;
use serde_json::Value;

static INPUTS: &[u8] = include_bytes!("golden/metrics_inputs.safetensors");

fn json(text: &str) -> Value {
    serde_json::from_str(text).expect("golden file is JSON")
}

fn bytes(name: &str) -> Vec<u8> {
    SafeTensors::deserialize(INPUTS)
        .unwrap()
        .tensor(name)
        .unwrap()
        .data()
        .to_vec()
}

fn f32s(name: &str) -> Vec<f32> {
    bytes(name)
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
        .collect()
}

fn i16s(name: &str) -> Vec<i16> {
    bytes(name)
        .chunks_exact(2)
        .map(|b| i16::from_le_bytes(b.try_into().unwrap()))
        .collect()
}

/// Collects absolute or relative errors and fails past the tolerance.
struct Worst {
    group: &'static str,
    tolerance: f64,
    worst: f64,
}

impl Worst {
    fn new(group: &'static str, tolerance: f64) -> Self {
        Self {
            group,
            tolerance,
            worst: 0.0,
        }
    }

    fn check(&mut self, what: &str, found: f64, expected: &Value) {
        let expected = expected.as_f64().expect("golden number");
        let error = (found - expected).abs();
        assert!(
            error <= self.tolerance,
            "{} {what}: found {found}, expected {expected}",
            self.group
        );
        self.worst = self.worst.max(error);
    }
}

impl Drop for Worst {
    fn drop(&mut self) {
        println!(
            "{}: worst absolute error {:.3e} (tolerance {:.0e})",
            self.group, self.worst, self.tolerance
        );
    }
}

#[test]
fn image_metrics() {
    let golden = json(include_str!("golden/metrics.json"));
    let mut psnr_error = Worst::new("PSNR [dB]", 1e-11);
    let mut mse_error = Worst::new("MSE", 1e-15);
    let mut ssim_error = Worst::new("SSIM, three variants", 1e-12);
    for (pair, expected) in golden["images"].as_array().unwrap().iter().enumerate() {
        let (a, b) = (bytes(&format!("pred{pair}_u8")), bytes(&format!("ref{pair}_u8")));
        let (exact_a, exact_b) = (view(Pixels::Bytes(&a)), view(Pixels::Bytes(&b)));
        mse_error.check("exact", mse(&exact_a, &exact_b).unwrap(), &expected["mse_u8_exact"]);
        psnr_error.check("exact", psnr(&exact_a, &exact_b).unwrap(), &expected["psnr_u8_exact"]);
        let key = "ssim_skimage_sample_cov_f64";
        ssim_error.check(
            key,
            ssim(&exact_a, &exact_b, SsimVariant::SkimageSampleCov).unwrap(),
            &expected[key],
        );
        // The other golden values were computed from inputs rounded to f32.
        let rounded = |bytes: &[u8]| bytes.iter().map(|&v| f32::from(v) / 255.0).collect::<Vec<f32>>();
        let (a, b) = (rounded(&a), rounded(&b));
        let (a, b) = (view(Pixels::Unit(&a)), view(Pixels::Unit(&b)));
        mse_error.check("f32", mse(&a, &b).unwrap(), &expected["mse"]);
        psnr_error.check("f32", psnr(&a, &b).unwrap(), &expected["psnr"]);
        for (variant, key) in [
            (SsimVariant::Skimage, "ssim_skimage_f64"),
            (SsimVariant::Skimage, "ssim_valid_window_mean_f64"),
            (SsimVariant::Torchmetrics, "ssim_torchmetrics_f64"),
        ] {
            ssim_error.check(key, ssim(&a, &b, variant).unwrap(), &expected[key]);
        }
    }
}

fn view(pixels: Pixels<'_>) -> RgbView<'_> {
    RgbView::new(154, 280, pixels).unwrap()
}

#[test]
fn depth_metrics_and_their_edge_cases() {
    let golden = &json(include_str!("golden/metrics.json"))["depth"];
    let (reference, prediction) = (f32s("depth_ref"), f32s("depth_pred"));
    let support = depth_support(&reference, [0.1, 5.0]);
    let expected: Vec<bool> = bytes("depth_support_u8").iter().map(|&v| v != 0).collect();
    assert_eq!(support, expected);
    let mut error = Worst::new("depth metrics", 1e-12);
    let mut compare = |name: &str, support: &[bool], scale: f64| {
        let scores = depth_scores(&prediction, &reference, support, scale).unwrap();
        assert_eq!(scores.count, golden[name]["n"].as_u64().unwrap());
        error.check(name, scores.absrel, &golden[name]["absrel"]);
        error.check(name, scores.rmse_m, &golden[name]["rmse"]);
        error.check(name, scores.delta1, &golden[name]["delta1"]);
    };
    let scale = median_scale(&prediction, &reference, &support);
    compare("main", &support, 1.0);
    compare("median_scaled", &support, scale);
    compare("far", &far_support(&reference, &support), 1.0);
    error.check("median scale", scale, &golden["median_scale"]);
}

#[test]
fn robot_depth_on_the_core() {
    let golden = &json(include_str!("golden/metrics.json"))["depth"]["robot_core"];
    let link: Vec<u8> = i16s("core_link_i16")
        .iter()
        .map(|&id| u8::try_from(id).unwrap_or(255))
        .collect();
    let (mesh, stereo, prediction) = (f32s("core_mesh"), f32s("core_stereo"), f32s("core_pred"));
    let support = depth_support(&stereo, [0.1, 5.0]);
    let core = robot_core(
        48,
        64,
        &link,
        &mesh,
        &stereo,
        &support,
        golden["threshold_m"].as_f64().unwrap(),
    );
    let expected: Vec<bool> = bytes("core_mask_u8").iter().map(|&v| v != 0).collect();
    assert_eq!(core, expected);
    let (sum, count) = robot_depth_error(&prediction, &stereo, &core);
    assert_eq!(count, golden["n"].as_u64().unwrap());
    Worst::new("robot depth [mm]", 1e-10).check("core", 1000.0 * sum / count as f64, &golden["error_mm"]);
}

#[test]
fn robot_displacement_errors() {
    let golden = &json(include_str!("golden/metrics.json"))["depth"]["robot_epe"];
    let sums: Vec<Vec<f32>> = (0..3).map(|v| f32s(&format!("epe_disp_num{v}"))).collect();
    let weights: Vec<Vec<f32>> = (0..3).map(|v| f32s(&format!("epe_alpha{v}"))).collect();
    let maps: Vec<DisplacementMap<'_>> = (0..3)
        .map(|v| DisplacementMap::new(48, 64, &sums[v], &weights[v]).unwrap())
        .collect();
    let (pixels, anchors, queries) = (f32s("epe_track_px"), f32s("epe_Xa"), f32s("epe_Xt"));
    let mut error = Worst::new("robot EPE [mm]", 1e-4);
    let mut errors = Vec::new();
    for (track, &camera) in i16s("epe_track_cam_i16").iter().enumerate() {
        let sample = TrackSample {
            pixel: [pixels[track * 2], pixels[track * 2 + 1]],
            anchor_m: anchors[track * 3..][..3].try_into().unwrap(),
            query_m: queries[track * 3..][..3].try_into().unwrap(),
        };
        let found = track_error_m(&maps[camera as usize], &sample);
        error.check("track", 1000.0 * found, &golden["per_track_nearest_mm"][track]);
        errors.push(found);
    }
    error.check("mean", 1000.0 * mean(&errors).unwrap(), &golden["nearest_mm"]);
}

#[test]
fn bootstrap_intervals_are_bit_equal() {
    let sets = json(include_str!("golden/bootstrap.json"));
    let sets = sets.as_array().unwrap();
    assert_eq!(sets.len(), 2);
    for set in sets {
        let values = numbers(&set["values"]);
        let indices: Vec<f64> = Pcg64::from_seed(42)
            .integers(values.len() as u32, values.len())
            .into_iter()
            .map(f64::from)
            .collect();
        assert_eq!(indices, numbers(&set["first_resample_indices"]));
        let mut means = bootstrap_means(&values);
        assert_eq!(means[..10], numbers(&set["first_10_resample_means"]));
        means.sort_unstable_by(f64::total_cmp);
        let order: Vec<f64> = [249, 250, 9749, 9750].iter().map(|&at| means[at]).collect();
        assert_eq!(order, numbers(&set["sorted_means_at_249_250_9749_9750"]));
        let interval = bootstrap_interval(&values).unwrap();
        assert_eq!(interval.mean, set["mean"].as_f64().unwrap());
        assert_eq!(vec![interval.low, interval.high], numbers(&set["ci95"]));
    }
    println!("bootstrap: two sets of 10,000 resamples equal in every bit");
}

fn numbers(value: &Value) -> Vec<f64> {
    value.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}
