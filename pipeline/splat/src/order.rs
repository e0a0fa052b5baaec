//! The depth order of a tile: keys are collected from all chunks and sorted by camera z, ties by index.

use crate::project::{ChunkBins, Projection};

/// Buffers of a tile's list, reused from tile to tile.
#[derive(Debug, Default)]
pub(crate) struct TileList {
    /// Record of every entry, records ascending. An entry's place here is its slot.
    pub(crate) records: Vec<u32>,
    /// Slots in depth order, with the depth bits in the high word.
    pub(crate) keys: Vec<u64>,
    /// Records in depth order.
    pub(crate) order: Vec<u32>,
    /// First slot of every chunk's entries and the end. `[chunks + 1]`
    pub(crate) segments: Vec<u32>,
    spare: Vec<u64>,
}

impl TileList {
    /// Collects and sorts the entries of a tile.
    pub(crate) fn fill(&mut self, projection: &Projection, tile: usize) {
        self.records.clear();
        self.keys.clear();
        self.segments.clear();
        self.segments.push(0);
        let entries = |chunk: &ChunkBins| (chunk.offsets[tile + 1] - chunk.offsets[tile]) as usize;
        let count = projection.chunks.iter().map(entries).sum();
        self.records.reserve(count);
        self.keys.reserve(count);
        self.segments.reserve(projection.chunks.len() + 1);
        let (mut low, mut high) = (u32::MAX, 0_u32);
        for chunk in &projection.chunks {
            let range = chunk.offsets[tile] as usize..chunk.offsets[tile + 1] as usize;
            for &key in &chunk.keys[range] {
                let depth = (key >> 32) as u32;
                low = low.min(depth);
                high = high.max(depth);
                self.keys
                    .push((key & 0xffff_ffff_0000_0000) | self.records.len() as u64);
                self.records.push(key as u32);
            }
            self.segments.push(self.records.len() as u32);
        }
        sort(&mut self.keys, &mut self.spare, low, high);
        self.order.clear();
        self.order
            .extend(self.keys.iter().map(|&key| self.records[(key & 0xffff_ffff) as usize]));
    }

    /// The list; what it no longer needs stays for the next one.
    pub(crate) fn take(&mut self) -> Self {
        let spare = std::mem::take(&mut self.spare);
        std::mem::replace(
            self,
            Self {
                spare,
                ..Self::default()
            },
        )
    }

    /// Number of entries.
    pub(crate) fn len(&self) -> usize {
        self.keys.len()
    }

    /// Slots of a chunk's entries.
    pub(crate) fn segment(&self, chunk: usize) -> std::ops::Range<usize> {
        self.segments[chunk] as usize..self.segments[chunk + 1] as usize
    }

    /// Slot of the entry at a place of the depth order.
    #[inline(always)]
    pub(crate) fn slot(&self, place: usize) -> usize {
        (self.keys[place] & 0xffff_ffff) as usize
    }
}

/// Stable radix sort by the high words, which lie in `low..=high`.
fn sort(keys: &mut Vec<u64>, spare: &mut Vec<u64>, low: u32, high: u32) {
    if keys.len() < 2 || low == high {
        return;
    }
    if keys.len() < 96 {
        // Low words are distinct and ascending, so that an unstable sort of whole keys is the stable sort by depth.
        keys.sort_unstable();
        return;
    }
    let significant = 32 - (high - low).leading_zeros();
    let passes = significant.div_ceil(9).max(1);
    let digit = significant.div_ceil(passes);
    let mask = (1_u32 << digit) - 1;
    spare.clear();
    spare.resize(keys.len(), 0);
    let bucket = |key: u64, shift: u32| ((((key >> 32) as u32 - low) >> shift) & mask) as usize;
    // All histograms in one pass over the keys.
    let mut next = [[0_u32; 512]; 4];
    for &key in keys.iter() {
        for pass in 0..passes {
            next[pass as usize][bucket(key, pass * digit)] += 1;
        }
    }
    for pass in 0..passes {
        let next = &mut next[pass as usize];
        let mut sum = 0;
        for count in &mut next[..=mask as usize] {
            let here = *count;
            *count = sum;
            sum += here;
        }
        for &key in keys.iter() {
            let slot = &mut next[bucket(key, pass * digit)];
            spare[*slot as usize] = key;
            *slot += 1;
        }
        std::mem::swap(keys, spare);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radix_sort_is_the_stable_sort() {
        let mut state = 7_u64;
        for (count, spread) in [
            (0, 1),
            (1, 1),
            (50, 9),
            (500, 1),
            (500, 3),
            (5000, 40_000_000),
            (3000, u32::MAX),
        ] {
            let mut keys: Vec<u64> = (0..count)
                .map(|slot| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (((state >> 33) % u64::from(spread)) << 32) | slot
                })
                .collect();
            let mut expected = keys.clone();
            expected.sort();
            let low = keys.iter().map(|k| (k >> 32) as u32).min().unwrap_or(0);
            let high = keys.iter().map(|k| (k >> 32) as u32).max().unwrap_or(0);
            sort(&mut keys, &mut Vec::new(), low, high);
            assert_eq!(keys, expected, "{count} keys over {spread}");
        }
    }
}
