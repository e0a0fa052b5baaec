//! The parameters of one camera's scene, their updates, and what the rasteriser sees of them
//! (`docs/spec/baseline-som.md` sections 5, 7 and 8).

use rogs_optimise::{Adam, MotionBases};
use rogs_schemas::records::field::NamedArray;
use rogs_schemas::records::motion_bases::BasisGaussians;
use rogs_schemas::records::progress::Progress;
use rogs_worker::{StageError, StageResult};

use crate::internal;

/// Gaussians by their raw parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Cloud {
    /// Centres, base frame, metres. `[N, 3]`
    pub(crate) means: Vec<f32>,
    /// Rotations (w, x, y, z), any length. `[N, 4]`
    pub(crate) quats: Vec<f32>,
    /// Logarithms of standard deviations. `[N, 3]`
    pub(crate) scales: Vec<f32>,
    /// Logits of opacities. `[N]`
    pub(crate) opacities: Vec<f32>,
    /// Logits of colours. `[N, 3]`
    pub(crate) colours: Vec<f32>,
}

impl Cloud {
    pub(crate) fn len(&self) -> usize {
        self.opacities.len()
    }

    pub(crate) fn zeros(count: usize) -> Self {
        Self {
            means: vec![0.0; 3 * count],
            quats: vec![0.0; 4 * count],
            scales: vec![0.0; 3 * count],
            opacities: vec![0.0; count],
            colours: vec![0.0; 3 * count],
        }
    }
}

/// Arrays of the parameters.
pub(crate) const ARRAYS: usize = 13;
/// Their names, in the order of [`Scene::arrays`].
const NAMES: [&str; ARRAYS] = [
    "fg.means",
    "fg.quats",
    "fg.scales",
    "fg.opacities",
    "fg.colours",
    "fg.coefficients",
    "bg.means",
    "bg.quats",
    "bg.scales",
    "bg.opacities",
    "bg.colours",
    "bases.rotations",
    "bases.translations",
];
/// Learning rates, in the same order.
pub(crate) const RATES: [f64; ARRAYS] = [
    1.6e-4, 1e-3, 5e-3, 1e-2, 1e-2, 1e-2, 1.6e-4, 1e-3, 5e-3, 5e-2, 1e-2, 1.6e-4, 1.6e-4,
];
/// Arrays whose rates fall: to a tenth over [`FALL_UPDATES`].
const FALLING: [usize; 2] = [2, 8];
const FALL_UPDATES: f64 = 5000.0;
/// Arrays of the foreground; those of the background follow.
const FOREGROUND: usize = 6;
/// The first array of the bases.
const BASES: usize = 11;

/// All parameters of a scene; or their gradients.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Scene {
    /// What moves, in its canonical state.
    pub(crate) foreground: Cloud,
    /// Logits of its mixture of the bases. `[G, K]`
    pub(crate) coefficients: Vec<f32>,
    /// What stands still.
    pub(crate) background: Cloud,
    /// Rigid motions, `rotations [K, T, 6]` and `translations [K, T, 3]`.
    pub(crate) bases: MotionBases,
}

impl Scene {
    /// Zeros of the same sizes.
    pub(crate) fn zeros(&self) -> Self {
        Self {
            foreground: Cloud::zeros(self.foreground.len()),
            coefficients: vec![0.0; self.coefficients.len()],
            background: Cloud::zeros(self.background.len()),
            bases: MotionBases {
                frames: self.bases.frames,
                rotations: vec![0.0; self.bases.rotations.len()],
                translations: vec![0.0; self.bases.translations.len()],
            },
        }
    }

    /// Gaussians in all.
    pub(crate) fn len(&self) -> usize {
        self.foreground.len() + self.background.len()
    }

    pub(crate) fn arrays(&self) -> [&Vec<f32>; ARRAYS] {
        let (fg, bg) = (&self.foreground, &self.background);
        [
            &fg.means,
            &fg.quats,
            &fg.scales,
            &fg.opacities,
            &fg.colours,
            &self.coefficients,
            &bg.means,
            &bg.quats,
            &bg.scales,
            &bg.opacities,
            &bg.colours,
            &self.bases.rotations,
            &self.bases.translations,
        ]
    }

    pub(crate) fn arrays_mut(&mut self) -> [&mut Vec<f32>; ARRAYS] {
        let (fg, bg) = (&mut self.foreground, &mut self.background);
        [
            &mut fg.means,
            &mut fg.quats,
            &mut fg.scales,
            &mut fg.opacities,
            &mut fg.colours,
            &mut self.coefficients,
            &mut bg.means,
            &mut bg.quats,
            &mut bg.scales,
            &mut bg.opacities,
            &mut bg.colours,
            &mut self.bases.rotations,
            &mut self.bases.translations,
        ]
    }

    /// Numbers of one Gaussian in each array; 0 for the bases.
    fn widths(&self) -> [usize; ARRAYS] {
        [3, 4, 3, 1, 3, self.bases.len(), 3, 4, 3, 1, 3, 0, 0]
    }

    /// The scene as a field has it.
    pub(crate) fn into_gaussians(self) -> BasisGaussians {
        let both = |mut first: Vec<f32>, second: Vec<f32>| {
            first.extend(second);
            first
        };
        let (fg, bg) = (self.foreground, self.background);
        BasisGaussians {
            bases: self.bases.len(),
            frames: self.bases.frames,
            rotations: self.bases.rotations,
            translations: self.bases.translations,
            coefficients: self.coefficients,
            means: both(fg.means, bg.means),
            quats: both(fg.quats, bg.quats),
            scales: both(fg.scales, bg.scales),
            opacities: both(fg.opacities, bg.opacities),
            colours: both(fg.colours, bg.colours),
        }
    }
}

/// A scene on its way: parameters, moments, and the gradients in the image since the last time that Gaussians were split.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct State {
    pub(crate) scene: Scene,
    pub(crate) moments: [Adam; ARRAYS],
    /// Lengths of the gradients with respect to centres in the image, added up; foreground, then background. `[N]`
    pub(crate) screen: Vec<f32>,
    /// Views in which a Gaussian was seen. `[N]`
    pub(crate) seen: Vec<f32>,
    /// Updates done.
    pub(crate) updates: u32,
}

/// A gradient in the image above this asks for more Gaussians.
const GROW: f32 = 2e-4;
/// Above this size a Gaussian is split, below it is doubled, metres.
const SPLIT_M: f32 = 0.01;
/// What a split takes off the logarithm of a scale: ln 1.6.
const SHRINK: f32 = 0.470_003_63;
/// Gaussians less opaque than this are taken away.
const OPAQUE: f32 = 0.1;
/// Gaussians are split and taken away after every so many updates, above the first and below the last.
const EVERY: u32 = 100;
const BETWEEN: [u32; 2] = [200, 4000];

impl State {
    /// Before the first update.
    pub(crate) fn new(scene: Scene) -> Self {
        let moments = scene.arrays().map(|array| Adam::new(array.len()));
        let count = scene.len();
        Self {
            scene,
            moments,
            screen: vec![0.0; count],
            seen: vec![0.0; count],
            updates: 0,
        }
    }

    /// Moves the parameters against a gradient.
    pub(crate) fn update(&mut self, gradient: &Scene) -> StageResult<()> {
        let fall = libm::pow(0.1, f64::from(self.updates) / FALL_UPDATES);
        let gradients = gradient.arrays();
        for (index, array) in self.scene.arrays_mut().into_iter().enumerate() {
            let fall = if FALLING.contains(&index) { fall } else { 1.0 };
            self.moments[index]
                .update(RATES[index] * fall, array, gradients[index])
                .map_err(internal)?;
        }
        self.updates += 1;
        Ok(())
    }

    /// Splits, doubles and takes away Gaussians where it is time to.
    ///
    /// # Errors
    /// When no Gaussian of the foreground is left.
    pub(crate) fn control(&mut self) -> StageResult<()> {
        let [above, below] = BETWEEN;
        if !(self.updates > above && self.updates < below && self.updates.is_multiple_of(EVERY)) {
            return Ok(());
        }
        let (fg, bg) = (self.scene.foreground.len(), self.scene.background.len());
        for (first, count, arrays) in [(0, fg, 0..FOREGROUND), (fg, bg, FOREGROUND..BASES)] {
            let rows = self.grown(first, count, &arrays);
            self.take(&rows, arrays);
        }
        let count = self.scene.len();
        (self.screen, self.seen) = (vec![0.0; count], vec![0.0; count]);
        if self.scene.foreground.len() == 0 {
            return Err(StageError::bad_input(format!(
                "no Gaussian of the foreground is left after {} updates",
                self.updates
            )));
        }
        Ok(())
    }

    /// The new rows of one cloud: those that are not split, copies of small ones, those that are split twice; without those
    /// that are nearly transparent.
    fn grown(&self, first: usize, count: usize, arrays: &std::ops::Range<usize>) -> Vec<Row> {
        let all = self.scene.arrays();
        let (scales, opacities) = (all[arrays.start + 2], all[arrays.start + 3]);
        let high = |row: usize| self.screen[first + row] / self.seen[first + row].max(1.0) > GROW;
        let large = |row: usize| {
            let largest = scales[3 * row..3 * row + 3]
                .iter()
                .copied()
                .fold(f32::NEG_INFINITY, f32::max);
            libm::expf(largest) > SPLIT_M
        };
        let row = |row: usize, kind: Kind| Row { row, kind };
        let kept = (0..count)
            .filter(|&at| !(high(at) && large(at)))
            .map(|at| row(at, Kind::Kept));
        let doubled = (0..count)
            .filter(|&at| high(at) && !large(at))
            .map(|at| row(at, Kind::Copy));
        let split = || {
            (0..count)
                .filter(|&at| high(at) && large(at))
                .map(|at| row(at, Kind::Half))
        };
        let rows = kept.chain(doubled).chain(split()).chain(split());
        rows.filter(|own| logistic(opacities[own.row]) >= OPAQUE).collect()
    }

    /// Puts rows in the place of all of some arrays. Rows that are new have no moments.
    fn take(&mut self, rows: &[Row], arrays: std::ops::Range<usize>) {
        let widths = self.scene.widths();
        let scales = arrays.start + 2;
        let all = self.scene.arrays_mut();
        for index in arrays {
            let width = widths[index];
            let old = std::mem::take(all[index]);
            let values = rows.iter().flat_map(|own| {
                let off = if index == scales && own.kind == Kind::Half {
                    SHRINK
                } else {
                    0.0
                };
                old[own.row * width..(own.row + 1) * width]
                    .iter()
                    .map(move |value| value - off)
            });
            *all[index] = values.collect();
            let moments = &mut self.moments[index];
            for moment in [&mut moments.first, &mut moments.second] {
                let old = std::mem::take(moment);
                let values = rows.iter().flat_map(|own| {
                    let keep = if own.kind == Kind::Kept { 1.0 } else { 0.0 };
                    old[own.row * width..(own.row + 1) * width]
                        .iter()
                        .map(move |value| value * keep)
                });
                *moment = values.collect();
            }
        }
    }

    /// Adds the arrays and counters of this state to a progress.
    pub(crate) fn store(&self, progress: &mut Progress) {
        let mut add = |name: String, data: &[f32]| {
            progress.arrays.push(NamedArray {
                name,
                shape: vec![data.len() as u32],
                data: data.to_vec(),
            });
        };
        for ((name, array), moments) in NAMES.iter().zip(self.scene.arrays()).zip(&self.moments) {
            add((*name).to_owned(), array);
            add(format!("{name}.first"), &moments.first);
            add(format!("{name}.second"), &moments.second);
        }
        add("screen".to_owned(), &self.screen);
        add("seen".to_owned(), &self.seen);
        let counters = [
            ("updates", u64::from(self.updates)),
            ("frames", self.scene.bases.frames as u64),
            ("moments", u64::from(self.moments[0].updates)),
        ];
        progress
            .counters
            .extend(counters.map(|(name, value)| (name.to_owned(), value)));
    }

    /// The state that [`store`](Self::store) put into a progress; `None` where it does not fit together.
    pub(crate) fn restore(progress: &Progress) -> Option<Self> {
        let array = |name: &str| progress.array(name).map(<[f32]>::to_vec);
        let counter = |name: &str| progress.counter(name);
        let mut scene = Scene::default();
        scene.bases.frames = usize::try_from(counter("frames")?).ok()?;
        let mut moments = Vec::with_capacity(ARRAYS);
        for (name, to) in NAMES.iter().zip(scene.arrays_mut()) {
            *to = array(name)?;
            moments.push(Adam {
                first: array(&format!("{name}.first"))?,
                second: array(&format!("{name}.second"))?,
                updates: u32::try_from(counter("moments")?).ok()?,
            });
        }
        let state = Self {
            moments: moments.try_into().ok()?,
            screen: array("screen")?,
            seen: array("seen")?,
            updates: u32::try_from(counter("updates")?).ok()?,
            scene,
        };
        let arrays = state.scene.arrays();
        let fits = arrays
            .iter()
            .zip(&state.moments)
            .all(|(array, moments)| moments.first.len() == array.len() && moments.second.len() == array.len());
        let count = state.scene.len();
        let whole = state.scene.clone().into_gaussians().check().is_ok()
            && state.screen.len() == count
            && state.seen.len() == count;
        (fits && whole).then_some(state)
    }
}

/// A row of the next arrays.
struct Row {
    /// Which of the arrays now.
    row: usize,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// As it was, moments too.
    Kept,
    /// A copy beside it.
    Copy,
    /// One of two smaller ones in its place.
    Half,
}

/// Adds an array times a weight.
pub(crate) fn add(to: &mut [f32], weight: f64, from: &[f32]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to += weight as f32 * from;
    }
}

/// The logistic function.
pub(crate) fn logistic(value: f32) -> f32 {
    1.0 / (1.0 + libm::expf(-value))
}

/// Its inverse; probabilities stay a little away from 0 and 1.
pub(crate) fn logit(share: f64) -> f32 {
    let share = share.clamp(1e-6, 1.0 - 1e-6);
    (libm::log(share / (1.0 - share))) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three foreground and two background Gaussians with one base.
    fn state() -> State {
        let cloud = |count: usize, start: f32| Cloud {
            means: (0..3 * count).map(|k| start + k as f32).collect(),
            quats: (0..4 * count).map(|k| k as f32).collect(),
            scales: vec![-3.0; 3 * count],
            opacities: vec![1.0; count],
            colours: vec![0.5; 3 * count],
        };
        let mut state = State::new(Scene {
            foreground: cloud(3, 0.0),
            coefficients: vec![0.1, 0.2, 0.3],
            background: cloud(2, 100.0),
            bases: MotionBases {
                frames: 2,
                rotations: vec![0.0; 12],
                translations: vec![0.0; 6],
            },
        });
        state.updates = 300;
        for (index, moments) in state.moments.iter_mut().enumerate() {
            moments.first.iter_mut().for_each(|value| *value = 1.0 + index as f32);
        }
        state
    }

    #[test]
    fn gaussians_are_split_doubled_and_taken_away() {
        let mut state = state();
        // Large with a high gradient: split. Small with one: doubled. The last is transparent.
        state.screen = vec![0.003, 0.003, 0.0, 0.0, 0.0];
        state.seen = vec![10.0, 10.0, 0.0, 3.0, 0.0];
        state.scene.foreground.scales[3..6].fill(-6.0);
        state.scene.background.opacities[1] = -3.0;
        state.control().unwrap();
        let fg = &state.scene.foreground;
        assert_eq!(
            fg.means.chunks(3).map(|mean| mean[0]).collect::<Vec<_>>(),
            [3.0, 6.0, 3.0, 0.0, 0.0]
        );
        assert_eq!(state.scene.coefficients, [0.2, 0.3, 0.2, 0.1, 0.1]);
        assert!((fg.scales[9] + 3.0 + 1.6f32.ln()).abs() < 1e-6);
        assert_eq!(state.scene.background.len(), 1);
        assert_eq!(state.moments[5].first, [6.0, 6.0, 0.0, 0.0, 0.0]);
        assert_eq!((state.screen.len(), state.seen.len()), (6, 6));
        assert!(state.screen.iter().all(|&value| value == 0.0));
        for (array, moments) in state.scene.arrays().iter().zip(&state.moments) {
            assert_eq!(array.len(), moments.first.len());
        }
        // Not at every update, and not before the first time.
        for updates in [100, 200, 301, 4000] {
            state.updates = updates;
            let before = state.clone();
            state.control().unwrap();
            assert_eq!(state, before);
        }
        state.updates = 400;
        state.scene.foreground.opacities.fill(-5.0);
        assert!(
            state
                .control()
                .unwrap_err()
                .message
                .contains("no Gaussian of the foreground")
        );
    }

    #[test]
    fn a_state_comes_back_from_its_progress() {
        let state = state();
        let mut progress = Progress {
            clip_id: "clip".parse().unwrap(),
            counters: Vec::new(),
            arrays: Vec::new(),
        };
        state.store(&mut progress);
        assert_eq!(State::restore(&progress), Some(state));
        progress.arrays[0].data.pop();
        assert_eq!(State::restore(&progress), None);
    }
}
