//! Refinement keeps the displacements of Stage 1, bit for bit.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use proptest::prelude::*;
use rogs_field::{Correction, TimedField};
use rogs_refine::{RefineParams, refine};
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, RefinementStep, ScaleResidual};
use rogs_stage2::weights::uniform;
use rogs_worker::Unobserved;
use support::{example, random_network};

/// A number with few mantissa bits, so that sums of a few of them are exact in f32.
fn coarse(value: f32) -> f32 {
    (value * 4096.0).round() / 4096.0
}

fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

/// Centre of a Gaussian at a slice, metres, as the specification writes it.
fn centre(field: &Field, slice: usize, delta: &[f32], n: usize) -> [f32; 3] {
    [0, 1, 2]
        .map(|axis| (field.position_m[3 * n + axis] + delta[axis]) + field.slices[slice].displacement_m[3 * n + axis])
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Whatever the correction, what a renderer or scorer reads as displacement between two times has the same bits.
    #[test]
    fn displacements_between_any_two_times_have_the_same_bits(seed in 0u64..1 << 40, size in 0.001f32..50.0) {
        let field = example(seed).field;
        let mut correction = Correction::zero(field.len());
        let residuals = uniform("residual", field.len() * RESIDUAL_CHANNELS, seed, size);
        let skipped = uniform("skip", field.len(), seed, 1.0);
        for (n, residual) in residuals.chunks_exact(RESIDUAL_CHANNELS).enumerate().filter(|(n, _)| skipped[*n] > -0.5) {
            correction.add(n, residual, [0.7, 0.2, 0.4, 0.9, 0.1]);
        }
        let (touched, values) = correction.to_touched();
        let step = RefinementStep { update: 1, touched, values };
        let before = TimedField::new(&field).unwrap();
        let after = before.with_correction(&step, ScaleResidual::PreActivation).unwrap();
        for from in &field.slices {
            for to in &field.slices {
                let (a, b) = (before.displacement_m(from.time, to.time).unwrap(), after.displacement_m(from.time, to.time).unwrap());
                prop_assert_eq!(bits(&a), bits(&b));
                let rendered = after.gaussians_with_displacement(to.time, from.time, to.time).unwrap();
                prop_assert_eq!(bits(&rendered.extra), bits(&a), "the channel that motion renders composite");
            }
        }
    }

    /// Where the sums are exact in f32, the very centres differ between times by the same bits before and after.
    #[test]
    fn centres_differ_between_times_by_the_same_bits_where_sums_are_exact(seed in 0u64..1 << 40) {
        let mut field = example(seed).field;
        field.position_m.iter_mut().for_each(|value| *value = coarse(*value));
        for slice in &mut field.slices {
            slice.displacement_m.iter_mut().for_each(|value| *value = coarse(*value));
        }
        let shifts: Vec<f32> = uniform("delta", 3 * field.len(), seed, 0.028).into_iter().map(coarse).collect();
        for n in 0..field.len() {
            let delta = &shifts[3 * n..3 * n + 3];
            for (a, b) in [(0, 1), (0, 2), (1, 2)] {
                for axis in 0..3 {
                    let before = centre(&field, b, &[0.0; 3], n)[axis] - centre(&field, a, &[0.0; 3], n)[axis];
                    let after = centre(&field, b, delta, n)[axis] - centre(&field, a, delta, n)[axis];
                    prop_assert_eq!(before.to_bits(), after.to_bits());
                }
            }
        }
    }
}

#[test]
fn a_refined_field_moves_exactly_as_before_and_its_centres_are_shifted_by_one_value_for_all_times() {
    let example = example(77);
    let params = RefineParams {
        updates: Some(2),
        ..RefineParams::default()
    };
    let refinement = refine(example.inputs(), &random_network("ci", 3), &params, &mut Unobserved).unwrap();
    let field = &example.field;
    let before = TimedField::new(field).unwrap();
    let after = before.with_refinement(&refinement).unwrap();
    let times: Vec<f64> = field.slices.iter().map(|slice| slice.time).collect();
    for &from in &times {
        for &to in &times {
            let (a, b) = (
                before.displacement_m(from, to).unwrap(),
                after.displacement_m(from, to).unwrap(),
            );
            assert_eq!(bits(&a), bits(&b));
        }
    }
    let step = refinement.steps.last().unwrap();
    let correction = Correction::from_touched(&step.touched, &step.values).unwrap();
    for (index, &time) in times.iter().enumerate() {
        let scene = after.gaussians(time).unwrap();
        for n in 0..field.len() {
            let expected = centre(field, index, correction.row(n), n).map(|metres| metres * 3.5);
            assert_eq!(scene.means[3 * n..3 * n + 3], expected, "Gaussian {n} at {time}");
        }
    }
}
