//! The fixed plan of query times of a clip (paper, evaluation appendix; `docs/spec/scoring.md` section 3).

use sha2::{Digest, Sha256};

use crate::pcg64::Pcg64;

/// First word of every plan's seed.
pub const PLAN_SEED: u64 = 42;
/// Requests of a plan, duplicates counted.
pub const QUERY_REQUESTS: u32 = 8;
/// Probability with which a plan holds all source times.
pub const INCLUDE_SOURCES_PROBABILITY: f64 = 0.25;

/// The query times of one clip, as clip frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QueryPlan {
    /// Requests in the order they were drawn; a time may occur twice when the source times are included.
    pub requests: Vec<u32>,
    /// Distinct requests, ascending: the times that are evaluated.
    pub distinct: Vec<u32>,
}

/// The plan of an episode for a clip of `frames` frames with the given source frames.
///
/// The seed is `[42, w0, w1]` with the [`episode_words`] of the episode id. With probability 0.25 the plan is all source
/// frames plus a sample (without replacement) of the whole clip up to eight requests, otherwise eight distinct frames.
/// Clips shorter than eight frames have fewer requests.
#[must_use]
pub fn query_plan(episode_id: &str, frames: u32, sources: &[u32]) -> QueryPlan {
    query_plan_from_words(episode_words(episode_id), frames, sources)
}

/// The same from the two words of the episode id's hash.
#[must_use]
pub fn query_plan_from_words(words: [u32; 2], frames: u32, sources: &[u32]) -> QueryPlan {
    let mut rng = Pcg64::from_seeds(&[PLAN_SEED, u64::from(words[0]), u64::from(words[1])]);
    let mut requests = Vec::with_capacity(QUERY_REQUESTS as usize);
    if rng.next_double() < INCLUDE_SOURCES_PROBABILITY {
        requests.extend_from_slice(sources);
    }
    let remaining = QUERY_REQUESTS.saturating_sub(requests.len() as u32);
    requests.extend(rng.choice(frames, remaining));
    let mut distinct = requests.clone();
    distinct.sort_unstable();
    distinct.dedup();
    QueryPlan { requests, distinct }
}

/// The first two little-endian 32-bit words of the SHA-256 of the UTF-8 episode id.
#[must_use]
pub fn episode_words(episode_id: &str) -> [u32; 2] {
    let digest = Sha256::digest(episode_id.as_bytes());
    let word = |at: usize| u32::from_le_bytes([digest[at], digest[at + 1], digest[at + 2], digest[at + 3]]);
    [word(0), word(4)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zero_word_takes_part_in_the_seed() {
        // A dropped zero would make these two plans equal.
        let seeds = Pcg64::from_seeds(&[PLAN_SEED, 0, 5]);
        assert_ne!(seeds, Pcg64::from_seeds(&[PLAN_SEED, 5]));
        let plan = query_plan_from_words([0, 5], 17, &[0, 4, 8, 12, 16]);
        assert_eq!(plan.requests.len(), 8);
    }

    #[test]
    fn a_short_clip_asks_for_every_frame_once() {
        let plan = query_plan_from_words([1, 2], 3, &[]);
        assert_eq!(plan.distinct, [0, 1, 2]);
    }
}
