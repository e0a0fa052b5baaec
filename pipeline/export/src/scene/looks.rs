//! What Gaussians look like over the times of a scene: what most of the time, and when else what.

use rayon::prelude::*;
use rogs_schemas::units::LengthUnit;
use rogs_splat::Gaussians;

use super::quantised::{ATTRIBUTES, Attributes, attributes};

/// Gaussians that are looked at together.
const CHUNK: usize = 4096;

/// What a Gaussian looks like where nothing else is said, and whether that is known yet.
type Plain = (Attributes, bool);
/// The attributes that a Gaussian has most of the time, and the voices for them.
type Usual = (Attributes, u16);

/// The attributes of all Gaussians at all times so far.
pub(super) struct Looks {
    /// `[N]`
    plain: Vec<Plain>,
    /// The value that outlives a vote in which every other one takes a voice away (Boyer and Moore), which is the one of
    /// more than half of the times where there is such. `[N]`
    usual: Vec<Usual>,
    /// By time, those that look different from `plain`, in ascending order.
    own: Vec<Vec<(u32, Attributes)>>,
}

impl Looks {
    pub(super) fn new(count: usize) -> Self {
        Self {
            plain: vec![([0; ATTRIBUTES], false); count],
            usual: vec![([0; ATTRIBUTES], 0); count],
            own: Vec::new(),
        }
    }

    /// Looks at the Gaussians of the next time; `open` as in [`super::Moment`].
    pub(super) fn see(&mut self, gaussians: &Gaussians, open: Option<&[u8]>, unit: LengthUnit) {
        let is_first = self.own.is_empty();
        let chunks = self.plain.par_chunks_mut(CHUNK).zip(self.usual.par_chunks_mut(CHUNK));
        let of_chunk = |(chunk, (plain, usual)): (usize, (&mut [Plain], &mut [Usual]))| {
            let mut others = Vec::new();
            for (local, ((plain, is_known), (usual, voices))) in plain.iter_mut().zip(usual).enumerate() {
                let index = CHUNK * chunk + local;
                let is_plain = open.is_none_or(|open| open[index] == 0)
                    && gaussians.means[3 * index..][..3].iter().all(|part| part.is_finite());
                let own = if is_plain && *is_known && open.is_some() {
                    *plain
                } else {
                    attributes(gaussians, unit, index)
                };
                if is_plain && !*is_known {
                    (*plain, *is_known) = (own, true);
                }
                if !*is_known || own != *plain {
                    others.push((index as u32, own));
                }
                if is_first || (*voices == 0 && own != *usual) {
                    (*usual, *voices) = (own, 1);
                } else if own == *usual {
                    *voices += 1;
                } else {
                    *voices -= 1;
                }
            }
            others
        };
        let others: Vec<Vec<(u32, Attributes)>> = chunks.enumerate().map(of_chunk).collect();
        self.own.push(others.concat());
    }

    /// The attributes that each Gaussian has most of the time. `[N, ATTRIBUTES]`
    pub(super) fn usual(&self) -> Vec<i32> {
        let usual = self.usual.iter().flat_map(|(usual, _)| usual);
        usual.map(|&value| i32::from(value)).collect()
    }

    /// By time, the Gaussians that do not look as usual, in ascending order, and what they look like:
    /// `[M]`, `[M, ATTRIBUTES]`.
    pub(super) fn changes(&self) -> Vec<(Vec<i32>, Vec<i32>)> {
        // Those that do not look as usual where nothing else is said.
        let odd: Vec<u32> = (0..)
            .zip(self.plain.iter().zip(&self.usual))
            .filter(|(_, ((plain, is_known), (usual, _)))| *is_known && plain != usual)
            .map(|(index, _)| index)
            .collect();
        let of_time = |own: &Vec<(u32, Attributes)>| {
            let (mut rows, mut changed) = (Vec::new(), Vec::new());
            let mut add = |index: u32, attributes: &Attributes| {
                rows.push(index as i32);
                changed.extend(attributes.iter().map(|&value| i32::from(value)));
            };
            let mut odd = odd.iter().peekable();
            for (index, attributes) in own {
                while let Some(before) = odd.next_if(|odd| *odd < index) {
                    add(*before, &self.plain[*before as usize].0);
                }
                odd.next_if_eq(&index);
                if *attributes != self.usual[*index as usize].0 {
                    add(*index, attributes);
                }
            }
            odd.for_each(|index| add(*index, &self.plain[*index as usize].0));
            (rows, changed)
        };
        self.own.par_iter().map(of_time).collect()
    }
}
