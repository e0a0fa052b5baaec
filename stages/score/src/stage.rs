//! The stage: reads clip, robot maps and predictions, renders the query plan, measures, writes scores.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use rayon::prelude::*;
use rogs_field::TimedField;
use rogs_geometry::{Base, Pose, Recon, unit_factor};
use rogs_r4c::Record;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::{Field, WeightsInfo};
use rogs_schemas::records::motion_bases::MotionBasisField;
use rogs_schemas::records::polynomial::PolynomialField;
use rogs_schemas::records::references::References;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::{ScoreSheet, Scores};
use rogs_schemas::{CameraIndex, FrameIndex, SchemaId};
use rogs_worker::{Context, Stage, StageError, StageResult};
use serde::{Deserialize, Serialize};

use crate::measure::{MeasuredImage, PredictedImage, RobotCore, measure_image, pool_robot_depth, reference_rgb};
use crate::metrics::{MetricError, SsimVariant};
use crate::outside::{FieldFrame, ImagePredictions, OutsideField};
use crate::perceptual::Perceptual;
use crate::render::{
    FieldSource, Predictions, Scene, ViewRender, outside_error, posed, scale_to_source_depth, splat_error,
};
use crate::summary::{OUTSIDE, OUTSIDE_SCALED};

/// Which renders are kept beside the scores for people to look at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum KeepRenders {
    /// Every camera at every query time.
    #[default]
    All,
    /// None.
    None,
}

/// How the lengths of an outside method's fields become metres.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FieldScale {
    /// They are metres.
    #[default]
    None,
    /// One factor per source camera: the median ratio of the recorded source depth to the field's own rendered depth,
    /// over all valid pixels of the source times. Only for camera-wise fields in their camera's frame.
    SourceDepth,
}

/// An outside method: its predictions are files (input `predictions`, a folder) instead of a field of this pipeline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct PredictionParams {
    /// Frame of its fields.
    pub frame: FieldFrame,
    /// Unit of its fields.
    pub scale: FieldScale,
}

/// Parameters of the stage.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ScoreParams {
    /// Row label; `stage1` or, with a refinement, `stage1+2` when it is not given.
    pub method: Option<String>,
    /// Which SSIM.
    pub ssim: SsimVariant,
    /// The robot's core.
    pub robot_core: RobotCore,
    /// Renders kept in the output.
    pub keep_renders: KeepRenders,
    /// Score the correction after this many updates (0: none) instead of the last one.
    pub update: Option<u32>,
    /// Score an outside method's files (input `predictions`) instead of a field.
    pub prediction: Option<PredictionParams>,
    /// Compare every observation with the field of the other cameras too. Runs with rollouts set it.
    pub cross_view: bool,
}

/// The stage `score`.
pub struct Score {
    params: ScoreParams,
    lpips: Option<Arc<Perceptual>>,
}

impl Stage for Score {
    const NAME: &'static str = "score";
    const SUMMARY: &'static str = "Renders the field at the query plan from every camera and measures it.";
    const VERSION: u32 = 3;
    const OUTPUT: SchemaId = Scores::SCHEMA;
    type Params = ScoreParams;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("clip", Clip::SCHEMA.name),
            InputDescription::required("robot", RobotMaps::SCHEMA.name),
            InputDescription::optional("field", Field::SCHEMA.name),
            InputDescription::optional("references", References::SCHEMA.name),
            InputDescription::optional("refinement", Refinement::SCHEMA.name),
            InputDescription::optional("fitted", Field::SCHEMA.name),
            InputDescription::optional("polynomial", PolynomialField::SCHEMA.name),
            InputDescription::optional("motion-bases", MotionBasisField::SCHEMA.name),
            InputDescription::optional("predictions", "folder"),
            InputDescription::optional("lpips", "file"),
        ]
    }

    fn load(params: &ScoreParams, inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        if !(params.robot_core.tau_m > 0.0 && params.robot_core.tau_m.is_finite()) {
            let message = format!(
                "robot_core.tau_m must be a positive length in metres: `{}`",
                params.robot_core.tau_m
            );
            return Err(StageError::bad_params(message));
        }
        let scaled = |own: PredictionParams| own.scale == FieldScale::SourceDepth && own.frame == FieldFrame::Base;
        if params.prediction.is_some_and(scaled) {
            let message = "prediction.scale = \"source-depth\" scales a field about its camera: it needs prediction.frame = \"camera\"";
            return Err(StageError::bad_params(message));
        }
        let lpips = inputs.get("lpips").map(|path| Perceptual::open(path)).transpose()?;
        Ok(Self {
            params: params.clone(),
            lpips,
        })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let mut clip: Clip = context.read("clip")?;
        let robot: RobotMaps = context.read("robot")?;
        check_clip(&clip, &robot)?;
        if context.optional_input("references").is_some() {
            let references: References = context.read("references")?;
            references.complete(&mut clip).map_err(StageError::bad_input)?;
        }
        match self.params.prediction {
            Some(prediction) => self.run_outside(context, &clip, &robot, prediction),
            None if context.optional_input("polynomial").is_some() => self.run_polynomial(context, &clip, &robot),
            None if context.optional_input("motion-bases").is_some() => self.run_motion_bases(context, &clip, &robot),
            None => self.run_own(context, &clip, &robot),
        }
    }
}

impl Score {
    fn run_own(&self, context: &mut Context<'_>, clip: &Clip, robot: &RobotMaps) -> StageResult<()> {
        let fitted = context.optional_input("fitted").is_some();
        let field: Field = context.read(if fitted { "fitted" } else { "field" })?;
        let refinement = (!fitted && context.optional_input("refinement").is_some())
            .then(|| context.read::<Refinement>("refinement"));
        let refinement = refinement.transpose()?;
        if let (Some(refinement), Some(key)) = (&refinement, context.input_key("field")) {
            let checked = refinement.check_corrects(key);
            checked.map_err(|what| StageError::bad_input(what).with_hint("give the field that `refine` was run on"))?;
        }
        check_field(clip, &field)?;
        let timed = corrected(&field, refinement.as_ref(), self.params.update)?;
        let scene = Scene {
            clip,
            robot,
            predictions: Predictions::Field(FieldSource::Own {
                field: timed,
                recon_from_base: recon_from_base(&field)?,
            }),
        };
        let refined = refinement.is_some() && self.params.update != Some(0);
        let weights = [Some(&field.weights), refinement.as_ref().map(|own| &own.weights)];
        let weights = weights.into_iter().flatten().cloned().collect();
        let method = match (fitted, refined) {
            (true, _) => "fit",
            (false, true) => "stage1+2",
            (false, false) => "stage1",
        };
        let sheet = self.empty_sheet(clip, method, weights);
        self.score(context, &scene, sheet)
    }

    /// Scores the field that 4DGT made here.
    fn run_polynomial(&self, context: &mut Context<'_>, clip: &Clip, robot: &RobotMaps) -> StageResult<()> {
        let field: PolynomialField = context.timed("read_field", |context| context.read("polynomial"))?;
        if field.clip_id != clip.clip_id {
            let message = format!("the field is of clip `{}`, not of `{}`", field.clip_id, clip.clip_id);
            return Err(StageError::bad_input(message));
        }
        let sheet = self.empty_sheet(clip, "4dgt", field.weights);
        let scene = Scene {
            clip,
            robot,
            predictions: Predictions::Field(FieldSource::Outside(OutsideField::polynomial(
                field.gaussians,
                clip.fps,
            ))),
        };
        self.score(context, &scene, sheet)
    }

    /// Scores the field that Shape of Motion made here.
    fn run_motion_bases(&self, context: &mut Context<'_>, clip: &Clip, robot: &RobotMaps) -> StageResult<()> {
        let field: MotionBasisField = context.timed("read_field", |context| context.read("motion-bases"))?;
        if field.clip_id != clip.clip_id {
            let message = format!("the field is of clip `{}`, not of `{}`", field.clip_id, clip.clip_id);
            return Err(StageError::bad_input(message));
        }
        let sheet = self.empty_sheet(clip, "som", vec![field.weights.clone()]);
        let field = OutsideField::motion_bases(field, clip.fps).map_err(outside_error)?;
        let scene = Scene {
            clip,
            robot,
            predictions: Predictions::Field(FieldSource::Outside(field)),
        };
        self.score(context, &scene, sheet)
    }

    fn run_outside(
        &self,
        context: &mut Context<'_>,
        clip: &Clip,
        robot: &RobotMaps,
        prediction: PredictionParams,
    ) -> StageResult<()> {
        let ids: Vec<&str> = clip.cameras.iter().map(|camera| camera.id.as_str()).collect();
        let first = clip.source_frames.first().copied().unwrap_or_default();
        let source = |camera: CameraIndex| -> StageResult<_> {
            let posed = posed(clip, robot, camera, first)?;
            Ok((camera, ids[camera.at()], posed.world_from_camera))
        };
        let sources: Vec<_> = (clip.source_cameras().into_iter())
            .map(source)
            .collect::<StageResult<_>>()?;
        let folder = context.optional_input("predictions").map(PathBuf::from);
        let mut info = WeightsInfo {
            trained: true,
            configuration: OUTSIDE.to_owned(),
            description: "an outside method's own files".to_owned(),
            hash: String::new(),
        };
        let read = |folder: &PathBuf| -> StageResult<Option<Predictions<'_>>> {
            let (height, width) = (clip.height as usize, clip.width as usize);
            if let Some(images) = ImagePredictions::read(folder, &ids, height, width).map_err(outside_error)? {
                return Ok(Some(Predictions::Images(images)));
            }
            let field = OutsideField::read(folder, &sources, prediction.frame, clip.fps).map_err(outside_error)?;
            Ok(field.map(|field| Predictions::Field(FieldSource::Outside(field))))
        };
        let found = context.timed("read_predictions", |_| folder.as_ref().map(read).transpose())?;
        let predictions = match found.flatten() {
            None => {
                context.warn(
                    "the method has no (complete) prediction for this clip; the clip is left out of its means, and their \
                     number of clips says so",
                );
                let sheet = self.empty_sheet(clip, "outside", vec![info]);
                return context.write(&Scores {
                    summary: sheet,
                    renders: Vec::new(),
                });
            }
            Some(Predictions::Field(FieldSource::Outside(field))) if prediction.scale == FieldScale::SourceDepth => {
                let (field, factors) =
                    context.timed("transform_merge", |_| scale_to_source_depth(clip, robot, field))?;
                let text: Vec<String> = factors.iter().map(|(id, factor)| format!("{id} {factor:.6}")).collect();
                info.configuration = OUTSIDE_SCALED.to_owned();
                info.description = format!("scaled to the source depth by {}", text.join(", "));
                Predictions::Field(FieldSource::Outside(field))
            }
            Some(other) => other,
        };
        let scene = Scene {
            clip,
            robot,
            predictions,
        };
        let sheet = self.empty_sheet(clip, "outside", vec![info]);
        self.score(context, &scene, sheet)
    }

    /// Scores every query time and writes the output.
    fn score(&self, context: &mut Context<'_>, scene: &Scene<'_>, mut sheet: ScoreSheet) -> StageResult<()> {
        let (clip, robot) = (scene.clip, scene.robot);
        let mut kept = Vec::new();
        let mut depths = PredictedDepths::default();
        let parts = (clip.query_frames.len() + 1) as f64;
        for (index, &frame) in clip.query_frames.iter().enumerate() {
            context.progress(index as f64 / parts, &format!("frame {frame}"));
            let views = context.timed("render_query", |_| scene.views(frame))?;
            let mut measured = context.timed("measure", |_| self.measure(clip, robot, frame, &views))?;
            context.timed("lpips", |_| self.add_lpips(clip, &views, &mut measured, &mut sheet));
            sheet.robot_depth.push(pool_robot_depth(frame, &measured));
            if self.params.cross_view {
                let views = context.timed("cross_view", |_| scene.cross_views(frame))?;
                sheet.cross_view.extend(views);
            }
            depths.add(&views, &measured);
            for (view, image) in views.into_iter().zip(measured) {
                sheet.invalid_gaussians = sheet.invalid_gaussians.max(view.invalid);
                sheet.n_empty_support += u32::from(image.empty_support);
                if self.params.keep_renders == KeepRenders::All {
                    kept.extend(view.keep(&image, clip));
                }
                sheet.images.push(image.score);
            }
        }
        context.progress((parts - 1.0) / parts, "displacements");
        let (tracks, note) = context.timed("render_displacement", |_| scene.displacements())?;
        sheet.tracks = tracks;
        if let Some(note) = note {
            context.warn(format!("`{}` has no displacement error: {note}", sheet.method));
        }
        if sheet.invalid_gaussians > 0 {
            context.warn(format!(
                "`{}`: {} Gaussians have values that are not finite; they are scored as if they were not there",
                sheet.method, sheet.invalid_gaussians
            ));
        }
        // What an untrained network of ours predicts has no unit to be wrong.
        let of_others = !matches!(scene.predictions, Predictions::Field(FieldSource::Own { .. }));
        for note in depths.notes().into_iter().filter(|_| of_others).chain(scene.beyond()) {
            context.warn(format!("`{}`: {note}", sheet.method));
        }
        for (camera, count) in scene.undefined() {
            context.warn(format!(
                "`{}`: {count} values of camera `{camera}` are not finite; they are scored as 0",
                sheet.method
            ));
        }
        if sheet
            .images
            .iter()
            .all(|image| image.psnr.is_none() && image.absrel.is_none())
        {
            context.warn(
                "the clip has no reference images and no reference depth at the query times: nothing to score; a table \
                     [references] in the manifest makes depth from stereo pairs",
            );
        }
        context.write(&Scores {
            summary: sheet,
            renders: kept,
        })
    }

    fn empty_sheet(&self, clip: &Clip, method: &str, weights: Vec<WeightsInfo>) -> ScoreSheet {
        ScoreSheet {
            clip_id: clip.clip_id.clone(),
            method: self.params.method.clone().unwrap_or_else(|| method.to_owned()),
            setting: clip.setting().to_owned(),
            ssim_variant: self.params.ssim.name().to_owned(),
            lpips_note: match self.lpips {
                None => Some("no LPIPS weights were given (input `lpips`)".to_owned()),
                Some(_) => None,
            },
            weights,
            images: Vec::new(),
            tracks: Vec::new(),
            robot_depth: Vec::new(),
            n_empty_support: 0,
            invalid_gaussians: 0,
            references: clip.references(),
            cross_view: Vec::new(),
        }
    }

    /// Measures the views of all cameras at one frame, in camera order.
    fn measure(
        &self,
        clip: &Clip,
        robot: &RobotMaps,
        frame: FrameIndex,
        views: &[ViewRender],
    ) -> StageResult<Vec<MeasuredImage>> {
        let one = |(camera, view): (CameraIndex, &ViewRender)| {
            let prediction = PredictedImage {
                rgb: view.rgb.as_deref(),
                depth_m: view.depth_m.as_deref(),
            };
            let Self { params, .. } = self;
            measure_image(clip, robot, camera, frame, &prediction, params.ssim, params.robot_core)
        };
        let cameras: Vec<_> = CameraIndex::first(views.len()).zip(views).collect();
        let measured: Result<Vec<_>, MetricError> = cameras.into_par_iter().map(one).collect();
        measured.map_err(|error| StageError::bad_input(format!("frame {frame}: {error}")))
    }

    /// Adds LPIPS where there are weights and a reference image. One image after the other: the network uses all threads.
    fn add_lpips(&self, clip: &Clip, views: &[ViewRender], measured: &mut [MeasuredImage], sheet: &mut ScoreSheet) {
        let Some(lpips) = &self.lpips else { return };
        let (height, width) = (clip.height as usize, clip.width as usize);
        for (camera, (view, image)) in CameraIndex::first(views.len()).zip(views.iter().zip(measured)) {
            let reference = reference_rgb(clip, camera, image.score.frame);
            let (Some(rgb), Some(reference)) = (&view.rgb, reference) else {
                continue;
            };
            match lpips.distance(rgb, reference, height, width) {
                Ok(distance) => image.score.lpips = Some(distance),
                Err(why) => sheet.lpips_note = Some(why),
            }
        }
    }
}

/// What the depths of a prediction say of its unit.
#[derive(Debug, Default)]
struct PredictedDepths {
    /// Predicted over reference depth of each image that has both.
    ratios: Vec<f64>,
    /// Images with depth, and those of them that show nothing.
    images: usize,
    empty: usize,
}

impl PredictedDepths {
    fn add(&mut self, views: &[ViewRender], measured: &[MeasuredImage]) {
        for depth_m in views.iter().filter_map(|view| view.depth_m.as_ref()) {
            self.images += 1;
            self.empty += usize::from(!depth_m.iter().any(|depth| *depth > 0.0));
        }
        self.ratios
            .extend(measured.iter().filter_map(|image| image.depth_ratio));
    }

    fn notes(mut self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.images > 0 && self.empty == self.images {
            notes.push(
                "no view shows anything of the prediction: are its positions metres, in the frame that it says?"
                    .to_owned(),
            );
        }
        self.ratios.sort_by(f64::total_cmp);
        let median = self.ratios.get(self.ratios.len() / 2);
        let told = median.and_then(|ratio| Some((ratio, unit_factor(*ratio)?.meaning)));
        notes.extend(told.map(|(ratio, meaning)| {
            format!("its depth is {ratio:.4} times that of the reference (median of the images): {meaning}?")
        }));
        notes
    }
}

/// The correction to score: the last one, or that after `update` updates.
fn corrected<'a>(
    field: &'a Field,
    refinement: Option<&'a Refinement>,
    update: Option<u32>,
) -> StageResult<TimedField<'a>> {
    let timed = TimedField::new(field).map_err(splat_error)?;
    let (Some(refinement), false) = (refinement, update == Some(0)) else {
        return match update {
            None | Some(0) => Ok(timed),
            Some(update) => Err(StageError::bad_params(format!(
                "the parameter `update` asks for the field after {update} updates, but the job names no input `refinement`"
            ))),
        };
    };
    let Some(update) = update else {
        return timed.with_refinement(refinement).map_err(splat_error);
    };
    let Some(step) = refinement.steps.iter().find(|step| step.update == update) else {
        let kept: Vec<String> = refinement.steps.iter().map(|step| step.update.to_string()).collect();
        let message = format!(
            "the refinement holds no step after {update} updates; it holds: {}",
            kept.join(", ")
        );
        return Err(StageError::bad_params(message).with_hint("let `refine` keep its intermediate steps"));
    };
    timed
        .with_correction(step, refinement.scale_residual)
        .map_err(splat_error)
}

fn check_clip(clip: &Clip, robot: &RobotMaps) -> StageResult<()> {
    let wrong = |what: String| Err(StageError::bad_input(what));
    if robot.clip_id != clip.clip_id {
        return wrong(format!(
            "the inputs belong to different clips: clip `{}`, robot `{}`",
            clip.clip_id, robot.clip_id
        ));
    }
    if (robot.height, robot.width) != (clip.height, clip.width) {
        return wrong(format!(
            "the robot maps are {}x{} pixels, the clip {}x{} (height x width)",
            robot.height, robot.width, clip.height, clip.width
        ));
    }
    if robot.base_from_camera.len() != clip.cameras.len() * clip.frame_count() {
        return wrong(format!(
            "the clip has {} cameras and {} frames, the robot maps {} camera poses",
            clip.cameras.len(),
            clip.frame_count(),
            robot.base_from_camera.len()
        ));
    }
    let used = clip.query_frames.iter().chain(&clip.source_frames);
    if let Some(frame) = used.into_iter().find(|frame| frame.at() >= clip.frame_count()) {
        return wrong(format!(
            "frame {frame} lies outside of the clip's {} frames",
            clip.frame_count()
        ));
    }
    Ok(())
}

fn check_field(clip: &Clip, field: &Field) -> StageResult<()> {
    if field.clip_id != clip.clip_id {
        return Err(StageError::bad_input(format!(
            "the inputs belong to different clips: clip `{}`, field `{}`",
            clip.clip_id, field.clip_id
        )));
    }
    if field.frame_count as usize != clip.frame_count() {
        return Err(StageError::bad_input(format!(
            "the clip has {} frames, the field {}",
            clip.frame_count(),
            field.frame_count
        )));
    }
    Ok(())
}

fn recon_from_base(field: &Field) -> StageResult<Pose<Recon, Base>> {
    Pose::from_rigid(&field.recon_from_base)
        .map_err(|error| StageError::bad_input(format!("the field's reconstruction frame: {error}")))
}
