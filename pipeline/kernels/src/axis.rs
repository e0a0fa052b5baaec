//! Bilinear resampling along one axis, the centres of the first and the last pixel kept in place.

/// Where the outputs of an axis read.
#[derive(Debug)]
pub struct Axis {
    /// Inputs along the axis.
    pub inputs: usize,
    /// The first of two neighbours of each output, and the share of the second.
    pub taps: Vec<(usize, f32)>,
}

impl Axis {
    /// The axis of so many inputs and outputs.
    #[must_use]
    pub fn new(inputs: usize, outputs: usize) -> Self {
        let step = if outputs > 1 {
            (inputs - 1) as f32 / (outputs - 1) as f32
        } else {
            0.0
        };
        let tap = |output: usize| {
            let place = step * output as f32;
            let first = (place as usize).min(inputs - 1);
            (first, place - first as f32)
        };
        Self {
            inputs,
            taps: (0..outputs).map(tap).collect(),
        }
    }

    /// The second neighbour of a first one.
    #[inline(always)]
    #[must_use]
    pub fn second(&self, first: usize) -> usize {
        (first + 1).min(self.inputs - 1)
    }

    /// The same as a matrix: outputs are its product with the inputs. `[outputs, inputs]`
    #[must_use]
    pub fn matrix(&self) -> Vec<f32> {
        let mut matrix = vec![0.0; self.taps.len() * self.inputs];
        for (row, &(first, share)) in matrix.chunks_exact_mut(self.inputs).zip(&self.taps) {
            row[first] += 1.0 - share;
            row[self.second(first)] += share;
        }
        matrix
    }
}
