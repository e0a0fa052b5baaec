//! What a record says of itself, besides its arrays: frames, cameras, poses, times, weights.

use std::path::Path;

use rogs_r4c::{Record as _, Result, read_record};
use rogs_schemas::records::agreement::Agreements;
use rogs_schemas::records::clip::{Clip, ClipCamera, SourceView};
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::field::{Field, WeightsInfo};
use rogs_schemas::records::references::References;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::Scores;
use rogs_schemas::{EpisodeFrame, FrameIndex, RigidPose};
use serde::Serialize;
use serde_json::{Value, json};

/// The header of a record: for scripts, and as lines for people.
pub(super) struct Header {
    pub(super) value: Value,
    pub(super) lines: Vec<(&'static str, String)>,
}

/// The header of the record in a file; none for a schema without one.
pub(super) fn header(path: &Path, schema: &str) -> Result<Option<Header>> {
    Ok(Some(if schema == Clip::SCHEMA.name {
        of_clip(&read_record::<Clip>(path)?.0)
    } else if schema == RobotMaps::SCHEMA.name {
        of_robot(&read_record::<RobotMaps>(path)?.0)
    } else if schema == Conditioning::SCHEMA.name {
        of_conditioning(&read_record::<Conditioning>(path)?.0)
    } else if schema == References::SCHEMA.name {
        of_references(&read_record::<References>(path)?.0)
    } else if schema == Agreements::SCHEMA.name {
        of_agreements(&read_record::<Agreements>(path)?.0)
    } else if schema == Field::SCHEMA.name {
        of_field(&read_record::<Field>(path)?.0)
    } else if schema == Refinement::SCHEMA.name {
        of_refinement(&read_record::<Refinement>(path)?.0)
    } else if schema == Scores::SCHEMA.name {
        of_scores(&read_record::<Scores>(path)?.0)
    } else {
        return Ok(None);
    }))
}

/// Which frames of its episode a clip is.
#[derive(Serialize)]
struct ClipFrames<'a> {
    clip_id: &'a str,
    episode: &'a str,
    layout: &'a str,
    task: &'a str,
    fps: f64,
    size: [u32; 2],
    episode_frames: &'a [EpisodeFrame],
    source_frames: &'a [FrameIndex],
    query_frames: &'a [FrameIndex],
    anchor_frame: FrameIndex,
    calibration: &'a str,
    joints: &'a [String],
    cameras: Vec<Value>,
    tracks: Option<usize>,
    rollout: Option<&'a str>,
}

fn of_clip(clip: &Clip) -> Header {
    let in_episode = |frames: &[FrameIndex]| {
        let of = |frame: &FrameIndex| clip.episode_frames.get(frame.at()).map(ToString::to_string);
        frames.iter().filter_map(of).collect::<Vec<_>>().join(" ")
    };
    let camera = |camera: &ClipCamera| {
        json!({
            "id": camera.id, "role": camera.role, "partner": camera.partner, "intrinsics": camera.intrinsics,
            "mount": camera.mount, "images": camera.recorded.is_some(),
            "depth": camera.depth.as_ref().map(|depth| &depth.origin),
        })
    };
    let value = ClipFrames {
        clip_id: clip.clip_id.as_str(),
        episode: &clip.episode_id,
        layout: &clip.layout,
        task: &clip.task,
        fps: clip.fps,
        size: [clip.height, clip.width],
        episode_frames: &clip.episode_frames,
        source_frames: &clip.source_frames,
        query_frames: &clip.query_frames,
        anchor_frame: clip.anchor_frame,
        calibration: &clip.calibration_note,
        joints: &clip.robot.joint_names,
        cameras: clip.cameras.iter().map(camera).collect(),
        tracks: clip.tracks.as_ref().map(|tracks| tracks.camera.len()),
        rollout: clip.rollout.as_ref().map(|rollout| rollout.model.as_str()),
    };
    let mut lines = Vec::new();
    if let (Some(first), Some(last)) = (clip.episode_frames.first(), clip.episode_frames.last()) {
        let count = clip.episode_frames.len();
        let text = format!(
            "{count} frames of episode {}: its frames {first} to {last}",
            clip.episode_id
        );
        lines.push(("clip", text));
    }
    lines.extend([
        (
            "images",
            format!("{}x{} pixels, {} frames a second", clip.width, clip.height, clip.fps),
        ),
        ("sources", format!("episode frames {}", in_episode(&clip.source_frames))),
        ("queries", format!("episode frames {}", in_episode(&clip.query_frames))),
        ("joints", clip.robot.joint_names.join(", ")),
    ]);
    lines.extend(clip.cameras.iter().map(|camera| ("camera", camera_line(camera))));
    if let Some(tracks) = &clip.tracks {
        lines.push(("tracks", format!("{} points", tracks.camera.len())));
    }
    if !clip.calibration_note.is_empty() {
        lines.push(("calibrated", clip.calibration_note.clone()));
    }
    Header {
        value: json!(value),
        lines,
    }
}

/// A camera with lens and pose.
fn camera_line(camera: &ClipCamera) -> String {
    use rogs_schemas::records::clip::{CameraMount, CameraRole};
    let lens = camera.intrinsics;
    let role = match camera.role {
        CameraRole::Source => "source",
        CameraRole::Evaluation => "held out",
    };
    let place = match &camera.mount {
        CameraMount::Fixed { base_from_camera } => format!("fixed at {}", metres(base_from_camera)),
        CameraMount::Trajectory { base_from_camera } => match base_from_camera.first() {
            Some(first) => format!("moving, first at {}", metres(first)),
            None => "moving".to_owned(),
        },
        CameraMount::HandEye { link, link_from_camera } => format!("on `{link}` at {}", metres(link_from_camera)),
    };
    let images = if camera.recorded.is_some() {
        ""
    } else {
        ", without images"
    };
    let depth = if camera.depth.is_some() { ", with depth" } else { "" };
    format!(
        "{} ({role}): fx {:.1} fy {:.1} cx {:.1} cy {:.1}; {place}{images}{depth}",
        camera.id, lens.fx, lens.fy, lens.cx, lens.cy
    )
}

fn metres(pose: &RigidPose) -> String {
    let [x, y, z] = pose.translation;
    format!("({x:.3}, {y:.3}, {z:.3}) m")
}

fn of_robot(maps: &RobotMaps) -> Header {
    let frames = maps.base_from_link.len() / maps.link_names.len().max(1);
    let cameras = maps.base_from_camera.len() / frames.max(1);
    let tool: Vec<&[f64]> = maps.tool_m.chunks_exact(3).collect();
    let mut lines = vec![
        ("clip", maps.clip_id.to_string()),
        (
            "images",
            format!("{} maps of {}x{} pixels", maps.maps.len(), maps.width, maps.height),
        ),
        ("frames", format!("{frames}, of {cameras} cameras")),
        ("links", maps.link_names.join(", ")),
    ];
    for camera in 0..cameras {
        let poses = &maps.base_from_camera[camera * frames..][..frames];
        if let [first, .., last] = poses {
            lines.push((
                "camera",
                format!("{camera}: at {} first, {} last", metres(first), metres(last)),
            ));
        }
    }
    if let (Some([x, y, z]), Some([u, v, w])) = (tool.first().copied(), tool.last().copied()) {
        lines.push((
            "tool",
            format!("({x:.3}, {y:.3}, {z:.3}) m first, ({u:.3}, {v:.3}, {w:.3}) m last"),
        ));
    }
    let value = json!({
        "clip_id": maps.clip_id, "frames": frames, "cameras": cameras, "links": maps.link_names,
        "size": [maps.height, maps.width], "base_from_camera": maps.base_from_camera,
        "recon_from_base": maps.recon_from_base, "tool_m": maps.tool_m,
    });
    Header { value, lines }
}

/// Source views as `camera at frame`.
fn views(views: &[SourceView]) -> String {
    let view = |view: &SourceView| format!("{}@{}", view.camera, view.frame);
    views.iter().map(view).collect::<Vec<_>>().join(" ")
}

fn numbers<T: ToString>(values: &[T]) -> String {
    values.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
}

fn of_conditioning(conditioning: &Conditioning) -> Header {
    let pixels: usize = conditioning.view_maps.iter().map(|view| view.pixels.len()).sum();
    let lines = vec![
        ("clip", conditioning.clip_id.to_string()),
        (
            "images",
            format!("{}x{} pixels", conditioning.width, conditioning.height),
        ),
        ("views", format!("camera@frame {}", views(&conditioning.views))),
        (
            "queries",
            format!("clip frames {}", numbers(&conditioning.query_frames)),
        ),
        ("robot", format!("{pixels} supported pixels")),
    ];
    let value = json!({
        "clip_id": conditioning.clip_id, "size": [conditioning.height, conditioning.width],
        "views": conditioning.views, "query_frames": conditioning.query_frames, "supported_pixels": pixels,
    });
    Header { value, lines }
}

fn of_references(references: &References) -> Header {
    let cameras: Vec<_> = references.depth.iter().map(|depth| depth.camera).collect();
    let tracks = references.tracks.as_ref().map(|tracks| tracks.camera.len());
    let mut lines = vec![
        ("clip", references.clip_id.to_string()),
        (
            "depth",
            format!(
                "of cameras {} at clip frames {}",
                numbers(&cameras),
                numbers(&references.frames)
            ),
        ),
    ];
    lines.extend(tracks.map(|tracks| ("tracks", format!("{tracks} points"))));
    lines.extend(references.notes.iter().map(|note| ("note", note.clone())));
    let value = json!({
        "clip_id": references.clip_id, "frames": references.frames, "depth_cameras": cameras, "tracks": tracks,
        "notes": references.notes,
    });
    Header { value, lines }
}

fn of_agreements(agreements: &Agreements) -> Header {
    let mut lines = vec![
        (
            "clip",
            format!("{}, {} frames", agreements.clip_id, agreements.frame_count),
        ),
        ("images", agreements.setting.clone()),
    ];
    for camera in &agreements.cameras {
        let off = camera.offset.map_or_else(String::new, |offset| {
            format!(", {:.1} px ({:.0} mm) off", offset.px, 1000.0 * offset.m)
        });
        let cause = camera.mistake.as_ref().map_or(&camera.why, |mistake| &mistake.words);
        let cause = if cause.is_empty() {
            String::new()
        } else {
            format!("; {cause}")
        };
        lines.push(("camera", format!("{}: {}{off}{cause}", camera.name, camera.verdict)));
    }
    let cameras = agreements.cameras.iter().map(|camera| {
        json!({
            "camera": camera.name, "verdict": camera.verdict.name(), "mistake": camera.mistake, "why": camera.why,
            "overlay": camera.overlay, "offset": camera.offset, "lag_frames": camera.lag_frames, "drift_m": camera.drift_m,
        })
    });
    let value = json!({
        "clip_id": agreements.clip_id, "setting": agreements.setting, "frame_count": agreements.frame_count,
        "cameras": cameras.collect::<Vec<_>>(),
    });
    Header { value, lines }
}

fn weights_line(weights: &WeightsInfo) -> String {
    let trained = if weights.trained { "" } else { "NOT TRAINED: " };
    format!("{trained}{} ({})", weights.description, weights.configuration)
}

fn of_field(field: &Field) -> Header {
    let times: Vec<f64> = field.slices.iter().map(|slice| slice.time).collect();
    let anchored = field.support.iter().filter(|&&support| support != 0).count();
    let lines = vec![
        ("clip", format!("{}, {} frames", field.clip_id, field.frame_count)),
        (
            "field",
            format!("{} Gaussians, {anchored} of them on the robot", field.len()),
        ),
        ("images", format!("{}x{} pixels", field.width, field.height)),
        ("views", format!("camera@frame {}", views(&field.views))),
        ("times", numbers(&times)),
        ("weights", weights_line(&field.weights)),
    ];
    let value = json!({
        "clip_id": field.clip_id, "frame_count": field.frame_count, "size": [field.height, field.width],
        "views": field.views, "gaussians": field.len(), "anchored": anchored, "times": times,
        "recon_from_base": field.recon_from_base, "weights": field.weights,
        "any_time": !field.query_state.is_empty(),
    });
    Header { value, lines }
}

fn of_refinement(refinement: &Refinement) -> Header {
    let steps: Vec<u32> = refinement.steps.iter().map(|step| step.update).collect();
    let lines = vec![
        ("clip", refinement.clip_id.to_string()),
        (
            "field",
            format!("key {}, {} Gaussians", refinement.field_key, refinement.gaussian_count),
        ),
        (
            "updates",
            format!("{}; kept after {}", refinement.updates, numbers(&steps)),
        ),
        ("weights", weights_line(&refinement.weights)),
    ];
    let value = json!({
        "clip_id": refinement.clip_id, "field_key": refinement.field_key, "gaussians": refinement.gaussian_count,
        "updates": refinement.updates, "kept": steps, "preset": refinement.preset, "weights": refinement.weights,
    });
    Header { value, lines }
}

fn of_scores(scores: &Scores) -> Header {
    let sheet = &scores.summary;
    let mean = |source: bool| {
        let images = sheet.images.iter().filter(|image| image.source_view == source);
        let psnr: Vec<f64> = images.filter_map(|image| image.psnr).collect();
        match psnr.len() {
            0 => "none".to_owned(),
            count => format!("{:.2} dB over {count} images", psnr.iter().sum::<f64>() / count as f64),
        }
    };
    let mut lines = vec![
        ("clip", sheet.clip_id.to_string()),
        ("method", format!("{} on {} observations", sheet.method, sheet.setting)),
        (
            "PSNR",
            format!("source views {}; held-out views {}", mean(true), mean(false)),
        ),
    ];
    lines.extend(sheet.weights.iter().map(|weights| ("weights", weights_line(weights))));
    Header {
        value: json!(sheet),
        lines,
    }
}
