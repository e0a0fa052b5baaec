//! numpy's `SeedSequence`: integers of any size hashed into generator state (`docs/spec/scoring.md` section 2).

const INIT_A: u32 = 0x43b0_d7e5;
const MULT_A: u32 = 0x931e_8875;
const INIT_B: u32 = 0x8b51_f9dd;
const MULT_B: u32 = 0x58f3_8ded;
const MIX_LEFT: u32 = 0xca01_f9dd;
const MIX_RIGHT: u32 = 0x4973_f715;
const POOL_WORDS: usize = 4;

/// A mixed pool of entropy from which generator states are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SeedSequence {
    pool: [u32; POOL_WORDS],
}

impl SeedSequence {
    /// The sequence of one integer or of a list of integers, as `SeedSequence(42)` and `SeedSequence([42, 7])`.
    ///
    /// An entry becomes its little-endian 32-bit words without leading zero words; zero is one word.
    #[must_use]
    pub fn from_integers(entropy: &[u64]) -> Self {
        let mut words = Vec::with_capacity(entropy.len() * 2);
        for &value in entropy {
            words.push(value as u32);
            if value >> 32 != 0 {
                words.push((value >> 32) as u32);
            }
        }
        Self::from_words(&words)
    }

    /// The sequence of entropy words already split.
    #[must_use]
    pub fn from_words(words: &[u32]) -> Self {
        let mut hash = HashMix { constant: INIT_A };
        let mut pool = [0; POOL_WORDS];
        for (index, slot) in pool.iter_mut().enumerate() {
            *slot = hash.next(words.get(index).copied().unwrap_or(0));
        }
        for source in 0..POOL_WORDS {
            for target in (0..POOL_WORDS).filter(|&target| target != source) {
                pool[target] = mix(pool[target], hash.next(pool[source]));
            }
        }
        for &word in words.iter().skip(POOL_WORDS) {
            for slot in &mut pool {
                *slot = mix(*slot, hash.next(word));
            }
        }
        Self { pool }
    }

    /// The mixed pool.
    #[must_use]
    pub fn pool(&self) -> [u32; POOL_WORDS] {
        self.pool
    }

    /// `N` 64-bit words of state, the low 32-bit half generated first.
    #[must_use]
    pub fn generate_u64<const N: usize>(&self) -> [u64; N] {
        let mut constant = INIT_B;
        let mut index = 0;
        let mut word = || {
            let mut value = self.pool[index % POOL_WORDS] ^ constant;
            constant = constant.wrapping_mul(MULT_B);
            value = value.wrapping_mul(constant);
            index += 1;
            u64::from(value ^ (value >> 16))
        };
        std::array::from_fn(|_| {
            let low = word();
            low | (word() << 32)
        })
    }
}

/// The running hash with which words enter the pool.
struct HashMix {
    constant: u32,
}

impl HashMix {
    fn next(&mut self, word: u32) -> u32 {
        let mut value = word ^ self.constant;
        self.constant = self.constant.wrapping_mul(MULT_A);
        value = value.wrapping_mul(self.constant);
        value ^ (value >> 16)
    }
}

fn mix(left: u32, right: u32) -> u32 {
    let value = MIX_LEFT.wrapping_mul(left).wrapping_sub(MIX_RIGHT.wrapping_mul(right));
    value ^ (value >> 16)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_zero_entry_is_one_zero_word() {
        assert_eq!(
            SeedSequence::from_integers(&[42, 0, 7]),
            SeedSequence::from_words(&[42, 0, 7])
        );
        assert_ne!(
            SeedSequence::from_integers(&[42, 0, 7]),
            SeedSequence::from_words(&[42, 7])
        );
        assert_eq!(
            SeedSequence::from_integers(&[1 << 32]),
            SeedSequence::from_words(&[0, 1])
        );
    }
}
