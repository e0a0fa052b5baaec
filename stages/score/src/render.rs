//! Views and displacements of a method's predictions: rendered from a field, ours or another method's, or handed in as
//! images.

use std::collections::BTreeMap;

use rayon::prelude::*;
use rogs_field::TimedField;
use rogs_geometry::{Base, Pose, PosedCamera, Recon};
use rogs_schemas::records::clip::{Clip, time_of_frame};
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::{RenderedView, TrackScore};
use rogs_schemas::units::{LengthUnit, iu_from_m};
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_splat::{Gaussians, RasterCamera, RasterConfig, Render};
use rogs_worker::{StageError, StageResult};

use crate::measure::{MeasuredImage, measure_displacement, reference_depth, robot_tracks};
use crate::metrics::{DisplacementMap, MIN_BLEND_WEIGHT, TrackSample, depth_support};
use crate::outside::{ImagePredictions, OutsideError, OutsideField, stereo_scale};

pub(crate) fn splat_error(error: impl std::fmt::Display) -> StageError {
    StageError::bad_input(error.to_string())
}

pub(crate) fn outside_error(error: OutsideError) -> StageError {
    StageError::bad_input(error.to_string())
}

/// One camera at one time, as far as the method has it.
pub(crate) struct ViewRender {
    /// `[H, W, 3]`
    pub(crate) rgb: Option<Vec<f32>>,
    /// Metres, 0 where undefined. `[H, W]`
    pub(crate) depth_m: Option<Vec<f32>>,
    pub(crate) invalid: u64,
}

impl ViewRender {
    fn new(render: &Render) -> Self {
        let hit = |(depth, &alpha): (f32, &f32)| if alpha > MIN_BLEND_WEIGHT { depth } else { 0.0 };
        let depths = render.depth_expected_m().into_iter().zip(&render.alpha);
        Self {
            rgb: Some(render.rgb.clone()),
            depth_m: Some(depths.map(hit).collect()),
            invalid: render.counts.invalid as u64,
        }
    }

    /// What is kept for people to look at; `None` without colours.
    pub(crate) fn keep(self, image: &MeasuredImage, clip: &Clip) -> Option<RenderedView> {
        let area = clip.height as usize * clip.width as usize;
        Some(RenderedView {
            camera: image.score.camera.clone(),
            frame: image.score.frame,
            height: clip.height,
            width: clip.width,
            // NaN becomes black, as in the scores.
            rgb: self
                .rgb?
                .iter()
                .map(|value| (value.clamp(0.0, 1.0) * 255.0).round() as u8)
                .collect(),
            depth_m: self.depth_m.unwrap_or_else(|| vec![0.0; area]),
        })
    }
}

/// What is scored.
pub(crate) enum Predictions<'a> {
    /// A field that is rendered here.
    Field(FieldSource<'a>),
    /// Images that were rendered elsewhere.
    Images(ImagePredictions),
}

/// A field of Gaussians over time.
pub(crate) enum FieldSource<'a> {
    /// Our own: reconstruction frame, internal units.
    Own {
        field: TimedField<'a>,
        recon_from_base: Pose<Recon, Base>,
    },
    /// Another method's: base frame, metres.
    Outside(OutsideField),
}

/// A clip with the predictions that are scored on it.
pub(crate) struct Scene<'a> {
    pub(crate) clip: &'a Clip,
    pub(crate) robot: &'a RobotMaps,
    pub(crate) predictions: Predictions<'a>,
}

/// Displacement errors, and why there are none where a method has no displacements.
pub(crate) type Displacements = (Vec<TrackScore>, Option<String>);

impl Scene<'_> {
    /// All cameras at a frame, in camera order.
    pub(crate) fn views(&self, frame: FrameIndex) -> StageResult<Vec<ViewRender>> {
        match &self.predictions {
            Predictions::Field(source) => {
                let gaussians = self.gaussians(source, frame)?;
                let cameras: StageResult<Vec<_>> = CameraIndex::first(self.clip.cameras.len())
                    .map(|camera| self.camera(source, camera, frame))
                    .collect();
                let renders =
                    rogs_splat::render_views(&gaussians, &cameras?, &RasterConfig::default()).map_err(splat_error)?;
                Ok(renders.iter().map(ViewRender::new).collect())
            }
            Predictions::Images(images) => {
                let index = images.index(frame).map_err(outside_error)?;
                let area = self.clip.height as usize * self.clip.width as usize;
                let part = |values: &Option<Vec<f32>>, width: usize| {
                    let values = values.as_deref()?.chunks_exact(area * width).nth(index)?;
                    Some(values.to_vec())
                };
                let view = |id: &str| {
                    let own = images.cameras.get(id);
                    ViewRender {
                        rgb: own.and_then(|own| part(&own.rgb, 3)),
                        depth_m: own.and_then(|own| part(&own.depth_m, 1)),
                        invalid: 0,
                    }
                };
                Ok(self.clip.cameras.iter().map(|camera| view(&camera.id)).collect())
            }
        }
    }

    /// Cameras of image predictions with colours or depths that are not finite, and how many.
    pub(crate) fn undefined(&self) -> Vec<(&str, usize)> {
        match &self.predictions {
            Predictions::Images(images) => images.undefined(),
            Predictions::Field(_) => Vec::new(),
        }
    }

    /// Cameras of image predictions with colours far beyond 1.
    pub(crate) fn beyond(&self) -> Vec<String> {
        let Predictions::Images(images) = &self.predictions else {
            return Vec::new();
        };
        let told = images.beyond().into_iter();
        told.map(|(camera, most)| {
            format!("colours of camera `{camera}` go up to {most} and are clipped: floats are colours in 0 to 1")
        })
        .collect()
    }

    /// Displacement errors from the tracks' anchor time to every other query time. One render a source camera carries
    /// the displacements to all times as further channels. Empty when the clip has no tracks.
    pub(crate) fn displacements(&self) -> StageResult<Displacements> {
        let Some(tracks) = &self.clip.tracks else {
            return Ok((Vec::new(), None));
        };
        let anchor = tracks.anchor_frame;
        let query = self.clip.query_frames.iter().copied();
        let frames: Vec<FrameIndex> = query.filter(|&frame| frame != anchor).collect();
        // Per frame: camera and its valid tracks.
        let sources = self.clip.source_cameras();
        let of_frame = |&frame: &FrameIndex| -> Vec<(CameraIndex, Vec<TrackSample>)> {
            let tracks = |&v: &CameraIndex| (v, robot_tracks(self.clip, self.robot, v, frame));
            sources.iter().map(tracks).collect()
        };
        let samples: Vec<_> = frames.iter().map(of_frame).collect();
        let has_tracks = |v: CameraIndex| {
            let mut all = samples.iter().flatten();
            all.any(|(camera, tracks)| *camera == v && !tracks.is_empty())
        };
        let used: Vec<CameraIndex> = sources.iter().copied().filter(|&v| has_tracks(v)).collect();
        let mut note = None;
        let maps = match &self.predictions {
            _ if used.is_empty() => BTreeMap::new(),
            Predictions::Field(source) => match self.displacement_maps(source, anchor, &frames, &used)? {
                Some(maps) => maps,
                None => {
                    note = Some("its Gaussians have no identity over time (numbers differ)".to_owned());
                    BTreeMap::new()
                }
            },
            Predictions::Images(images) => {
                let maps = self.given_maps(images, &frames, &used)?;
                if maps.len() < used.len() {
                    note = Some("it has no rendered displacements for some source cameras".to_owned());
                }
                maps
            }
        };
        let (height, width) = (self.clip.height as usize, self.clip.width as usize);
        let mut scores = Vec::with_capacity(frames.len());
        for (index, (&frame, samples)) in frames.iter().zip(samples).enumerate() {
            let mut views = Vec::new();
            for (camera, tracks) in samples {
                let Some(maps) = maps.get(&camera).filter(|_| !tracks.is_empty()) else {
                    continue;
                };
                let map = DisplacementMap::new(height, width, &maps.sums_m[index], &maps.weight)
                    .map_err(|error| StageError::bad_input(error.to_string()))?;
                views.push((map, tracks));
            }
            // A part of the cameras would be another number, not this one.
            let views = if note.is_some() { Vec::new() } else { views };
            scores.push(measure_displacement(anchor, frame, &views));
        }
        Ok((scores, note))
    }

    /// The camera at a frame, in the frame and unit of the field's Gaussians.
    pub(crate) fn camera(
        &self,
        source: &FieldSource<'_>,
        camera: CameraIndex,
        frame: FrameIndex,
    ) -> StageResult<RasterCamera> {
        let camera = posed(self.clip, self.robot, camera, frame)?;
        Ok(match source {
            FieldSource::Own { recon_from_base, .. } => {
                RasterCamera::new(&camera.in_frame(recon_from_base), LengthUnit::Internal)
            }
            FieldSource::Outside(_) => RasterCamera::new(&camera, LengthUnit::Internal),
        })
    }

    /// The Gaussians at a frame in internal units.
    pub(crate) fn gaussians(&self, source: &FieldSource<'_>, frame: FrameIndex) -> StageResult<Gaussians> {
        match source {
            FieldSource::Own { field, .. } => field.gaussians(self.time(frame)).map_err(|error| {
                splat_error(error).with_hint(format!(
                    "`lift` must be asked for clip frame {frame} (query, source and anchor frames)"
                ))
            }),
            FieldSource::Outside(field) => {
                let gaussians = field.gaussians(frame).map_err(|error| {
                    outside_error(error).with_hint(
                        "a prediction needs every query frame of the clip (the report lists them), and the \
                         anchor frame of the tracks",
                    )
                })?;
                Ok(in_internal_units(gaussians))
            }
        }
    }

    fn time(&self, frame: FrameIndex) -> f64 {
        time_of_frame(frame, self.clip.frame_count())
    }

    /// Rendered displacements from `anchor` to each of `frames` in the base frame, per camera; `None` when the field has
    /// no displacements.
    fn displacement_maps(
        &self,
        source: &FieldSource<'_>,
        anchor: FrameIndex,
        frames: &[FrameIndex],
        cameras: &[CameraIndex],
    ) -> StageResult<Option<BTreeMap<CameraIndex, CameraDisplacements>>> {
        let mut gaussians = self.gaussians(source, anchor)?;
        let channels = frames.len() * 3;
        gaussians.extra_channels = channels;
        gaussians.extra = vec![0.0; gaussians.len() * channels];
        for (index, &frame) in frames.iter().enumerate() {
            let (displacement, rotation) = match source {
                FieldSource::Own { field, recon_from_base } => {
                    let own = field.displacement_m(self.time(anchor), self.time(frame));
                    (own.map_err(splat_error)?, recon_from_base.rotation.transpose())
                }
                FieldSource::Outside(field) => match field.displacement_m(anchor, frame).map_err(outside_error)? {
                    Some(own) => (own, glam::DMat3::IDENTITY),
                    None => return Ok(None),
                },
            };
            let rows = gaussians
                .extra
                .par_chunks_exact_mut(channels)
                .zip(displacement.par_chunks_exact(3));
            rows.for_each(|(row, own)| {
                let base = rotation * glam::DVec3::new(own[0].into(), own[1].into(), own[2].into());
                row[index * 3..index * 3 + 3].copy_from_slice(&base.as_vec3().to_array());
            });
        }
        let views: StageResult<Vec<_>> = cameras
            .iter()
            .map(|&camera| self.camera(source, camera, anchor))
            .collect();
        let renders = rogs_splat::render_views(&gaussians, &views?, &RasterConfig::default()).map_err(splat_error)?;
        let split = |render: Render| {
            let sums_m = (0..frames.len())
                .map(|index| {
                    let pixels = render.extra_accumulated.chunks_exact(channels);
                    pixels
                        .flat_map(|pixel| pixel[index * 3..index * 3 + 3].iter().copied())
                        .collect()
                })
                .collect();
            CameraDisplacements {
                sums_m,
                weight: render.alpha,
            }
        };
        Ok(Some(
            cameras.iter().copied().zip(renders.into_iter().map(split)).collect(),
        ))
    }

    /// Displacements that were handed in, of the cameras that have them.
    fn given_maps(
        &self,
        images: &ImagePredictions,
        frames: &[FrameIndex],
        cameras: &[CameraIndex],
    ) -> StageResult<BTreeMap<CameraIndex, CameraDisplacements>> {
        let area = self.clip.height as usize * self.clip.width as usize;
        let indices: Vec<usize> = frames
            .iter()
            .map(|&frame| images.index(frame).map_err(outside_error))
            .collect::<StageResult<_>>()?;
        let of = |&camera: &CameraIndex| {
            let own = images.cameras.get(&self.clip.cameras[camera.at()].id)?;
            let all = own.displacement_m.as_deref()?;
            let sums_m = indices
                .iter()
                .map(|&index| all[index * area * 3..(index + 1) * area * 3].to_vec())
                .collect();
            let weight = vec![1.0; area];
            Some((camera, CameraDisplacements { sums_m, weight }))
        };
        Ok(cameras.iter().filter_map(of).collect())
    }
}

/// Rendered displacements of one camera.
struct CameraDisplacements {
    /// Per frame, weighted sums in metres, base frame. `[H, W, 3]`
    sums_m: Vec<Vec<f32>>,
    /// Sum of weights. `[H, W]`
    weight: Vec<f32>,
}

/// A camera of the clip at a frame.
pub(crate) fn posed(
    clip: &Clip,
    robot: &RobotMaps,
    camera: CameraIndex,
    frame: FrameIndex,
) -> StageResult<PosedCamera<Base>> {
    PosedCamera::of_clip(clip, robot, camera, frame).map_err(|error| StageError::bad_input(error.to_string()))
}

/// The rasteriser's thresholds are in internal units for every method.
fn in_internal_units(mut gaussians: Gaussians) -> Gaussians {
    for value in gaussians.means.iter_mut().chain(&mut gaussians.scales) {
        *value = iu_from_m(*value);
    }
    gaussians
}

/// Scales the field of every source camera by the median ratio of its reference depth to its own rendered depth, over all
/// valid pixels of the source times together. Returns camera ids and factors.
pub(crate) fn scale_to_source_depth(
    clip: &Clip,
    robot: &RobotMaps,
    mut field: OutsideField,
) -> StageResult<(OutsideField, Vec<(String, f64)>)> {
    let mut factors = Vec::new();
    for (part, camera) in field.cameras().into_iter().enumerate() {
        let Some(camera) = camera else {
            let what = "the scale from source depth is one factor a camera, but the field is one of all cameras";
            return Err(StageError::bad_input(what)
                .with_hint("put each camera's field into a folder of its own, or leave `scale` out"));
        };
        let view = &clip.cameras[camera.at()];
        let mut images = Vec::new();
        for &frame in &clip.source_frames {
            let Some((reference, range_m)) = reference_depth(view, clip, frame) else {
                continue;
            };
            let gaussians = match field.part(part, frame) {
                Ok(gaussians) => in_internal_units(gaussians),
                Err(OutsideError::MissingFrame { .. } | OutsideError::NoFrame { .. }) => continue,
                Err(error) => return Err(outside_error(error)),
            };
            let camera = posed(clip, robot, camera, frame)?;
            let camera = RasterCamera::new(&camera, LengthUnit::Internal);
            let render = rogs_splat::render(&gaussians, &camera, &RasterConfig::default()).map_err(splat_error)?;
            let depth_m = ViewRender::new(&render).depth_m.unwrap_or_default();
            images.push((depth_m, reference, depth_support(reference, range_m)));
        }
        let views: Vec<(&[f32], &[f32], &[bool])> = images
            .iter()
            .map(|(own, reference, support)| (own.as_slice(), *reference, support.as_slice()))
            .collect();
        let Some(factor) = stereo_scale(&views) else {
            let what = format!("camera `{}` has no reference depth to take a scale from", view.id);
            return Err(StageError::bad_input(what).with_hint("leave `scale` out for fields in metres"));
        };
        field.scale(part, factor);
        factors.push((view.id.clone(), factor));
    }
    Ok((field, factors))
}
