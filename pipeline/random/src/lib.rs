//! Random numbers that are bit-equal to numpy's `default_rng`, and the query plan made from them.
//!
//! Cohorts, query plans and bootstrap intervals must not depend on the language that draws them, so the streams of
//! numpy (checked against 2.4.6) are reproduced from their definition: [`SeedSequence`] turns integers into a state,
//! [`Pcg64`] is the PCG XSL-RR 128/64 generator, and its methods draw bounded integers, permutations and samples the
//! way numpy's `Generator` does. [`query_plan`] is the fixed plan of query times of a clip.
//!
//! ```
//! let mut rng = rogs_random::Pcg64::from_seed(42);
//! assert_eq!(rng.next_double(), 0.7739560485559633);
//! assert_eq!(&rogs_random::Pcg64::from_seed(42).permutation(498)[..3], &[164, 219, 268]);
//! ```

mod pcg64;
mod query_plan;
mod sample;
mod seed_sequence;

pub use pcg64::Pcg64;
pub use query_plan::{
    INCLUDE_SOURCES_PROBABILITY, PLAN_SEED, QUERY_REQUESTS, QueryPlan, episode_words, query_plan, query_plan_from_words,
};
pub use seed_sequence::SeedSequence;
