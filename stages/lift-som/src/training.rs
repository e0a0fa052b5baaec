//! The optimisation of the cameras of a clip, one after the other (`docs/spec/baseline-som.md` section 7).

use std::path::Path;

use rogs_arrays::png_bytes;
use rogs_optimise::Watched;
use rogs_schemas::ClipId;
use rogs_schemas::interim::Figures;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::{NamedArray, WeightsInfo};
use rogs_schemas::records::motion_bases::{BasisGaussians, MotionBasisField};
use rogs_schemas::records::progress::Progress;
use rogs_schemas::records::robot::RobotMaps;
use rogs_worker::{Observer, Part, StageError, StageResult};

use crate::initial::{self, draw, purpose};
use crate::internal;
use crate::losses::{Sample, loss};
use crate::observed::Observed;
use crate::params::LiftSomParams;
use crate::scene::{State, add};
use crate::{sidecars, tracks_alone};

/// Frames to which the tracks of a sample are followed.
const TARGETS: usize = 4;
/// Updates after which the progress is kept.
const KEEP_EVERY: u32 = 100;
/// Share of a camera's time that goes by before the first image is rendered, about.
const TRACKS_SHARE: f64 = 0.15;

/// What a clip is reconstructed from.
#[derive(Clone, Copy)]
pub struct ClipInputs<'a> {
    /// The clip.
    pub clip: &'a Clip,
    /// Its robot maps.
    pub robot: &'a RobotMaps,
    /// Its folder of sidecars.
    pub sidecars: &'a Path,
}

/// Optimises a field for every source camera of a clip. `kept` is what a run of the same job kept before it was killed; the
/// field is the one of a run that was never interrupted, bit for bit.
///
/// # Errors
/// When the records do not belong together, or a camera has no field: its sidecars are missing or wrong, its mask is empty,
/// no track or background is left. One camera without a field is a clip without one.
pub fn reconstruct(
    inputs: ClipInputs<'_>,
    params: &LiftSomParams,
    kept: Option<Progress>,
    observer: &mut dyn Observer,
) -> StageResult<MotionBasisField> {
    let ClipInputs { clip, robot, sidecars } = inputs;
    params.validate()?;
    if robot.clip_id != clip.clip_id {
        return Err(StageError::bad_input(format!(
            "the robot maps are those of clip `{}`, not of `{}`",
            robot.clip_id, clip.clip_id
        )));
    }
    let cameras = clip.source_cameras();
    if cameras.is_empty() {
        return Err(StageError::bad_input("the clip has no source cameras"));
    }
    let size = [clip.height as usize, clip.width as usize];
    // All of them first: what cannot be reconstructed is told before minutes go by.
    let mut seen = Vec::with_capacity(cameras.len());
    for &camera in &cameras {
        let id = &clip.cameras[camera.at()].id;
        let own = sidecars::read(sidecars, clip.clip_id.as_str(), id, clip.frame_count(), size)?;
        seen.push(Observed::new(clip, robot, camera, own, params)?);
    }
    let Done { mut fields, mut state } = kept.and_then(Done::restore).unwrap_or_default();
    let share = 1.0 / cameras.len() as f64;
    for (number, observed) in seen.iter().enumerate().skip(fields.len()) {
        let part = Part::new(observer, number as f64 * share, share);
        let watched = Watched::new(observed.len(), observed.height, observed.width);
        let mut fitting = Fitting {
            observed,
            params,
            clip: &clip.clip_id,
            camera: number as u64,
            fields: &fields,
            watched,
            observer: &mut part.named(observed.id.clone()),
        };
        let done = fitting.run(state.take())?;
        fields.push(done.scene.into_gaussians());
    }
    let factors: Vec<String> = seen.iter().map(|own| format!("{} {:.6}", own.id, own.factor)).collect();
    Ok(MotionBasisField {
        clip_id: clip.clip_id.clone(),
        frame_count: clip.frame_count() as u32,
        weights: WeightsInfo {
            trained: true,
            configuration: "Shape of Motion".to_owned(),
            description: format!(
                "optimised for this clip, camera by camera: {} updates; depth of the sidecars times {}",
                params.updates(clip.frame_count()),
                factors.join(", ")
            ),
            hash: String::new(),
        },
        cameras: cameras.into_iter().zip(fields).collect(),
    })
}

/// One camera on its way.
struct Fitting<'a> {
    observed: &'a Observed,
    params: &'a LiftSomParams,
    clip: &'a ClipId,
    /// Number of the camera, for its draws.
    camera: u64,
    /// Cameras that are done.
    fields: &'a [BasisGaussians],
    /// Its frames as they were last rendered. No update depends on it.
    watched: Watched,
    observer: &'a mut dyn Observer,
}

impl Fitting<'_> {
    fn run(&mut self, kept: Option<State>) -> StageResult<State> {
        let updates = self.params.updates(self.observed.len());
        let mut state = match kept {
            Some(state) => state,
            None => self.begin()?,
        };
        while state.updates < updates {
            let batch = self.batch(state.updates);
            let said = loss(self.observed, &state.scene, &batch)?;
            self.watch(&batch, &said.images)?;
            for (to, from) in [(&mut state.screen, &said.screen), (&mut state.seen, &said.seen)] {
                add(to, 1.0, from);
            }
            state.update(&said.gradient)?;
            state.control()?;
            let done = state.updates;
            let figures = Figures {
                part: None,
                update: done,
                updates,
                loss: said.value,
                source_psnr_db: self.watched.psnr_db(),
            };
            if done.is_multiple_of(10) {
                let share = f64::from(done) / f64::from(updates);
                let what = format!("{}, {} Gaussians", figures.words(), state.scene.len());
                self.observer
                    .progress(TRACKS_SHARE + (1.0 - TRACKS_SHARE) * share, &what);
            }
            if done.is_multiple_of(KEEP_EVERY) && done < updates {
                self.keep(&state)?;
                self.show(&figures)?;
            }
        }
        Ok(state)
    }

    /// Notes how well the frames of a batch were rendered.
    fn watch(&mut self, batch: &[Sample], images: &[Vec<f32>]) -> StageResult<()> {
        let observed = self.observed;
        let pairs = batch.iter().zip(images);
        let views: Vec<_> = pairs
            .map(|(own, image)| {
                (
                    own.frame,
                    image.as_slice(),
                    observed.frames[own.frame].target.as_slice(),
                )
            })
            .collect();
        self.watched.see(&views).map_err(internal)
    }

    /// Shows how far the camera is.
    fn show(&mut self, figures: &Figures) -> StageResult<()> {
        if let Some((size, rgb)) = self.watched.picture() {
            self.observer.show(figures, &png_bytes(size, &rgb).map_err(internal)?);
        }
        Ok(())
    }

    /// The scene before the first image is rendered.
    fn begin(&mut self) -> StageResult<State> {
        let (observed, params) = (self.observed, self.params);
        let made = self
            .observer
            .phase("initial", 0.0, || initial::scene(observed, params, self.camera));
        let (mut scene, followed) = made?;
        let mut part = Part::new(self.observer, 0.01, TRACKS_SHARE - 0.01);
        tracks_alone::fit(&mut scene, &followed, observed, params.track_updates, &mut part)?;
        let state = State::new(scene);
        self.keep(&state)?;
        Ok(state)
    }

    /// The samples of an update: of every epoch's the next ones.
    fn batch(&self, update: u32) -> Vec<Sample> {
        let frames = self.observed.len();
        let place = update % self.params.batches(frames);
        let count = self.params.batch.min(frames as u32 - place * self.params.batch);
        let mut random = draw(self.params, &[self.camera, purpose::BATCH, u64::from(update)]);
        let mut sample = || {
            let frame = random.lemire(frames as u32 - 1) as usize;
            let order = random.permutation(frames as u32);
            Sample {
                frame,
                targets: order.into_iter().take(TARGETS).map(|target| target as usize).collect(),
            }
        };
        (0..count).map(|_| sample()).collect()
    }

    fn keep(&mut self, state: &State) -> StageResult<()> {
        let mut progress = Progress {
            clip_id: self.clip.clone(),
            counters: vec![("cameras".to_owned(), self.fields.len() as u64)],
            arrays: Vec::new(),
        };
        for (number, field) in self.fields.iter().enumerate() {
            progress.counters.push((format!("{number}.bases"), field.bases as u64));
            progress
                .counters
                .push((format!("{number}.frames"), field.frames as u64));
            for (name, data) in FIELDS.iter().zip(field.arrays()) {
                progress.arrays.push(NamedArray {
                    name: format!("{number}.{name}"),
                    shape: vec![data.len() as u32],
                    data: data.to_vec(),
                });
            }
        }
        state.store(&mut progress);
        self.observer.keep(&progress)
    }
}

/// How far a clip had come.
#[derive(Default)]
struct Done {
    /// Cameras that were done, in their order.
    fields: Vec<BasisGaussians>,
    /// The next.
    state: Option<State>,
}

/// Names of the arrays of a camera that is done, in the order of [`BasisGaussians::arrays`].
const FIELDS: [&str; 8] = [
    "rotations",
    "translations",
    "coefficients",
    "means",
    "quats",
    "scales",
    "opacities",
    "colours",
];

impl Done {
    /// `None` where it does not fit together.
    fn restore(progress: Progress) -> Option<Self> {
        let field = |number: u64| {
            let array = |name: &str| progress.array(&format!("{number}.{name}")).map(<[f32]>::to_vec);
            let counter = |name: &str| usize::try_from(progress.counter(&format!("{number}.{name}"))?).ok();
            let [
                rotations,
                translations,
                coefficients,
                means,
                quats,
                scales,
                opacities,
                colours,
            ] = FIELDS.map(array);
            let field = BasisGaussians {
                bases: counter("bases")?,
                frames: counter("frames")?,
                rotations: rotations?,
                translations: translations?,
                coefficients: coefficients?,
                means: means?,
                quats: quats?,
                scales: scales?,
                opacities: opacities?,
                colours: colours?,
            };
            field.check().is_ok().then_some(field)
        };
        let fields = (0..progress.counter("cameras")?)
            .map(field)
            .collect::<Option<Vec<_>>>()?;
        Some(Self {
            fields,
            state: Some(State::restore(&progress)?),
        })
    }
}
