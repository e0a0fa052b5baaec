//! Exclusive prefix sums of u32, and reading single numbers.

use cubecl::prelude::*;

use super::WIDE;

/// Numbers per unit.
pub(crate) const ITEMS: usize = 8;
/// Numbers per cube.
pub(crate) const BLOCK: usize = ITEMS * WIDE;

/// Sums inside blocks of `BLOCK` numbers; what lies behind `available` numbers counts as zero. `sums` gets the blocks'
/// totals.
#[cube(launch)]
pub fn blocks(input: &[u32], output: &mut [u32], sums: &mut [u32], count: u32, available: u32) {
    let unit = UNIT_POS as usize;
    let first = CUBE_POS * BLOCK + unit * ITEMS;
    let mut partial = Shared::<[u32]>::new_slice(WIDE);
    let mut own = Array::<u32>::new(ITEMS);
    let mut total = 0u32;
    #[unroll]
    for k in 0..ITEMS {
        let i = first + k;
        own[k] = total;
        if i < available as usize {
            total += input[i];
        }
    }
    partial[unit] = total;
    sync_cube();
    let mut step = 1usize;
    while step < WIDE {
        let mut add = 0u32;
        if unit >= step {
            add = partial[unit - step];
        }
        sync_cube();
        partial[unit] += add;
        sync_cube();
        step *= 2;
    }
    let before = partial[unit] - total;
    #[unroll]
    for k in 0..ITEMS {
        let i = first + k;
        if i < count as usize {
            output[i] = before + own[k];
        }
    }
    if unit == WIDE - 1 && CUBE_POS * BLOCK < count as usize {
        sums[CUBE_POS] = before + total;
    }
}

/// Adds what lies before every block.
#[cube(launch)]
pub fn add(output: &mut [u32], offsets: &[u32], count: u32) {
    let first = CUBE_POS * BLOCK + UNIT_POS as usize * ITEMS;
    #[unroll]
    for k in 0..ITEMS {
        if first + k < count as usize {
            output[first + k] += offsets[CUBE_POS];
        }
    }
}

/// One number of an array.
#[cube(launch)]
pub fn pick(input: &[u32], output: &mut [u32], index: u32) {
    if ABSOLUTE_POS == 0 {
        output[0] = input[index as usize];
    }
}
