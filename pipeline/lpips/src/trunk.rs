//! The thirteen convolutions and four poolings of VGG16, with buffers that are used again.

use std::sync::{Mutex, PoisonError};

use crate::filtering::{Filtering, Scratch};
use crate::first::First;
use crate::maps::Maps;
use crate::readings::max_pool;
use crate::weights::ConvolutionWeights;
use crate::{BLOCKS, LAYERS};

/// The convolutions, ready for the CPU.
#[derive(Debug)]
pub(super) struct Trunk {
    first: Option<First>,
    others: Vec<Filtering>,
    maps: Mutex<Vec<[Maps; 2]>>,
    pub(super) scratch: Scratch,
}

impl Trunk {
    pub(super) fn new(convolutions: &[ConvolutionWeights]) -> Self {
        Self {
            first: convolutions.first().map(First::new),
            others: convolutions.iter().skip(1).map(Filtering::new).collect(),
            maps: Mutex::default(),
            scratch: Scratch::default(),
        }
    }

    /// Shows the maps of each of the five readings to `read`. `image [height, width, 3]`, normalised
    pub(super) fn run(&self, image: &[f32], height: usize, width: usize, mut read: impl FnMut(usize, &Maps)) {
        let lock = || self.maps.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = lock().pop();
        let [mut maps, mut next] = kept.unwrap_or_default();
        let mut others = self.others.iter();
        for block in 0..LAYERS {
            let mut count = BLOCKS[block];
            match &self.first {
                Some(first) if block == 0 => {
                    first.run(image, height, width, &mut maps, &self.scratch);
                    count -= 1;
                }
                _ => {
                    max_pool(&maps, &mut next);
                    std::mem::swap(&mut maps, &mut next);
                }
            }
            for convolution in others.by_ref().take(count) {
                convolution.run(&maps, &mut next, &self.scratch);
                std::mem::swap(&mut maps, &mut next);
            }
            read(block, &maps);
        }
        lock().push([maps, next]);
    }
}
