//! From a clip, its robot maps and its robot to verdicts.

use std::path::Path;

use rayon::prelude::*;
use rogs_agreement::audit::{CameraAudit, Filmed, Footage, Mistake, Mount, SUSPECT_PX, audit};
use rogs_agreement::{
    Agreeing, Agreement, Following, MovedView, Settings, Surface, View, Why, agreement, follow, link_offsets,
};
use rogs_geometry::{Base, Link, Pinhole, Pose, PosedCamera};
use rogs_robot::{MeshScene, RobotModel};
use rogs_schemas::records::agreement::{
    Agreements, CameraAgreement, Estimate, Offset, TriedMistake, Verdict, ViewAgreement, ViewState,
};
use rogs_schemas::records::clip::{CameraMount, Clip, SourceView};
use rogs_schemas::records::robot::{RobotMap, RobotMaps, RobotSpec};
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_worker::{Observer, StageError, StageResult};

use crate::params::Params;

/// A robot with its meshes, read once for many clips.
#[derive(Debug)]
pub struct Robot {
    model: RobotModel,
    scene: MeshScene,
}

impl Robot {
    /// Reads a URDF and the meshes that the spec selects.
    ///
    /// # Errors
    /// When the robot cannot be read, or a link or joint of the spec does not exist.
    pub fn load(urdf: &Path, spec: &RobotSpec) -> StageResult<Self> {
        let bad = |error: rogs_robot::Error| StageError::bad_input(error.chain());
        let model = RobotModel::load(urdf).map_err(bad)?;
        let model = model.with_base_link(&spec.base_link).map_err(bad)?;
        let scene = MeshScene::of_robot(&model, spec).map_err(bad)?;
        Ok(Self { model, scene })
    }
}

/// One camera at all frames, measured.
struct Measured {
    camera: CameraIndex,
    /// `None`: there is no image. `[F]`
    views: Vec<Option<Agreement>>,
    following: Following,
}

/// Measures the source cameras of a clip; `observer` hears of those where the robot lies beside the images.
///
/// # Errors
/// When clip, robot maps and robot do not belong together.
pub fn build(
    clip: &Clip,
    maps: &RobotMaps,
    robot: &Robot,
    params: &Params,
    observer: &mut dyn Observer,
) -> StageResult<Agreements> {
    check(clip, maps)?;
    let links = link_poses(maps)?;
    let cameras = clip.source_cameras();
    let measured = observer.phase("measure", 0.0, || {
        (cameras.par_iter())
            .map(|&camera| measure(clip, maps, &links, camera))
            .collect::<StageResult<Vec<Measured>>>()
    })?;
    let explained = if params.explain && clip.rollout.is_none() && robot.scene.triangle_count() > 0 {
        observer.phase("explain", 0.4, || explain(clip, robot, params, &measured))?
    } else {
        Vec::new()
    };
    let of_camera = |own: &Measured| {
        let name = &clip.cameras[own.camera.at()].id;
        let audited = explained.iter().find(|audited| &audited.camera == name);
        summed_up(clip, maps, own, audited, robot)
    };
    let agreements = Agreements {
        clip_id: clip.clip_id.clone(),
        setting: clip.setting().to_owned(),
        frame_count: clip.frame_count() as u32,
        link_names: maps.link_names.clone(),
        cameras: measured.iter().map(of_camera).collect(),
    };
    for camera in &agreements.cameras {
        if let Some(warning) = warning(camera) {
            observer.warn(warning);
        }
    }
    Ok(agreements)
}

fn check(clip: &Clip, maps: &RobotMaps) -> StageResult<()> {
    let wrong = |what: String| Err(StageError::bad_input(what));
    if maps.clip_id != clip.clip_id {
        return wrong(format!(
            "the robot maps are of clip `{}`, not of `{}`",
            maps.clip_id, clip.clip_id
        ));
    }
    let frames = clip.frame_count();
    let found = [maps.base_from_camera.len(), maps.base_from_link.len()];
    let expected = [frames * clip.cameras.len(), frames * maps.link_names.len()];
    if found != expected {
        return wrong(format!(
            "the robot maps have {found:?} camera and link poses, the clip asks for {expected:?}"
        ));
    }
    if (maps.height, maps.width) != (clip.height, clip.width) {
        return wrong(format!(
            "the robot maps are {}x{} pixels, the clip {}x{} (height x width)",
            maps.height, maps.width, clip.height, clip.width
        ));
    }
    Ok(())
}

/// Link-to-base poses by frame.
fn link_poses(maps: &RobotMaps) -> StageResult<Vec<Vec<Pose<Base, Link>>>> {
    let of_frame = |poses: &[rogs_schemas::RigidPose]| {
        let pose = |pose| Pose::from_rigid(pose).map_err(|error| StageError::bad_input(error.to_string()));
        poses.iter().map(pose).collect()
    };
    maps.base_from_link
        .chunks(maps.link_names.len().max(1))
        .map(of_frame)
        .collect()
}

fn measure(
    clip: &Clip,
    maps: &RobotMaps,
    links: &[Vec<Pose<Base, Link>>],
    camera: CameraIndex,
) -> StageResult<Measured> {
    let settings = Settings::default();
    let area = clip.height as usize * clip.width as usize;
    let of_camera: Vec<&RobotMap> = maps.maps.iter().filter(|map| map.camera == camera).collect();
    let wrong = |error: &dyn std::error::Error| {
        StageError::bad_input(format!("camera `{}`: {error}", clip.cameras[camera.at()].id))
    };
    let view = |frame: FrameIndex| -> StageResult<Option<View<'_>>> {
        let Some(image) = clip.observation(SourceView { camera, frame }) else {
            return Ok(None);
        };
        let map = of_camera.iter().find(|map| map.frame == frame).ok_or_else(|| {
            StageError::bad_input(format!(
                "the robot maps lack camera `{}` at frame {frame}",
                clip.cameras[camera.at()].id
            ))
        })?;
        // Measured depth is of the recorded scene, which a rollout does not show.
        let depth = clip.cameras[camera.at()]
            .depth
            .as_ref()
            .filter(|_| clip.rollout.is_none());
        Ok(Some(View {
            rgb: image.rgb(),
            camera: PosedCamera::of_clip(clip, maps, camera, frame).map_err(|error| wrong(&error))?,
            surface: Surface::from(*map),
            base_from_link: &links[frame.at()],
            sensor_depth_m: depth.and_then(|depth| depth.depth_m.get(frame.at() * area..(frame.at() + 1) * area)),
        }))
    };
    let views: Vec<Option<View<'_>>> = FrameIndex::first(clip.frame_count())
        .map(view)
        .collect::<StageResult<_>>()?;
    let told: Vec<Option<Agreement>> = views
        .par_iter()
        .map(|view| match view {
            None => Ok(None),
            Some(view) => agreement(view, &settings).map(Some).map_err(|error| wrong(&error)),
        })
        .collect::<StageResult<_>>()?;
    let moved: Vec<Option<MovedView<'_>>> = views
        .iter()
        .zip(&told)
        .map(|(view, told)| match (view, told) {
            (Some(view), Some(Agreement::Measured(found))) => Some(MovedView {
                view: *view,
                samples: &found.samples,
            }),
            _ => None,
        })
        .collect();
    let mut following = follow(&moved).map_err(|error| wrong(&error))?;
    if matches!(clip.cameras[camera.at()].mount, CameraMount::HandEye { .. }) {
        // The hand stands still in its own camera, however late it is.
        following.lag_frames = None;
    }
    Ok(Measured {
        camera,
        views: told,
        following,
    })
}

/// Tries mistakes, where some camera is not good.
fn explain(clip: &Clip, robot: &Robot, params: &Params, measured: &[Measured]) -> StageResult<Vec<CameraAudit>> {
    let frames = clip.frame_count();
    let mut cameras = Vec::new();
    for own in measured {
        let camera = &clip.cameras[own.camera.at()];
        let images = FrameIndex::first(frames).map(|frame| {
            let camera = own.camera;
            Some(clip.observation(SourceView { camera, frame })?.rgb())
        });
        let Some(images) = images.collect::<Option<Vec<&[u8]>>>() else {
            continue;
        };
        let wrong = |error: &dyn std::error::Error| StageError::bad_input(format!("camera `{}`: {error}", camera.id));
        let mount = Mount::of_clip(&camera.mount, &robot.model).map_err(|error| wrong(&error))?;
        cameras.push(Filmed {
            name: &camera.id,
            lens: Pinhole::of_clip(clip, camera),
            mount,
            images,
        });
    }
    if cameras.is_empty() {
        return Ok(Vec::new());
    }
    let footage = Footage {
        model: &robot.model,
        scene: &robot.scene,
        spec: &params.robot,
        joint_names: &clip.robot.joint_names,
        positions: &clip.robot.positions,
        gripper: &clip.robot.gripper,
        cameras,
    };
    audit(&footage).map_err(|error| StageError::bad_input(error.to_string()))
}

fn summed_up(
    clip: &Clip,
    maps: &RobotMaps,
    own: &Measured,
    audited: Option<&CameraAudit>,
    robot: &Robot,
) -> CameraAgreement {
    let found: Vec<Option<&Agreeing>> = own.views.iter().map(agreeing).collect();
    let links = maps.link_names.len();
    let (mut link_px, mut link_m) = (Vec::new(), Vec::new());
    for found in &found {
        for link in 0..links {
            let [px, m] = found
                .and_then(|found| link_offsets(&found.samples, clip.cameras[own.camera.at()].intrinsics.fx, link))
                .unwrap_or([f64::NAN; 2]);
            link_px.push(px as f32);
            link_m.push(m as f32);
        }
    }
    let offsets: Vec<&Agreeing> = found.iter().copied().flatten().collect();
    let middle = |value: fn(&Agreeing) -> f64| {
        let mut values: Vec<f64> = offsets.iter().map(|found| value(found)).collect();
        let middle = values.len() / 2;
        *values.select_nth_unstable_by(middle, f64::total_cmp).1
    };
    let offset = (!offsets.is_empty()).then(|| Offset {
        px: middle(|found| found.offset_px[0]),
        sigma_px: middle(|found| found.offset_px[1]),
        m: middle(|found| found.offset_mm[0]) / 1000.0,
    });
    let overlay = offsets.iter().map(|found| found.overlay).sum::<f64>() / offsets.len().max(1) as f64;
    let (verdict, why) = match audited {
        Some(audited) => (audited.verdict, audited.why.map(|why| why.to_string())),
        None => plain_verdict(own, offset, robot),
    };
    let tried = |mistake: &Mistake, overlay| TriedMistake {
        name: mistake.name().to_owned(),
        words: mistake.to_string(),
        overlay,
    };
    let all = audited.map_or(&[][..], |audited| &audited.tried);
    let likely = audited.and_then(|audited| audited.mistake.as_ref());
    let estimate = |own: Option<[f64; 2]>| own.map(|[value, sigma]| Estimate { value, sigma });
    CameraAgreement {
        camera: own.camera,
        name: clip.cameras[own.camera.at()].id.clone(),
        verdict,
        mistake: likely.map(|mistake| {
            let overlay = all.iter().find(|tried| tried.mistake == *mistake);
            tried(mistake, overlay.map_or(0.0, |tried| tried.overlay))
        }),
        why: why.unwrap_or_default(),
        overlay,
        offset,
        tried: all.iter().map(|own| tried(&own.mistake, own.overlay)).collect(),
        lag_frames: estimate(own.following.lag_frames),
        drift_m: estimate(own.following.drift_m),
        views: own.views.iter().map(view_agreement).collect(),
        link_px,
        link_m,
    }
}

fn agreeing(view: &Option<Agreement>) -> Option<&Agreeing> {
    match view {
        Some(Agreement::Measured(found)) => Some(found),
        _ => None,
    }
}

/// The verdict where no mistake was tried.
fn plain_verdict(own: &Measured, offset: Option<Offset>, robot: &Robot) -> (Verdict, Option<String>) {
    let cannot = |why: &str| (Verdict::CannotTell, Some(why.to_owned()));
    let told = own.views.iter().filter(|view| agreeing(view).is_some()).count();
    match offset {
        _ if robot.scene.triangle_count() == 0 => cannot("the robot has no mesh"),
        Some(offset) if 2 * told >= own.views.len() => {
            let off = offset.px > SUSPECT_PX && offset.px > 3.0 * offset.sigma_px;
            (if off { Verdict::Suspect } else { Verdict::Good }, None)
        }
        _ => {
            let states: Vec<ViewState> = own.views.iter().map(|view| view_agreement(view).state).collect();
            let count = |state: &ViewState| states.iter().filter(|own| *own == state).count();
            let most = ViewState::ALL[1..].iter().rev().max_by_key(|state| count(state));
            cannot(most.map_or("", |state| state.words()))
        }
    }
}

fn view_agreement(view: &Option<Agreement>) -> ViewAgreement {
    match view {
        None => ViewAgreement::unknown(ViewState::NoImage),
        Some(Agreement::CannotTell { why }) => ViewAgreement::unknown(match why {
            Why::HardlyVisible => ViewState::HardlyVisible,
            Why::BlankImage => ViewState::BlankImage,
            Why::TooFewEdges => ViewState::TooFewEdges,
        }),
        Some(Agreement::Measured(found)) => ViewAgreement {
            state: ViewState::Measured,
            shift_px: found.shift.px.to_array().map(|value| value as f32),
            sigma_px: found.offset_px[1] as f32,
            offset_m: (found.offset_mm[0] / 1000.0) as f32,
            sigma_m: (found.offset_mm[1] / 1000.0) as f32,
            overlay: found.overlay as f32,
        },
    }
}

/// What a person should know of a camera; nothing where the robot lies on the images, or where that cannot be told.
fn warning(camera: &CameraAgreement) -> Option<String> {
    let CameraAgreement { name, verdict, .. } = camera;
    if !matches!(verdict, Verdict::Suspect | Verdict::Wrong) {
        return None;
    }
    let off = camera.offset.map_or_else(String::new, |offset| {
        format!(
            "the robot lies {:.1} px ({:.0} mm) beside the images, ",
            offset.px,
            1000.0 * offset.m
        )
    });
    let cause = match &camera.mistake {
        Some(mistake) => format!(
            "probably because {} (overlay {:.2}, without that {:.2})",
            mistake.words, camera.overlay, mistake.overlay
        ),
        None => "and no known mistake explains it".to_owned(),
    };
    Some(format!("camera `{name}` is {verdict}: {off}{cause}"))
}
