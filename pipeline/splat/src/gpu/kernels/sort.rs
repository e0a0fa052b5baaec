//! Stable radix sort of (key, value) pairs, four bits a pass, without atomics that could show in the order.

use cubecl::prelude::*;

use super::WIDE;

/// Pairs per unit.
pub(crate) const ITEMS: usize = 8;
/// Pairs per cube.
pub(crate) const BLOCK: usize = ITEMS * WIDE;
/// Bits of a digit.
pub(crate) const BITS: u32 = 4;
/// Values of a digit.
pub(crate) const DIGITS: usize = 16;
/// Words that hold the counters of all digits of a unit, two counters each.
const WORDS: usize = DIGITS / 2;

/// Counters of the digits of this unit's pairs, two to a word, in `counters` at `word * WIDE + unit`.
#[cube]
fn count_digits(keys: &[u32], counters: &mut Shared<[u32]>, first: usize, count: usize, shift: u32) {
    let unit = UNIT_POS as usize;
    #[unroll]
    for word in 0..WORDS {
        counters[word * WIDE + unit] = 0u32;
    }
    #[unroll]
    for k in 0..ITEMS {
        if first + k < count {
            let digit = (keys[first + k] >> shift) & 15u32;
            counters[(digit >> 1u32) as usize * WIDE + unit] += 1u32 << ((digit & 1u32) * 16u32);
        }
    }
}

/// How often every digit occurs in every block: `[digits, blocks]`.
#[cube(launch)]
pub fn histogram(keys: &[u32], counts: &mut [u32], count: u32, blocks: u32, shift: u32) {
    let unit = UNIT_POS as usize;
    let mut counters = Shared::<[u32]>::new_slice(comptime!(WORDS * WIDE));
    count_digits(
        keys,
        &mut counters,
        CUBE_POS * BLOCK + unit * ITEMS,
        count as usize,
        shift,
    );
    sync_cube();
    if unit < DIGITS && CUBE_POS < blocks as usize {
        let mut sum = 0u32;
        for other in 0..WIDE {
            sum += (counters[(unit / 2) * WIDE + other] >> ((unit as u32 & 1u32) * 16u32)) & 0xffffu32;
        }
        counts[unit * blocks as usize + CUBE_POS] = sum;
    }
}

/// Moves every pair to its place; `offsets` are the exclusive sums of the histogram.
#[cube(launch)]
pub fn scatter(
    keys: &[u32],
    values: &[u32],
    offsets: &[u32],
    keys_out: &mut [u32],
    values_out: &mut [u32],
    count: u32,
    blocks: u32,
    shift: u32,
) {
    let unit = UNIT_POS as usize;
    let first = CUBE_POS * BLOCK + unit * ITEMS;
    let mut counters = Shared::<[u32]>::new_slice(comptime!(WORDS * WIDE));
    let mut partial = Shared::<[u32]>::new_slice(WIDE);
    count_digits(keys, &mut counters, first, count as usize, shift);
    sync_cube();
    // Each row of counters is summed by 32 units of 8 counters; totals of a block fit into 16 bits.
    let row = unit / 32;
    let own = row * WIDE + (unit % 32) * 8;
    let mut sum = 0u32;
    for k in 0..8usize {
        sum += counters[own + k];
    }
    partial[unit] = sum;
    sync_cube();
    let mut before = 0u32;
    for k in row * 32..unit {
        before += partial[k];
    }
    for k in 0..8usize {
        let here = counters[own + k];
        counters[own + k] = before;
        before += here;
    }
    sync_cube();
    for k in 0..ITEMS {
        if first + k < count as usize {
            let key = keys[first + k];
            let digit = (key >> shift) & 15u32;
            let word = (digit >> 1u32) as usize * WIDE + unit;
            let half = (digit & 1u32) * 16u32;
            let rank = (counters[word] >> half) & 0xffffu32;
            counters[word] += 1u32 << half;
            let to = (offsets[digit as usize * blocks as usize + CUBE_POS] + rank) as usize;
            keys_out[to] = key;
            values_out[to] = values[first + k];
        }
    }
}
