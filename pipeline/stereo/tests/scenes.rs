//! The matcher on made-up scenes whose depth is known at every pixel.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::{Eye, HEIGHT, RIG, Surface, WIDTH, compare, eye, pair};
use rogs_stereo::{Concern, Grey, MatcherParams, Rig, StereoMatch, diagnose, match_offset_pair, match_pair};

fn params() -> MatcherParams {
    MatcherParams {
        near_m: 0.3,
        ..MatcherParams::default()
    }
}

fn matched([left, right]: &[Eye; 2]) -> StereoMatch {
    match_pair(&left.image, &right.image, &RIG, &params()).unwrap()
}

/// Depths of both eyes beside their truth.
fn agreements(eyes: &[Eye; 2]) -> [common::Agreement; 2] {
    let depths = matched(eyes).depths_m(&RIG);
    [0, 1].map(|index| {
        let found = depths[index].iter().map(|&depth| f64::from(depth));
        compare(found, eyes[index].depth_m.iter().copied())
    })
}

#[test]
fn a_wall_lies_at_its_depth_in_both_eyes() {
    for depth_m in [0.5, 1.3, 3.0] {
        for agreement in agreements(&pair(&[Surface::wall(depth_m, 1)])) {
            // At 0.5 m the eyes share 174 of 200 columns.
            assert!(agreement.coverage > 0.8, "{depth_m} m: {agreement:?}");
            // An eighth of a pixel.
            let bound = 0.125 * depth_m / (RIG.focal_px * RIG.baseline_m);
            assert!(agreement.absrel < bound, "{depth_m} m: {agreement:?}, expected {bound}");
        }
    }
}

#[test]
fn a_slanted_wall_is_no_staircase() {
    let slanted = Surface {
        normal: [-0.5, 0.2, 1.0],
        offset: 1.2,
        bounds: None,
        texture: Some(2),
    };
    let eyes = pair(&[slanted]);
    for agreement in agreements(&eyes) {
        assert!(agreement.coverage > 0.8, "{agreement:?}");
        assert!(agreement.absrel < 0.015, "{agreement:?}");
    }
    // Whole pixels alone would give as many values as there are pixels of disparity.
    let mut values: Vec<i32> = matched(&eyes)
        .left_px
        .iter()
        .map(|value| (value * 8.0).round() as i32)
        .collect();
    values.sort_unstable();
    values.dedup();
    assert!(values.len() > 60, "{} different eighths of a pixel", values.len());
}

/// A board before a wall: the wall beside it is seen by one eye only, and has no depth there.
#[test]
fn what_one_eye_alone_sees_is_unknown() {
    let board = Surface {
        bounds: Some([-0.15, 0.15, -0.2, 0.2]),
        ..Surface::wall(0.6, 3)
    };
    let eyes = pair(&[Surface::wall(1.5, 4), board]);
    let found = matched(&eyes).depths_m(&RIG);
    let shared = |index: usize| {
        // Where the point of this pixel lies in the other eye, and whether that eye sees the same surface there.
        let sign = [-1.0, 1.0][index];
        let own = &eyes[index];
        let other = &eyes[1 - index];
        (0..own.depth_m.len()).map(move |at| {
            let column = (at % WIDTH) as f64 + sign * RIG.disparity_px(own.depth_m[at]);
            let column = column.round();
            (0.0..WIDTH as f64).contains(&column) && {
                let partner = at - at % WIDTH + column as usize;
                other.surface[partner] == own.surface[at]
            }
        })
    };
    for index in [0, 1] {
        let hidden: Vec<usize> = shared(index)
            .enumerate()
            .filter(|(_, shared)| !shared)
            .map(|(at, _)| at)
            .collect();
        assert!(hidden.len() > 500, "{} hidden pixels", hidden.len());
        let wrong = hidden.iter().filter(|&&at| {
            let [found, truth] = [f64::from(found[index][at]), eyes[index].depth_m[at]];
            found.is_finite() && (found - truth).abs() > 0.1 * truth
        });
        let share = wrong.count() as f64 / hidden.len() as f64;
        assert!(
            share < 0.08,
            "eye {index}: {share} of the hidden pixels have a wrong depth"
        );
        let depths = found[index].iter().map(|&depth| f64::from(depth));
        let agreement = compare(depths, eyes[index].depth_m.iter().copied());
        assert!(
            agreement.absrel < 0.03 && agreement.coverage > 0.6,
            "eye {index}: {agreement:?}"
        );
    }
}

/// How far the windows of a pixel and of the candidates beside its winner reach, pixels.
const BORDER: usize = 12;

/// A bare board in a textured room: its inside is unknown, not made up from its edges.
#[test]
fn what_has_no_texture_is_unknown() {
    let bare = Surface {
        bounds: Some([-0.5, 0.5, -0.35, 0.35]),
        texture: None,
        ..Surface::wall(0.9, 0)
    };
    let eyes = pair(&[Surface::wall(1.4, 5), bare]);
    let found = matched(&eyes);
    for (index, disparity) in [found.left_px, found.right_px].iter().enumerate() {
        let inside = |at: &usize| {
            let (row, column) = (at / WIDTH, at % WIDTH);
            let window = |at: usize| eyes[index].surface[at] == 1;
            (BORDER..HEIGHT - BORDER).contains(&row)
                && (BORDER..WIDTH - BORDER).contains(&column)
                && [at - BORDER, at + BORDER, at - BORDER * WIDTH, at + BORDER * WIDTH]
                    .into_iter()
                    .all(window)
        };
        let bare: Vec<usize> = (0..WIDTH * HEIGHT).filter(inside).collect();
        assert!(bare.len() > 500, "{} bare pixels", bare.len());
        let known = bare.iter().filter(|&&at| disparity[at].is_finite()).count();
        assert_eq!(known, 0, "eye {index}: of {} bare pixels", bare.len());
    }
    let flat = Grey::new(WIDTH, HEIGHT, vec![90; WIDTH * HEIGHT]).unwrap();
    let nothing = match_pair(&flat, &flat, &RIG, &params()).unwrap();
    assert!(
        nothing
            .left_px
            .iter()
            .chain(&nothing.right_px)
            .all(|value| value.is_nan())
    );
}

/// Noise that differs between the eyes is texture to look at, and says nothing.
#[test]
fn noise_of_each_eye_alone_gives_no_depth() {
    let noise = |seed: u64| eye(&[Surface::wall(1.3, seed)], 0.0, 0.0).image;
    let found = match_pair(&noise(7), &noise(8), &RIG, &params()).unwrap();
    let known = found.left_px.iter().filter(|value| value.is_finite()).count();
    assert!(known < WIDTH * HEIGHT / 100, "{known} of {} pixels", WIDTH * HEIGHT);
}

#[test]
fn eyes_in_the_wrong_order_are_named() {
    let [left, right] = pair(&[Surface::wall(0.8, 9)]);
    assert_eq!(diagnose(&left.image, &right.image, &RIG, &params()).unwrap(), []);
    let concerns = diagnose(&right.image, &left.image, &RIG, &params()).unwrap();
    assert!(matches!(concerns[..], [Concern::Swapped { .. }]), "{concerns:?}");
    assert!(
        concerns[0]
            .to_string()
            .starts_with("left and right eyes look swapped: "),
        "{}",
        concerns[0]
    );
}

#[test]
fn rows_that_do_not_meet_are_told_with_their_offset() {
    let scene = [Surface::wall(1.0, 10)];
    let left = eye(&scene, 0.0, 0.0);
    for lower in [-3.0, -1.0, 1.5, 4.0] {
        let right = eye(&scene, RIG.baseline_m, lower);
        let concerns = diagnose(&left.image, &right.image, &RIG, &params()).unwrap();
        let [Concern::Rows { rows_px, matches }] = concerns[..] else {
            panic!("{lower} rows lower: {concerns:?}")
        };
        assert!(
            (f64::from(rows_px) - lower).abs() < 0.3 && matches > 20,
            "{lower}: {concerns:?}"
        );
        assert!(
            concerns[0].to_string().starts_with("the pair is not rectified: "),
            "{}",
            concerns[0]
        );
        // Matched with that offset, both eyes have their own rows back.
        let found = match_offset_pair(&left.image, &right.image, rows_px, &RIG, &params()).unwrap();
        for disparity in [found.left_px, found.right_px] {
            let depths = disparity.iter().map(|&value| f64::from(RIG.depth_m(value)));
            let agreement = compare(depths, left.depth_m.iter().copied());
            assert!(
                agreement.coverage > 0.75 && agreement.absrel < 0.02,
                "{lower}: {agreement:?}"
            );
        }
    }
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let eyes = pair(&[
        Surface::wall(1.2, 11),
        Surface {
            bounds: Some([-0.2, 0.1, -0.1, 0.3]),
            ..Surface::wall(0.5, 12)
        },
    ]);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool.install(|| matched(&eyes));
        let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<u32>>();
        [bits(&found.left_px), bits(&found.right_px)]
    };
    let one = with(1);
    assert!(one == with(3) && one == with(4));
}

#[test]
fn impossible_settings_and_sizes_are_refused() {
    let image = Grey::new(8, 4, vec![0; 32]).unwrap();
    let wider = Grey::new(9, 4, vec![0; 36]).unwrap();
    let error = match_pair(&image, &wider, &RIG, &params()).unwrap_err();
    assert!(error.to_string().contains("different sizes"), "{error}");
    assert!(
        Grey::new(8, 4, vec![0; 31])
            .unwrap_err()
            .to_string()
            .contains("needs 32 bytes, there are 31")
    );
    assert!(Grey::of_rgb(0, 4, &[]).is_err());
    let wrong = |change: fn(&mut MatcherParams)| {
        let mut params = params();
        change(&mut params);
        match_pair(&image, &image, &RIG, &params).unwrap_err().to_string()
    };
    assert!(wrong(|params| params.near_m = f64::NAN).contains("`near_m` NaN"));
    assert!(wrong(|params| params.far_m = 0.2).contains("ascending"));
    assert!(wrong(|params| params.max_disparities = 5).contains("`max_disparities` 5"));
    assert!(wrong(|params| params.small_step = 900).contains("steps 900"));
    assert!(wrong(|params| params.uniqueness_percent = 100).contains("`uniqueness_percent` 100"));
    assert!(wrong(|params| params.left_right_px = -1.0).contains("`left_right_px` -1"));
    assert!(wrong(|params| params.evidence_bits = f32::INFINITY).contains("`evidence_bits` inf"));
    // Images smaller than every window, and rigs that see nothing.
    for (width, height) in [(1, 1), (1, 30), (30, 1), (3, 3)] {
        let tiny = Grey::new(width, height, vec![7; width * height]).unwrap();
        let found = match_pair(&tiny, &tiny, &RIG, &params()).unwrap();
        assert!(found.left_px.iter().all(|value| value.is_nan()));
        assert_eq!(diagnose(&tiny, &tiny, &RIG, &params()).unwrap(), []);
    }
    for shift_px in [-1e9, 1e9] {
        let far_off = Rig { shift_px, ..RIG };
        let found = match_pair(&image, &image, &far_off, &params()).unwrap();
        assert!(found.left_px.iter().all(|value| value.is_nan()));
    }
}
