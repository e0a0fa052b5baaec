//! The updates of a fit (`docs/spec/fit.md` sections 4 and 5).

use rayon::prelude::*;
use rogs_arrays::png_bytes;
use rogs_optimise::losses::image::photometric;
use rogs_optimise::losses::robust::disparity_l1;
use rogs_optimise::{Adam, Watched};
use rogs_random::Pcg64;
use rogs_schemas::interim::Figures;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::{Field, NamedArray};
use rogs_schemas::records::progress::Progress as Kept;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::units::{UNITS_PER_METRE, m_from_iu};
use rogs_splat::{RasterCamera, RasterConfig, Render, RenderGradient, backward_views, render_views_with_tape};
use rogs_worker::{Observer, StageError, StageResult};

use crate::params::FitParams;
use crate::scene::{Parameters, Scene, internal};
use crate::source_time::{SourceTime, source_times};
use crate::start::Start;

/// Share of its rate that a group has left after the last update.
const LAST_RATE: f64 = 0.1;
/// Share of the depth errors that is kept; the largest are left out.
const DEPTH_KEPT: f64 = 0.98;
/// Seeds of cameras beside the source cameras begin here; those of orders of source times end before.
const BESIDE: u64 = 1 << 19;
/// Groups of parameters.
const GROUPS: usize = 7;
/// Their names, in the order of [`Parameters`].
const NAMES: [&str; GROUPS] = [
    "position_m",
    "scale",
    "rotation",
    "opacity",
    "colour",
    "mixture",
    "motion",
];
/// Updates after which the progress is kept.
const KEEP_EVERY: u32 = 25;

/// The records of one clip.
#[derive(Clone, Copy)]
pub struct ClipInputs<'a> {
    /// The clip.
    pub clip: &'a Clip,
    /// Its robot maps.
    pub robot: &'a RobotMaps,
    /// The field that the fit starts from.
    pub field: &'a Field,
    /// Corrections of Stage 2 to start from.
    pub refinement: Option<&'a Refinement>,
}

/// How far a fit has come: all that the next update depends on.
#[derive(Debug, Clone)]
struct Progress {
    /// Updates done.
    updates: u32,
    /// The parameters.
    parameters: Parameters,
    /// Moments of each group, in the order of [`Parameters`].
    moments: [Adam; GROUPS],
}

/// A fit of one clip.
pub struct Fitting<'a> {
    inputs: ClipInputs<'a>,
    params: &'a FitParams,
    start: Start,
    sources: Vec<usize>,
    times: Vec<SourceTime>,
    progress: Progress,
    /// The source views, one source time after the other, as they were last rendered. No update depends on it.
    watched: Watched,
}

impl<'a> Fitting<'a> {
    /// Before the first update.
    ///
    /// # Errors
    /// When the records do not belong together, or a source view has no image.
    pub fn new(inputs: ClipInputs<'a>, params: &'a FitParams) -> StageResult<Self> {
        params.check()?;
        let times = source_times(inputs.clip, inputs.robot, inputs.field)?;
        if params.depth > 0.0 && times.iter().flat_map(|time| &time.depths_m).any(Option::is_none) {
            return Err(
                StageError::bad_input("`depth` asks for reference depth, and a source camera has none")
                    .with_hint("set `depth = 0`, or give the clip depth (docs/references.md)"),
            );
        }
        let start = Start::new(inputs.field, inputs.refinement, inputs.robot, params)?;
        let sources: Vec<usize> = times.iter().map(|time| time.slice).collect();
        let parameters = Parameters::zeros(&start, sources.len());
        let moments = groups(&parameters).map(|group| Adam::new(group.len()));
        let views = times.iter().map(|time| time.cameras.len()).sum();
        let watched = Watched::new(views, inputs.field.height as usize, inputs.field.width as usize);
        Ok(Self {
            inputs,
            params,
            start,
            sources,
            times,
            progress: Progress {
                updates: 0,
                parameters,
                moments,
            },
            watched,
        })
    }

    /// Goes on from what another fit of the same records kept; the result is that of one that was never interrupted. False,
    /// and nothing happens, where it belongs to another number of Gaussians, rigid motions or source times.
    pub fn resume(&mut self, kept: &Kept) -> bool {
        let progress = self.restored(kept);
        let fits = progress.is_some();
        if let Some(progress) = progress {
            self.progress = progress;
        }
        fits
    }

    /// The progress as a record, to resume from in another process.
    #[must_use]
    pub fn kept(&self) -> Kept {
        let mut kept = Kept {
            clip_id: self.inputs.clip.clip_id.clone(),
            counters: vec![("updates".to_owned(), u64::from(self.progress.updates))],
            arrays: Vec::new(),
        };
        let groups = groups(&self.progress.parameters);
        for ((name, values), moments) in NAMES.iter().zip(groups).zip(&self.progress.moments) {
            for (part, data) in [("", values), (".first", &moments.first), (".second", &moments.second)] {
                kept.arrays.push(NamedArray {
                    name: format!("{name}{part}"),
                    shape: vec![data.len() as u32],
                    data: data.to_vec(),
                });
            }
        }
        kept
    }

    /// The progress that [`kept`](Self::kept) put into a record; `None` where it is one of other records.
    fn restored(&self, kept: &Kept) -> Option<Progress> {
        let mut progress = self.progress.clone();
        progress.updates = u32::try_from(kept.counter("updates")?).ok()?;
        let groups = groups_mut(&mut progress.parameters);
        for ((name, values), moments) in NAMES.iter().zip(groups).zip(&mut progress.moments) {
            moments.updates = progress.updates;
            for (part, to) in [
                ("", values),
                (".first", &mut moments.first),
                (".second", &mut moments.second),
            ] {
                let from = kept.array(&format!("{name}{part}"))?;
                if from.len() != to.len() {
                    return None;
                }
                to.copy_from_slice(from);
            }
        }
        Some(progress)
    }

    /// One update, on all source cameras of one source time; gives the loss before it.
    ///
    /// # Errors
    /// When the field cannot be rendered.
    pub fn update(&mut self) -> StageResult<f64> {
        let time = self.next_time();
        let (loss, gradient, renders) = self.loss(&self.times[time], &self.progress.parameters)?;
        self.watch(time, &renders)?;
        let share = f64::from(self.progress.updates) / f64::from(self.params.updates.max(1));
        let fall = libm::pow(LAST_RATE, share.min(1.0));
        let rates = &self.params.rates;
        let rates: [f64; GROUPS] = [
            rates.position_m,
            rates.scale,
            rates.rotation,
            rates.opacity,
            rates.colour,
            rates.mixture,
            rates.motion,
        ];
        let gradients = groups(&gradient);
        for (group, values) in groups_mut(&mut self.progress.parameters).into_iter().enumerate() {
            let rate = rates[group] * fall;
            self.progress.moments[group]
                .update(rate, values, gradients[group])
                .map_err(internal)?;
            if self.params.hold > 0.0 {
                let keep = (1.0 - self.params.hold * fall) as f32;
                values.par_iter_mut().for_each(|value| *value *= keep);
            }
        }
        self.progress.updates += 1;
        Ok(loss)
    }

    /// The field as it is now.
    ///
    /// # Errors
    /// Never for a fit that could be made.
    pub fn field(&self) -> StageResult<Field> {
        self.scene().into_field(&self.progress.parameters, self.inputs.field)
    }

    /// How far it is, given the loss of the last update.
    #[must_use]
    pub fn figures(&self, loss: f64) -> Figures {
        Figures {
            part: None,
            update: self.progress.updates,
            updates: self.params.updates,
            loss,
            source_psnr_db: self.watched.psnr_db(),
        }
    }

    /// Observed images and renders of the source time of the last update beside each other, as the bytes of a PNG; empty
    /// before the first.
    ///
    /// # Errors
    /// When the picture cannot be encoded.
    pub fn picture_png(&self) -> StageResult<Vec<u8>> {
        let Some((size, rgb)) = self.watched.picture() else {
            return Ok(Vec::new());
        };
        png_bytes(size, &rgb).map_err(internal)
    }

    /// Notes how well the source views of a source time were rendered.
    fn watch(&mut self, time: usize, renders: &[Render]) -> StageResult<()> {
        let before = self.times[..time].iter().map(|time| time.cameras.len()).sum::<usize>();
        let pairs = renders.iter().zip(&self.times[time].images).enumerate();
        let views: Vec<_> = pairs
            .map(|(view, (render, image))| (before + view, render.rgb.as_slice(), image.as_slice()))
            .collect();
        self.watched.see(&views).map_err(internal)
    }

    fn scene(&self) -> Scene<'_> {
        Scene {
            start: &self.start,
            sources: &self.sources,
        }
    }

    /// Each round takes every source time once, in an order of its own.
    fn next_time(&self) -> usize {
        let count = self.times.len() as u32;
        let (round, place) = (self.progress.updates / count, self.progress.updates % count);
        let mut random = Pcg64::from_seed(self.params.seed.wrapping_mul(1 << 20).wrapping_add(u64::from(round)));
        random.permutation(count)[place as usize] as usize
    }

    /// Loss over the cameras of a source time (section 4), its gradient, and the renders of these cameras and the one beside.
    fn loss(&self, time: &SourceTime, parameters: &Parameters) -> StageResult<(f64, Parameters, Vec<Render>)> {
        let scene = self.scene();
        let posed = scene.pose(parameters, time.slice)?;
        let config = RasterConfig::default();
        let mut cameras = time.cameras.clone();
        cameras.extend(self.beside(time));
        let (renders, tapes) = render_views_with_tape(&posed.gaussians, &cameras, &config).map_err(internal)?;
        let share = 1.0 / time.cameras.len().max(1) as f64;
        let terms = (renders.par_iter().enumerate())
            .map(|(view, render)| match time.images.get(view) {
                Some(image) => self.seen(render, image, time.depths_m[view].as_deref(), share),
                None => Ok(uncovered(render, self.params.coverage)),
            })
            .collect::<StageResult<Vec<Term>>>()?;
        let images: Vec<RenderGradient<'_>> = (terms.iter())
            .map(|term| RenderGradient {
                rgb: &term.rgb,
                alpha: &term.alpha,
                depth_expected: &term.depth_iu,
                ..RenderGradient::default()
            })
            .collect();
        let (gradients, _) = backward_views(&posed.gaussians, &config, &tapes, &images).map_err(internal)?;
        let value = terms.iter().map(|term| term.value).sum::<f64>();
        Ok((value, scene.gradient(&posed, &gradients)?, renders))
    }

    /// One of the source cameras, moved sideways to where no image was taken; none where coverage has no weight.
    fn beside(&self, time: &SourceTime) -> Option<RasterCamera> {
        if self.params.coverage <= 0.0 {
            return None;
        }
        let mut random = Pcg64::from_seed(
            self.params
                .seed
                .wrapping_mul(1 << 20)
                .wrapping_add(BESIDE + u64::from(self.progress.updates)),
        );
        let mut camera = *time
            .cameras
            .get(random.lemire(time.cameras.len() as u32 - 1) as usize)?;
        for axis in 0..2 {
            let reach = self.params.beside_m * UNITS_PER_METRE;
            camera.translation[axis] += reach * (2.0 * random.next_double() - 1.0) * if axis == 0 { 1.0 } else { 0.25 };
        }
        Some(camera)
    }

    /// The terms of a view with an image.
    fn seen(&self, render: &Render, image: &[f32], depth_m: Option<&[f32]>, share: f64) -> StageResult<Term> {
        let (height, width) = (self.inputs.field.height as usize, self.inputs.field.width as usize);
        let scaled = |values: &[f32], weight: f64| values.iter().map(|&value| value * weight as f32).collect();
        let colour = photometric(&render.rgb, image, height, width).map_err(internal)?;
        let mut term = Term {
            value: share * colour.value,
            rgb: scaled(&colour.gradient, share),
            ..Term::default()
        };
        if let (true, Some(reference)) = (self.params.depth > 0.0, depth_m) {
            let found: Vec<f32> = render.depth_expected.iter().map(|&depth| m_from_iu(depth)).collect();
            let known = |(&depth, &alpha): (&f32, &f32)| if depth > 0.0 && alpha > 0.0 { 1.0 } else { 0.0 };
            let weights: Vec<f32> = reference.iter().zip(&render.alpha).map(known).collect();
            let depth = disparity_l1(&found, reference, &weights, DEPTH_KEPT).map_err(internal)?;
            let weight = share * self.params.depth;
            term.value += weight * depth.value;
            term.depth_iu = scaled(&depth.gradient, weight / UNITS_PER_METRE);
        }
        Ok(term)
    }
}

/// What a view adds to the loss, and its gradient with respect to the render.
#[derive(Default)]
struct Term {
    value: f64,
    rgb: Vec<f32>,
    alpha: Vec<f32>,
    depth_iu: Vec<f32>,
}

/// The mean of what is seen through the field, times a weight.
fn uncovered(render: &Render, weight: f64) -> Term {
    let each = weight / render.alpha.len().max(1) as f64;
    Term {
        value: each * render.alpha.iter().map(|&alpha| 1.0 - f64::from(alpha)).sum::<f64>(),
        alpha: vec![-each as f32; render.alpha.len()],
        ..Term::default()
    }
}

/// Fits a field to its source images. `kept` is what a fit of the same job kept before it was killed; the field is that of one
/// that was never interrupted.
///
/// # Errors
/// When the records do not belong together, or a source view has no image.
pub fn fit(
    inputs: ClipInputs<'_>,
    params: &FitParams,
    kept: Option<&Kept>,
    observer: &mut dyn Observer,
) -> StageResult<Field> {
    observer.progress(0.0, "sort the Gaussians");
    let mut fitting = Fitting::new(inputs, params)?;
    if let Some(kept) = kept {
        fitting.resume(kept);
    }
    while fitting.progress.updates < params.updates {
        let loss = fitting.update()?;
        let done = fitting.progress.updates;
        let fraction = f64::from(done) / f64::from(params.updates);
        let figures = fitting.figures(loss);
        observer.progress(0.98 * fraction, &figures.words());
        if done.is_multiple_of(KEEP_EVERY) && done < params.updates {
            observer.keep(&fitting.kept())?;
            observer.show(&figures, &fitting.picture_png()?);
        }
    }
    let mut field = fitting.field()?;
    let description = &field.weights.description;
    field.weights.description = format!(
        "{description}; fitted to the source images by {} updates",
        params.updates
    );
    Ok(field)
}

fn groups(parameters: &Parameters) -> [&[f32]; GROUPS] {
    let Parameters {
        position_m,
        scale,
        rotation,
        opacity,
        colour,
        mixture,
        motion,
    } = parameters;
    [position_m, scale, rotation, opacity, colour, mixture, motion]
}

fn groups_mut(parameters: &mut Parameters) -> [&mut [f32]; GROUPS] {
    let Parameters {
        position_m,
        scale,
        rotation,
        opacity,
        colour,
        mixture,
        motion,
    } = parameters;
    [position_m, scale, rotation, opacity, colour, mixture, motion]
}
