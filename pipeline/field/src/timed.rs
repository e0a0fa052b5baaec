//! From a stored field to Gaussians at a stored time.
//!
//! Activations are those of `docs/spec/stage1.md` section 7, corrections those of `docs/spec/stage2.md` section B.2. Files
//! hold metres; the Gaussians come out in internal units, 3.5 per metre. The displacement of a Gaussian between two
//! times is read from the stored displacement streams alone, so no correction can change it.

use rayon::prelude::*;
use rogs_geometry::{Base, Pose, Recon};
use rogs_schemas::records::field::{Field, RAW_CHANNELS, TimeSlice};
use rogs_schemas::records::refinement::{RESIDUAL_CHANNELS, Refinement, RefinementStep, ScaleResidual};
use rogs_schemas::units::iu_from_m;
use rogs_schemas::{CameraIndex, ClipId};
use rogs_splat::{Colour, Gaussians, sh};

use crate::attributes::{MIN_LINEAR_SCALE_IU, colour, opacity_logit, scale_below_iu, sigmoid};
use crate::error::{Error, Result};
use crate::gates;

const CHUNK: usize = 8192;

/// A field, optionally with the corrections of Stage 2, ready to be asked for its stored times.
#[derive(Debug, Clone, Copy)]
pub struct TimedField<'a> {
    field: &'a Field,
    correction: Option<(&'a RefinementStep, ScaleResidual)>,
}

impl<'a> TimedField<'a> {
    /// The field of Stage 1.
    ///
    /// # Errors
    /// When the arrays of the record contradict each other.
    pub fn new(field: &'a Field) -> Result<Self> {
        let timed = Self {
            field,
            correction: None,
        };
        let n = field.len();
        let expect = |what: String, found: usize, expected: usize| {
            if found == expected {
                Ok(())
            } else {
                Err(timed.error(format!("{what} has {found} values, expected {expected}")))
            }
        };
        expect("position_m".into(), field.position_m.len(), 3 * n)?;
        expect("base_raw".into(), field.base_raw.len(), RAW_CHANNELS * n)?;
        expect("scale_cap_iu".into(), field.scale_cap_iu.len(), n)?;
        for slice in &field.slices {
            let at = |what: &str| format!("{what} at time {}", slice.time);
            expect(at("displacement_m"), slice.displacement_m.len(), 3 * n)?;
            expect(at("gate"), slice.gate.len(), n)?;
            let moving = slice.gate.iter().filter(|&&g| g != 0).count();
            expect(at("moving_raw"), slice.moving_raw.len(), RAW_CHANNELS * moving)?;
        }
        Ok(timed)
    }

    /// The same field with the corrections of one step of Stage 2.
    ///
    /// # Errors
    /// When the step belongs to another number of Gaussians.
    pub fn with_correction(self, step: &'a RefinementStep, scale: ScaleResidual) -> Result<Self> {
        let n = self.field.len();
        let touched = step.touched.iter().filter(|&&t| t != 0).count();
        if step.touched.len() != n || step.values.len() != RESIDUAL_CHANNELS * touched {
            return Err(self.error(format!(
                "the correction after {} updates has {} marks and {} values, expected {n} marks and {} values",
                step.update,
                step.touched.len(),
                step.values.len(),
                RESIDUAL_CHANNELS * touched
            )));
        }
        Ok(Self {
            correction: (touched > 0).then_some((step, scale)),
            ..self
        })
    }

    /// The same field with the last corrections of a refinement; unchanged when it has none.
    ///
    /// # Errors
    /// When the refinement belongs to another field.
    pub fn with_refinement(self, refinement: &'a Refinement) -> Result<Self> {
        if refinement.clip_id != self.field.clip_id || refinement.gaussian_count != self.field.len() as u64 {
            return Err(self.error(format!(
                "the refinement is one of clip `{}` with {} Gaussians, the field has {}",
                refinement.clip_id,
                refinement.gaussian_count,
                self.field.len()
            )));
        }
        match refinement.steps.last() {
            Some(step) => self.with_correction(step, refinement.scale_residual),
            None => Ok(self),
        }
    }

    fn error(&self, what: String) -> Error {
        Error::Field {
            clip: self.field.clip_id.to_string(),
            what,
        }
    }

    /// Base-to-reconstruction of the clip, metres.
    ///
    /// # Errors
    /// When the stored matrix is not rigid.
    pub(crate) fn recon_from_base(&self) -> Result<Pose<Recon, Base>> {
        Pose::from_rigid(&self.field.recon_from_base).map_err(|error| self.error(error.to_string()))
    }

    fn slice(&self, time: f64) -> Result<&'a TimeSlice> {
        self.field.slice_at(time).ok_or_else(|| {
            let times: Vec<String> = self.field.slices.iter().map(|s| s.time.to_string()).collect();
            self.error(format!(
                "no values are stored at time {time}; stored times: {}",
                times.join(", ")
            ))
        })
    }

    /// The camera whose pixel Gaussian `n` is; `n` below [`Field::len`].
    #[must_use]
    pub fn source_camera(&self, n: usize) -> CameraIndex {
        let area = self.field.height as usize * self.field.width as usize;
        self.field.views[n / area].camera
    }

    /// The Gaussians at a stored time, internal units, reconstruction frame. Row `n` is Gaussian `n` of the field.
    ///
    /// # Errors
    /// When the time is not stored.
    pub fn gaussians(&self, time: f64) -> Result<Gaussians> {
        let mut turned = Turned::default();
        self.turn(time, &mut turned)?;
        Ok(turned.gaussians)
    }

    /// Turns the Gaussians of one time to another one, as [`TimedField::gaussians`] gives them. Attributes are activated anew
    /// only where a gate is open, or was: with a closed one they are the same at all times.
    ///
    /// # Errors
    /// When the time is not stored.
    pub fn turn(&self, time: f64, turned: &mut Turned) -> Result<()> {
        let slice = self.slice(time)?;
        let field = self.field;
        let touched = self
            .correction
            .map(|(step, _)| starts(&step.touched, RESIDUAL_CHANNELS));
        let is_new = turned.begin(self);
        let moving = starts(&slice.gate, RAW_CHANNELS);
        let colours = turned.gaussians.colour.values_per_gaussian();
        let Turned { gaussians, open, .. } = turned;
        let colour = match &mut gaussians.colour {
            Colour::Rgb(values) => values,
            Colour::Sh { coefficients, .. } => coefficients,
        };
        (gaussians.means.par_chunks_mut(3 * CHUNK))
            .zip(gaussians.quats.par_chunks_mut(4 * CHUNK))
            .zip(gaussians.scales.par_chunks_mut(3 * CHUNK))
            .zip(gaussians.opacities.par_chunks_mut(CHUNK))
            .zip(colour.par_chunks_mut(colours * CHUNK))
            .zip(open.par_chunks_mut(CHUNK))
            .enumerate()
            .for_each(|(chunk, (((((means, quats), scales), opacities), colour), open))| {
                let first = chunk * CHUNK;
                let mut moving = slice.moving_raw[moving[chunk]..].chunks_exact(RAW_CHANNELS);
                let mut residuals = self.correction.zip(touched.as_ref()).map(|((step, scale), starts)| {
                    (
                        step,
                        scale,
                        step.values[starts[chunk]..].chunks_exact(RESIDUAL_CHANNELS),
                    )
                });
                for local in 0..opacities.len() {
                    let index = first + local;
                    let residual = residuals.as_mut().and_then(|(step, scale, values)| {
                        if step.touched[index] == 0 {
                            None
                        } else {
                            values.next().map(|v| (v, *scale))
                        }
                    });
                    for k in 0..3 {
                        let delta = residual.map_or(0.0, |(v, _)| v[k]);
                        let centre = (field.position_m[3 * index + k] + delta) + slice.displacement_m[3 * index + k];
                        means[3 * local + k] = iu_from_m(centre);
                    }
                    let gate = slice.gate[index];
                    let was_open = std::mem::replace(&mut open[local], gate) != 0;
                    if !(is_new || was_open || gate != 0) {
                        continue;
                    }
                    let mut raw = [0.0; RAW_CHANNELS];
                    raw.copy_from_slice(&field.base_raw[RAW_CHANNELS * index..][..RAW_CHANNELS]);
                    gates::choose_next(gate, &mut moving, &mut raw);
                    let one = activate(&raw, field.scale_cap_iu[index], residual);
                    quats[4 * local..4 * local + 4].copy_from_slice(&one.quat);
                    scales[3 * local..3 * local + 3].copy_from_slice(&one.scale);
                    opacities[local] = one.opacity;
                    let to = &mut colour[colours * local..colours * (local + 1)];
                    if self.correction.is_some() {
                        harmonics(one.rgb, residual.map(|(v, _)| v), to);
                    } else {
                        to.copy_from_slice(&one.rgb);
                    }
                }
            });
        Ok(())
    }

    /// Displacement of every Gaussian from one stored time to another, `d(to) - d(from)`, metres, reconstruction frame.
    /// It reads the stored displacements and nothing else: the same bits with and without corrections. `[N, 3]`
    ///
    /// # Errors
    /// When a time is not stored.
    pub fn displacement_m(&self, from: f64, to: f64) -> Result<Vec<f32>> {
        let (from, to) = (self.slice(from)?, self.slice(to)?);
        Ok(to
            .displacement_m
            .iter()
            .zip(&from.displacement_m)
            .map(|(to, from)| to - from)
            .collect())
    }

    /// The Gaussians at `time` with their displacement `from -> to` in metres as three extra channels, for rendered
    /// displacement images (`docs/spec/scoring.md` section 6).
    ///
    /// # Errors
    /// When a time is not stored.
    pub fn gaussians_with_displacement(&self, time: f64, from: f64, to: f64) -> Result<Gaussians> {
        let extra = self.displacement_m(from, to)?;
        Ok(Gaussians {
            extra,
            extra_channels: 3,
            ..self.gaussians(time)?
        })
    }
}

/// The Gaussians of a field at one of its times, ready to be turned to others ([`TimedField::turn`]).
#[derive(Debug, Clone)]
pub struct Turned {
    /// What they are of: clip, number, and number of updates where there are corrections.
    of: Option<(ClipId, usize, Option<u32>)>,
    gaussians: Gaussians,
    /// Gates at their time. `[N]`
    open: Vec<u8>,
}

impl Default for Turned {
    fn default() -> Self {
        Self {
            of: None,
            gaussians: Gaussians::empty(),
            open: Vec::new(),
        }
    }
}

impl Turned {
    /// The Gaussians, internal units, reconstruction frame.
    #[must_use]
    pub fn gaussians(&self) -> &Gaussians {
        &self.gaussians
    }

    /// Of every Gaussian, not 0 where its attributes are those of this time; the others have the same at all times.
    #[must_use]
    pub fn open(&self) -> &[u8] {
        &self.open
    }

    /// Makes room for the Gaussians of a field, unless they are there already; whether they were not.
    fn begin(&mut self, field: &TimedField<'_>) -> bool {
        let n = field.field.len();
        let update = field.correction.map(|(step, _)| step.update);
        let of = Some((field.field.clip_id.clone(), n, update));
        if self.of == of {
            return false;
        }
        let degree = field.correction.map(|(step, _)| highest_degree(step));
        self.gaussians = Gaussians {
            means: vec![0.0; 3 * n],
            quats: vec![0.0; 4 * n],
            scales: vec![0.0; 3 * n],
            opacities: vec![0.0; n],
            colour: match degree {
                Some(degree) => Colour::Sh {
                    degree,
                    coefficients: vec![0.0; 3 * sh::coefficient_count(degree) * n],
                },
                None => Colour::Rgb(vec![0.0; 3 * n]),
            },
            extra: Vec::new(),
            extra_channels: 0,
        };
        self.open = vec![0; n];
        self.of = of;
        true
    }
}

/// Where the values of every chunk begin in an array that holds values of marked elements only.
fn starts(marks: &[u8], channels: usize) -> Vec<usize> {
    let mut total = 0;
    marks
        .chunks(CHUNK)
        .map(|chunk| {
            let start = total;
            total += channels * chunk.iter().filter(|&&m| m != 0).count();
            start
        })
        .collect()
}

/// Activated attributes of one Gaussian.
struct Activated {
    rgb: [f32; 3],
    scale: [f32; 3],
    quat: [f32; 4],
    opacity: f32,
}

/// Stage-1 activations of raw attributes (colour 3, scale 3, rotation 4, opacity 1), with the residuals added where the
/// parameterisation says. The residual's position and harmonics are not used here.
fn activate(raw: &[f32; RAW_CHANNELS], cap: f32, residual: Option<(&[f32], ScaleResidual)>) -> Activated {
    let add = |channel: usize| residual.map_or(0.0, |(v, _)| v[channel]);
    let scale = std::array::from_fn(|k| {
        let own = raw[3 + k];
        let scale = match residual {
            Some((v, ScaleResidual::PreActivation)) => scale_below_iu(own + v[3 + k], cap),
            Some((v, ScaleResidual::Linear)) => (scale_below_iu(own, cap) + v[3 + k]).max(MIN_LINEAR_SCALE_IU),
            None => scale_below_iu(own, cap),
        };
        scale.min(cap)
    });
    Activated {
        rgb: std::array::from_fn(|k| colour(raw[k])),
        scale,
        quat: std::array::from_fn(|k| raw[6 + k] + add(6 + k)),
        opacity: sigmoid(opacity_logit(raw[10]) + add(10)),
    }
}

/// Harmonics of a plain colour plus the residuals, which are colour-major (16 of red, 16 of green, 16 of blue).
fn harmonics(rgb: [f32; 3], residual: Option<&[f32]>, to: &mut [f32]) {
    to.fill(0.0);
    for c in 0..3 {
        to[c] = sh::coefficient_from_colour(rgb[c]);
        if let Some(values) = residual {
            for (k, coefficient) in to.chunks_exact_mut(3).enumerate() {
                coefficient[c] += values[11 + 16 * c + k];
            }
        }
    }
}

/// Highest degree in which any residual of a step is not zero.
fn highest_degree(step: &RefinementStep) -> usize {
    let highest = |values: &[f32]| {
        let used = (0..16)
            .rev()
            .find(|k| (0..3).any(|c| values[11 + 16 * c + k] != 0.0))
            .unwrap_or(0);
        [0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3][used]
    };
    step.values
        .par_chunks_exact(RESIDUAL_CHANNELS)
        .map(highest)
        .max()
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use rogs_schemas::RigidPose;
    use rogs_schemas::records::clip::SourceView;
    use rogs_schemas::records::field::WeightsInfo;
    use rogs_schemas::{CameraIndex, FrameIndex};

    use super::*;

    fn field() -> Field {
        let n = 6;
        let raw = |k: usize| ((k * 7919 % 97) as f32 / 97.0 - 0.5) * 4.0;
        let slice = |time: f64, gate: Vec<u8>, shift: f32| {
            let moving = gate.iter().filter(|&&g| g != 0).count();
            TimeSlice {
                time,
                displacement_m: (0..3 * n).map(|k| raw(k + 5) * shift).collect(),
                gate,
                moving_raw: (0..RAW_CHANNELS * moving).map(|k| raw(k + 11)).collect(),
            }
        };
        Field {
            clip_id: "clip".parse().unwrap(),
            frame_count: 17,
            height: 1,
            width: 6,
            views: vec![SourceView {
                camera: CameraIndex(0),
                frame: FrameIndex(0),
            }],
            recon_from_base: RigidPose::IDENTITY,
            weights: WeightsInfo {
                trained: false,
                configuration: String::new(),
                description: String::new(),
                hash: String::new(),
            },
            position_m: (0..3 * n).map(|k| raw(k + 3)).collect(),
            base_raw: (0..RAW_CHANNELS * n).map(raw).collect(),
            support: vec![0; n],
            link: vec![255; n],
            scale_cap_iu: vec![f32::INFINITY, 1e-4, f32::INFINITY, 1.0, 1.0, 1.0],
            slices: vec![slice(0.0, vec![0; n], 0.0), slice(0.5, vec![0, 3, 1, 0, 2, 0], 0.3)],
            query_state: Vec::new(),
        }
    }

    fn step(value: impl Fn(usize) -> f32) -> RefinementStep {
        RefinementStep {
            update: 1,
            touched: vec![1, 0, 1, 0, 0, 1],
            values: (0..3 * RESIDUAL_CHANNELS).map(value).collect(),
        }
    }

    #[test]
    fn activations_and_gates_follow_the_specification() {
        let field = field();
        let gaussians = TimedField::new(&field).unwrap().gaussians(0.5).unwrap();
        let raw = gates::raw_at(&field, &field.slices[1]);
        for n in 0..6 {
            let raw: Vec<f64> = raw[RAW_CHANNELS * n..][..RAW_CHANNELS]
                .iter()
                .map(|&v| f64::from(v))
                .collect();
            for k in 0..3 {
                let cap = f64::from(field.scale_cap_iu[n]);
                let cap = if cap.is_finite() { cap } else { 0.3 };
                let scale = (0.001 * libm::log1p(libm::exp(raw[3 + k]))).min(cap);
                assert!((f64::from(gaussians.scales[3 * n + k]) - scale).abs() < 1e-9);
                let rgb = 0.5 + 0.5 * libm::tanh(raw[k]);
                assert!((f64::from(gaussians.colour.values()[3 * n + k]) - rgb).abs() < 1e-6);
                let metres = field.position_m[3 * n + k] + field.slices[1].displacement_m[3 * n + k];
                assert_eq!(gaussians.means[3 * n + k], metres * 3.5);
            }
            let opacity = 0.5 + 0.5 * libm::tanh(raw[10] - 1.0);
            assert!((f64::from(gaussians.opacities[n]) - opacity).abs() < 1e-6);
            for k in 0..4 {
                assert_eq!(f64::from(gaussians.quats[4 * n + k]), raw[6 + k]);
            }
        }
    }

    #[test]
    fn turned_from_another_time_gaussians_have_the_same_bits() {
        let field = field();
        let step = step(|k| ((k % RESIDUAL_CHANNELS) as f32 + 1.0) * 1e-3);
        let plain = TimedField::new(&field).unwrap();
        let corrected = plain.with_correction(&step, ScaleResidual::PreActivation).unwrap();
        let mut turned = Turned::default();
        for timed in [plain, corrected, plain] {
            for time in [0.0, 0.5, 0.0, 0.5] {
                timed.turn(time, &mut turned).unwrap();
                assert_eq!(*turned.gaussians(), timed.gaussians(time).unwrap());
                assert_eq!(turned.open(), field.slice_at(time).unwrap().gate);
            }
        }
        assert!(plain.turn(0.3, &mut turned).is_err());
    }

    #[test]
    fn corrections_act_on_touched_gaussians_in_the_right_parameterisation() {
        let field = field();
        let plain = TimedField::new(&field).unwrap();
        let step = step(|k| ((k % RESIDUAL_CHANNELS) as f32 + 1.0) * 1e-3);
        let base = plain.gaussians(0.5).unwrap();
        let corrected = plain
            .with_correction(&step, ScaleResidual::PreActivation)
            .unwrap()
            .gaussians(0.5)
            .unwrap();
        let Colour::Sh {
            degree: 3,
            coefficients,
        } = &corrected.colour
        else {
            panic!("degree 3 expected")
        };
        let raw = gates::raw_at(&field, &field.slices[1]);
        for n in 0..6 {
            let on = if [0, 2, 5].contains(&n) { 1.0 } else { 0.0_f32 };
            let metres = (field.position_m[3 * n] + on * 1e-3) + field.slices[1].displacement_m[3 * n];
            assert!((corrected.means[3 * n] - metres * 3.5).abs() < 1e-6);
            let scale = scale_below_iu(raw[RAW_CHANNELS * n + 4] + on * 5e-3, field.scale_cap_iu[n]);
            assert!((corrected.scales[3 * n + 1] - scale).abs() < 1e-8);
            assert!((corrected.quats[4 * n + 3] - (raw[RAW_CHANNELS * n + 9] + on * 10e-3)).abs() < 1e-6);
            assert_eq!(
                corrected.opacities[n],
                sigmoid(opacity_logit(raw[RAW_CHANNELS * n + 10]) + on * 11e-3)
            );
            let first = sh::coefficient_from_colour(base.colour.values()[3 * n + 2]);
            assert!(
                (coefficients[48 * n + 2] - (first + on * 44e-3)).abs() < 1e-6,
                "blue, order 0"
            );
            assert!(
                (coefficients[48 * n + 3 * 5 + 1] - on * 33e-3).abs() < 1e-6,
                "green, order 5"
            );
        }
        let linear = plain
            .with_correction(&step, ScaleResidual::Linear)
            .unwrap()
            .gaussians(0.5)
            .unwrap();
        assert!((linear.scales[1] - (base.scales[1] + 5e-3)).abs() < 1e-8);
    }

    #[test]
    fn displacement_has_the_same_bits_before_and_after_correction() {
        let field = field();
        let plain = TimedField::new(&field).unwrap();
        let step = step(|k| (k as f32).sin());
        let corrected = plain.with_correction(&step, ScaleResidual::PreActivation).unwrap();
        let bits = |f: &TimedField<'_>| {
            f.displacement_m(0.0, 0.5)
                .unwrap()
                .iter()
                .map(|v| v.to_bits())
                .collect::<Vec<_>>()
        };
        assert_eq!(bits(&plain), bits(&corrected));
        let with = corrected.gaussians_with_displacement(0.5, 0.0, 0.5).unwrap();
        assert_eq!(with.extra, plain.displacement_m(0.0, 0.5).unwrap());
    }

    #[test]
    fn no_touched_gaussian_means_exactly_stage_one() {
        let field = field();
        let plain = TimedField::new(&field).unwrap();
        let nothing = RefinementStep {
            update: 0,
            touched: vec![0; 6],
            values: Vec::new(),
        };
        let same = plain.with_correction(&nothing, ScaleResidual::PreActivation).unwrap();
        assert_eq!(plain.gaussians(0.5).unwrap(), same.gaussians(0.5).unwrap());
    }

    #[test]
    fn wrong_records_are_errors_that_say_what_is_wrong() {
        let mut field = field();
        assert!(
            TimedField::new(&field)
                .unwrap()
                .gaussians(0.25)
                .unwrap_err()
                .to_string()
                .contains("0, 0.5")
        );
        let short = RefinementStep {
            update: 2,
            touched: vec![1; 6],
            values: vec![0.0; 5],
        };
        assert!(
            TimedField::new(&field)
                .unwrap()
                .with_correction(&short, ScaleResidual::Linear)
                .is_err()
        );
        field.slices[1].moving_raw.pop();
        assert!(
            TimedField::new(&field)
                .unwrap_err()
                .to_string()
                .contains("moving_raw at time 0.5")
        );
    }
}
