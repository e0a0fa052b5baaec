//! The recurrence on a small clip.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use rogs_field::TimedField;
use rogs_refine::{ClipInputs, RefineParams, load_refiner, refine};
use rogs_schemas::records::field::Field;
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, Refinement, ScaleResidual};
use rogs_weights::Unfiled;
use rogs_worker::{Observer, Unobserved};
use support::{example, random_network};

fn params(updates: u32) -> RefineParams {
    RefineParams {
        updates: Some(updates),
        weights: Some(Unfiled::Seeded),
        ..RefineParams::default()
    }
}

fn run(inputs: ClipInputs<'_>, preset: &str, params: &RefineParams) -> Refinement {
    let params = RefineParams {
        preset: preset.into(),
        ..params.clone()
    };
    refine(inputs, &random_network(preset, 5), &params, &mut Unobserved).unwrap()
}

/// Renders of all means, colours and so on: every number that the rasteriser would see.
fn seen(field: &Field, refinement: Option<&Refinement>) -> Vec<rogs_splat::Gaussians> {
    let timed = TimedField::new(field).unwrap();
    let timed = refinement.map_or(timed, |refinement| timed.with_refinement(refinement).unwrap());
    field
        .slices
        .iter()
        .map(|slice| timed.gaussians(slice.time).unwrap())
        .collect()
}

#[test]
fn no_update_is_exactly_the_stage_1_field() {
    let example = example(1);
    let refinement = run(example.inputs(), "ci", &params(0));
    assert_eq!((refinement.updates, refinement.steps.len()), (0, 1));
    assert!(refinement.steps[0].values.is_empty() && refinement.steps[0].touched.iter().all(|&flag| flag == 0));
    assert_eq!(seen(&example.field, Some(&refinement)), seen(&example.field, None));
}

#[test]
fn seeded_weights_correct_nothing_and_say_that_they_are_untrained() {
    let example = example(2);
    let network = load_refiner(&params(2), None).unwrap();
    assert!(!network.info.trained && network.info.description.contains("UNTRAINED"));
    assert!(
        network
            .warnings
            .iter()
            .any(|warning| warning.contains("UNTRAINED") && warning.contains("exactly zero"))
    );
    let refinement = refine(example.inputs(), &network, &params(2), &mut Unobserved).unwrap();
    assert_eq!((refinement.updates, &refinement.weights), (2, &network.info));
    assert_eq!(seen(&example.field, Some(&refinement)), seen(&example.field, None));
}

#[test]
fn a_network_that_does_something_corrects_what_the_cameras_see_within_five_centimetres() {
    let example = example(3);
    for preset in ["ci", "cpu"] {
        let refinement = run(example.inputs(), preset, &params(3));
        let step = refinement.steps.last().unwrap();
        let touched = step.touched.iter().filter(|&&flag| flag != 0).count();
        let total = example.field.len();
        assert!(
            touched > total / 4 && touched < total,
            "{preset}: {touched} of {total} Gaussians"
        );
        let mut bounded = 0;
        for row in step.values.chunks_exact(RESIDUAL_CHANNELS) {
            let norm = row[..3]
                .iter()
                .map(|&v| f64::from(v) * f64::from(v))
                .sum::<f64>()
                .sqrt();
            assert!(norm <= 0.05 * (1.0 + 1e-6), "{norm}");
            bounded += usize::from(norm > 0.0499);
            assert!(row.iter().all(|value| value.is_finite()));
        }
        assert!(
            bounded > 0,
            "{preset}: the bound is reached somewhere, or this test shows nothing"
        );
        assert_ne!(seen(&example.field, Some(&refinement)), seen(&example.field, None));
    }
}

#[test]
fn resuming_after_any_update_gives_what_an_undisturbed_run_gives() {
    let example = example(4);
    let keep = |updates| RefineParams {
        keep_state: true,
        keep_intermediate: true,
        ..params(updates)
    };
    let whole = run(example.inputs(), "ci", &keep(3));
    assert_eq!(
        whole.steps.iter().map(|step| step.update).collect::<Vec<_>>(),
        [1, 2, 3]
    );
    for updates in 0..=3 {
        let part = run(example.inputs(), "ci", &keep(updates));
        assert_eq!(part.steps.last().map(|step| step.update), Some(updates));
        if updates > 0 {
            assert_eq!(
                part.steps,
                whole.steps[..updates as usize],
                "intermediate steps are those of shorter runs"
            );
        }
        let resumed = run(
            ClipInputs {
                resume: Some(&part),
                ..example.inputs()
            },
            "ci",
            &keep(3),
        );
        assert!(resumed == whole, "resumed after {updates} updates");
    }
}

#[test]
fn an_earlier_refinement_that_does_not_fit_is_refused_with_the_reason() {
    let example = example(4);
    let kept = run(
        example.inputs(),
        "ci",
        &RefineParams {
            keep_state: true,
            ..params(2)
        },
    );
    let refused = |earlier: &Refinement, params: &RefineParams| {
        let inputs = ClipInputs {
            resume: Some(earlier),
            ..example.inputs()
        };
        refine(inputs, &random_network("ci", 5), params, &mut Unobserved).unwrap_err()
    };
    assert!(refused(&kept, &params(1)).message.contains("ends after update 2"));
    let linear = RefineParams {
        scale_residual: ScaleResidual::Linear,
        ..params(3)
    };
    assert!(refused(&kept, &linear).message.contains("scale residuals"));
    assert!(
        refused(
            &kept,
            &RefineParams {
                keep_intermediate: true,
                ..params(3)
            }
        )
        .message
        .contains("corrections of all")
    );
    let forgetful = Refinement {
        resume_state: Vec::new(),
        ..kept.clone()
    };
    assert!(refused(&forgetful, &params(3)).hint.unwrap().contains("keep_state"));
    let mut other = kept.clone();
    other.field_key.0[0] ^= 1;
    assert!(refused(&other, &params(3)).message.contains("another field"));
    let mut short = kept;
    short.steps[0].values.pop();
    assert!(refused(&short, &params(3)).message.contains("contradict"));
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let example = example(5);
    for preset in ["ci", "cpu"] {
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                run(
                    example.inputs(),
                    preset,
                    &RefineParams {
                        keep_state: true,
                        ..params(2)
                    },
                )
            })
        };
        let one = with(1);
        assert!(one == with(2) && one == with(3), "{preset}");
    }
}

#[test]
fn linear_scale_residuals_and_fresh_neighbours_are_other_networks_that_run_too() {
    let example = example(6);
    let plain = run(example.inputs(), "ci", &params(2));
    let linear = run(
        example.inputs(),
        "ci",
        &RefineParams {
            scale_residual: ScaleResidual::Linear,
            ..params(2)
        },
    );
    assert_eq!(linear.scale_residual, ScaleResidual::Linear);
    assert_ne!(plain.steps, linear.steps);
    // Neighbours are the same at the first update, and differ after centres have moved.
    let fresh = |updates| {
        run(
            example.inputs(),
            "ci",
            &RefineParams {
                recompute_knn: true,
                ..params(updates)
            },
        )
    };
    assert_eq!(fresh(1).steps, run(example.inputs(), "ci", &params(1)).steps);
    assert_ne!(fresh(2).steps, plain.steps);
}

#[test]
fn a_larger_epsilon_corrects_fewer_gaussians() {
    let example = example(7);
    let touched = |epsilon: f32| {
        let refinement = run(example.inputs(), "ci", &RefineParams { epsilon, ..params(1) });
        refinement.steps[0].touched.iter().filter(|&&flag| flag != 0).count()
    };
    let counts = [0.0, 1e-3, 0.2, 1e6].map(touched);
    assert!(
        counts[0] >= counts[1] && counts[1] > counts[2] && counts[2] > 0 && counts[3] == 0,
        "{counts:?}"
    );
}

#[test]
fn records_that_do_not_belong_together_are_refused() {
    let mut example = example(8);
    let network = random_network("ci", 5);
    let message = |inputs: ClipInputs<'_>| {
        refine(inputs, &network, &params(1), &mut Unobserved)
            .unwrap_err()
            .message
    };
    let other = support::example(9);
    let mut renamed = other.robot.clone();
    renamed.clip_id = "floor".parse().unwrap();
    assert!(
        message(ClipInputs {
            robot: &renamed,
            ..example.inputs()
        })
        .contains("floor")
    );
    let mut missing = other.field.clone();
    missing.slices.remove(2);
    assert!(
        message(ClipInputs {
            field: &missing,
            ..example.inputs()
        })
        .contains("source frame 4")
    );
    let mut short = other.robot.clone();
    short.base_from_camera.pop();
    assert!(
        message(ClipInputs {
            robot: &short,
            ..example.inputs()
        })
        .contains("camera poses")
    );
    example.clip.cameras[1].recorded = None;
    assert!(message(example.inputs()).contains("ext1"));
}

/// Progress as it was told.
struct Heard(Vec<(f64, String)>);

impl Observer for Heard {
    fn progress(&mut self, fraction: f64, what: &str) {
        self.0.push((fraction, what.to_owned()));
    }
}

#[test]
fn progress_names_update_and_source_frame_and_never_goes_back() {
    let example = example(8);
    let mut heard = Heard(Vec::new());
    refine(example.inputs(), &random_network("ci", 5), &params(2), &mut heard).unwrap();
    let Heard(heard) = heard;
    assert!(heard.is_sorted_by(|a, b| a.0 <= b.0) && heard.iter().all(|(fraction, _)| (0.0..=1.0).contains(fraction)));
    assert!(
        heard
            .iter()
            .any(|(_, message)| message == "update 2 of 2, source frame 4: error features"),
        "{heard:?}"
    );
}
