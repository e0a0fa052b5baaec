//! Bit-equality with numpy 2.4.6: every value here was written by numpy.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use rogs_random::{Pcg64, SeedSequence, episode_words, query_plan};
use serde_json::Value;

fn golden(text: &str) -> Value {
    serde_json::from_str(text).expect("golden file is JSON")
}

fn u32s(value: &Value) -> Vec<u32> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| u32::try_from(v.as_u64().unwrap()).unwrap())
        .collect()
}

fn u64s(value: &Value) -> Vec<u64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_str().unwrap().parse().unwrap())
        .collect()
}

#[test]
fn seeding_and_streams_of_seed_42() {
    let golden = golden(include_str!("golden/pcg64_seed42.json"));
    let sequence = SeedSequence::from_integers(&[42]);
    assert_eq!(sequence.pool().to_vec(), u32s(&golden["seed_sequence_pool_u32"]));
    assert_eq!(
        sequence.generate_u64::<4>().to_vec(),
        u64s(&golden["generate_state_u64"])
    );
    let rng = Pcg64::from_seed(42);
    assert_eq!(rng.state().to_string(), golden["pcg64_state"].as_str().unwrap());
    assert_eq!(rng.increment().to_string(), golden["pcg64_inc"].as_str().unwrap());
    let mut words = rng.clone();
    assert_eq!(
        (0..6).map(|_| words.next_u64()).collect::<Vec<_>>(),
        u64s(&golden["first_u64"])
    );
    let mut halves = rng.clone();
    assert_eq!(
        (0..6).map(|_| halves.next_u32()).collect::<Vec<_>>(),
        u32s(&golden["first_u32"])
    );
    let mut doubles = rng;
    for expected in golden["first_doubles"].as_array().unwrap() {
        assert_eq!(doubles.next_double().to_bits(), expected.as_f64().unwrap().to_bits());
    }
}

#[test]
fn a_double_leaves_the_buffered_half_word() {
    let mut rng = Pcg64::from_seed(42);
    let mut plain = rng.clone();
    let first = plain.next_u64();
    let second = plain.next_u64();
    assert_eq!(rng.next_u32(), first as u32);
    assert_eq!(rng.next_double(), (second >> 11) as f64 / 2f64.powi(53));
    assert_eq!(rng.next_u32(), (first >> 32) as u32);
}

#[test]
fn cohort_permutation_of_498() {
    let golden = golden(include_str!("golden/cohort_permutation_498.json"));
    let order = Pcg64::from_seed(42).permutation(498);
    assert_eq!(order, u32s(&golden["permutation"]));
    let mut first: Vec<u32> = order[..256].to_vec();
    first.sort_unstable();
    assert_eq!(first, u32s(&golden["first_256_sorted"]));
}

#[test]
fn query_plans_of_24_episodes() {
    let golden = golden(include_str!("golden/query_plan.json"));
    let sources = u32s(&golden["source_times"]);
    let frames = u32::try_from(golden["interval"].as_u64().unwrap()).unwrap();
    let plans = golden["plans"].as_array().unwrap();
    assert_eq!(plans.len(), 24);
    let mut included = 0;
    for expected in plans {
        let id = expected["episode_id"].as_str().unwrap();
        let words = episode_words(id);
        assert_eq!(words.to_vec(), u32s(&expected["sha256_words"]), "{id}");
        let mut rng = Pcg64::from_seeds(&[42, u64::from(words[0]), u64::from(words[1])]);
        assert_eq!(rng.next_double(), expected["u"].as_f64().unwrap(), "{id}");
        let plan = query_plan(id, frames, &sources);
        assert_eq!(plan.requests, u32s(&expected["requests_in_draw_order"]), "{id}");
        assert_eq!(plan.distinct, u32s(&expected["distinct_times"]), "{id}");
        included += usize::from(expected["include_source_times"].as_bool().unwrap());
    }
    assert!(included > 0, "the golden plans exercise the branch with source times");
}
