//! A small run folder, the same at every making: three clips, several methods, failures of every kind.
#![allow(clippy::disallowed_methods, reason = "tests write files by hand")]

use std::path::{Path, PathBuf};

use rogs_orchestrator::plan::{Plan, UnitKey, WorkUnit, read_plan};
use rogs_r4c::ledger::append;
use rogs_r4c::{Record, write_record};
use rogs_schemas::ledger::Attempt;
use rogs_schemas::records::clip::{CameraMount, CameraRole, Clip, ClipCamera, RobotStates};
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps};
use rogs_schemas::records::scores::{ImageScore, RenderedView, RobotDepthScore, ScoreSheet, Scores, TrackScore};
use rogs_schemas::{CameraIndex, EpisodeFrame, FrameIndex, Intrinsics, Provenance, RigidPose};
use serde_json::{Value, json};

const WIDTH: u32 = 12;
const HEIGHT: u32 = 8;
const AREA: usize = (WIDTH * HEIGHT) as usize;
const FRAMES: u32 = 5;
/// Stage, its output, the nodes that it reads.
const STAGES: [(&str, &str, &[usize]); 5] = [
    ("ingest", "clip.r4c", &[]),
    ("robot-maps", "robot.r4c", &[0]),
    ("conditioning", "conditioning.r4c", &[1]),
    ("lift", "field-1.r4c", &[2]),
    ("refine", "field-2.r4c", &[3]),
];
/// Method of a score node, its label (of a variant after `@`), its output, the nodes that it reads.
const METHODS: [(&str, &str, &str, &[usize]); 5] = [
    ("stage1", "score-1", "scores-1.r4c", &[0, 3]),
    ("stage1+2", "score-2", "scores-2.r4c", &[0, 3, 4]),
    ("stage1+2/r0", "score-2@r0", "scores-2.r4c", &[0, 3, 4]),
    ("stage1+2/r1", "score-2@r1", "scores-2.r4c", &[0, 3, 4]),
    ("stage1/no-fk", "score-1@no-fk", "scores-1.r4c", &[0, 3]),
];

/// Makes the run in an empty folder.
pub(crate) fn make_run(run: &Path) {
    std::fs::write(run.join("plan.jsonl"), plan_lines()).unwrap();
    let plan = read_plan(run).unwrap();
    for (index, clip) in plan.clips.iter().enumerate() {
        let (keys, unit) = (plan.keys(index), |node| WorkUnit { clip: index, node });
        if clip.id == "lid" {
            let failure = json!({
                "code": "bad_input",
                "message": "lid/robot.json: joint \"<i>\" & co are not in the URDF",
                "hint": "name the joints as the URDF does",
            });
            note(
                &plan,
                unit(0),
                &keys,
                json!({ "outcome": "failed", "failure": failure }),
            );
            continue;
        }
        for node in 0..5 {
            note(&plan, unit(node), &keys, cost(node, index));
        }
        write(&plan, unit(0), &keys, &the_clip(&clip.id));
        write(&plan, unit(1), &keys, &robot_maps(&clip.id));
        for (order, (method, ..)) in METHODS.into_iter().enumerate() {
            let node = 5 + order;
            note(&plan, unit(node), &keys, cost(node, index));
            let path = write(&plan, unit(node), &keys, &scores(&clip.id, method, order, index));
            if clip.id == "drawer" && method == "stage1/no-fk" {
                damage(&path);
            }
        }
    }
}

fn plan_lines() -> String {
    let node = |label: &str, stage: &str, file: &str, params: Value, inputs: &[usize]| {
        let node = |&node: &usize| json!({ "role": STAGES[node].0, "from": { "node": node } });
        let mut inputs: Vec<Value> = inputs.iter().map(node).collect();
        if stage == "ingest" {
            inputs.push(json!({ "role": "episode", "from": "episode" }));
        }
        json!({
            "label": label, "stage": stage, "stage_version": 1, "schema": format!("rogs.{stage} 1.0"),
            "params": params, "file": file, "by_key": label.contains('@'), "inputs": inputs, "variants": [0],
        })
    };
    let mut nodes: Vec<Value> = STAGES
        .iter()
        .map(|(stage, file, inputs)| {
            let params = if *stage == "refine" {
                json!({ "updates": 2 })
            } else {
                json!({})
            };
            node(stage, stage, file, params, inputs)
        })
        .collect();
    for (method, label, file, inputs) in METHODS {
        let mut params = json!({ "method": method });
        if let Some(update) = method.strip_prefix("stage1+2/r") {
            params["update"] = update.parse::<u64>().unwrap().into();
        }
        nodes.push(node(label, "score", file, params, inputs));
    }
    let head = json!({
        "format": "rogs-plan 1", "name": "kitchen <demo>", "manifest": "/nowhere/kitchen.toml", "setting": "recorded",
        "variants": ["main", "ablations"], "nodes": nodes, "roots": ["/nowhere/episodes"], "calibrations": [],
    });
    let clip = |id: &str| json!({ "id": id, "episode": format!("episodes/{id}"), "layout": "rogs-episode", "root": 0, "content": "0".repeat(64) });
    let lines = [head, clip("cup"), clip("drawer"), clip("lid")];
    lines.map(|line| line.to_string() + "\n").concat()
}

/// What an attempt at a node cost.
fn cost(node: usize, clip: usize) -> Value {
    let mut seconds = json!({ "total": 1.5 * node as f64 + 0.25 + clip as f64, "load": 0.25 });
    match node {
        4 => (seconds["update_1"], seconds["update_2"]) = (json!(2.0), json!(1.5)),
        5.. => seconds["render_query"] = json!(0.125),
        _ => {}
    }
    let warnings = if node == 3 {
        vec!["weights are not trained: \"<seed 7>\""]
    } else {
        vec![]
    };
    json!({
        "outcome": "done", "seconds": seconds, "peak_rss_bytes": (node as u64 + 1) << 28, "threads": 2,
        "output_bytes": 1000, "warnings": warnings,
    })
}

/// Writes a line of the ledger.
fn note(plan: &Plan, unit: WorkUnit, keys: &[UnitKey], more: Value) {
    let mut line = json!({
        "unix_ms": 1, "clip_id": plan.clips[unit.clip].id, "stage": plan.nodes[unit.node].stage,
        "output": plan.output(unit, keys), "key": keys[unit.node].key, "worker": "host-1",
    });
    line.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    let attempt: Attempt = serde_json::from_value(line).unwrap();
    append(&plan.run.join("ledger/host-1.jsonl"), &attempt).unwrap();
}

/// Writes an output with the key of the plan.
fn write<T: Record>(plan: &Plan, unit: WorkUnit, keys: &[UnitKey], record: &T) -> PathBuf {
    let path = plan.run.join(plan.output(unit, keys));
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let provenance = Provenance {
        material: keys[unit.node].material.clone(),
        input_content: [].into(),
    };
    write_record(&path, record, &provenance).unwrap();
    path
}

/// Changes a byte in the middle of a finished file.
fn damage(path: &Path) {
    let mut bytes = std::fs::read(path).unwrap();
    let middle = bytes.len() / 3;
    bytes[middle] ^= 0x55;
    std::fs::write(path, bytes).unwrap();
}

/// An image with a gradient that depends on camera and frame. `[H, W, 3]`
fn image(camera: u8, frame: u8) -> Vec<u8> {
    let pixel = |index: usize| {
        let (column, row) = (index % WIDTH as usize, index / WIDTH as usize);
        [20 * column as u8, 30 * row as u8, 60 * camera + 20 * frame]
    };
    (0..AREA).flat_map(pixel).collect()
}

fn the_clip(id: &str) -> Clip {
    let camera = |index: u8, id: &str, partner: Option<CameraIndex>, mount: CameraMount| ClipCamera {
        id: id.to_owned(),
        role: if partner.is_some() {
            CameraRole::Evaluation
        } else {
            CameraRole::Source
        },
        partner,
        intrinsics: Intrinsics {
            fx: 10.0,
            fy: 10.0,
            cx: 6.0,
            cy: 4.0,
        },
        mount,
        recorded: Some((0..FRAMES as u8).flat_map(|frame| image(index, frame)).collect()),
        generated: None,
        depth: None,
    };
    let fixed = || CameraMount::Fixed {
        base_from_camera: RigidPose::IDENTITY,
    };
    let hand = CameraMount::HandEye {
        link: "hand".to_owned(),
        link_from_camera: RigidPose::IDENTITY,
    };
    Clip {
        clip_id: id.parse().unwrap(),
        episode_id: format!("<b>&\"{id}\""),
        layout: "rogs-episode".to_owned(),
        task: "<script>alert(1)</script>".to_owned(),
        calibration_note: "procedural: exact".to_owned(),
        fps: 15.0,
        episode_frames: (0..FRAMES).map(EpisodeFrame).collect(),
        source_frames: [0, 2, 4].map(FrameIndex).to_vec(),
        query_frames: (0..FRAMES).map(FrameIndex).collect(),
        anchor_frame: FrameIndex(0),
        height: HEIGHT,
        width: WIDTH,
        cameras: vec![
            camera(0, "wrist", None, hand),
            camera(1, "ext1", None, fixed()),
            camera(2, "ext1_right", Some(CameraIndex(1)), fixed()),
        ],
        robot: RobotStates {
            joint_names: vec!["joint1".to_owned()],
            positions: vec![0.0; FRAMES as usize],
            gripper: vec![0.0; FRAMES as usize],
        },
        tracks: None,
        rollout: None,
    }
}

/// A robot that is a rectangle of two links, at the source cameras and times.
fn robot_maps(id: &str) -> RobotMaps {
    let link = |index: usize| match (index % WIDTH as usize, index / WIDTH as usize) {
        (3..6, 2..6) => 0,
        (6..9, 2..6) => 1,
        _ => NO_LINK,
    };
    let links: Vec<u8> = (0..AREA).map(link).collect();
    let map = |camera: u32, frame: u32| RobotMap {
        camera: CameraIndex(camera),
        frame: FrameIndex(frame),
        depth_m: links
            .iter()
            .map(|&link| {
                if link == NO_LINK {
                    0.0
                } else {
                    0.5 + 0.1 * f32::from(link)
                }
            })
            .collect(),
        support: links.iter().map(|&link| u8::from(link == 0)).collect(),
        link: links.clone(),
    };
    RobotMaps {
        clip_id: id.parse().unwrap(),
        link_names: vec!["base".to_owned(), "hand".to_owned()],
        base_from_link: vec![RigidPose::IDENTITY; 2 * FRAMES as usize],
        base_from_camera: vec![RigidPose::IDENTITY; 3 * FRAMES as usize],
        recon_from_base: RigidPose::IDENTITY,
        tool_m: vec![0.0; 3 * FRAMES as usize],
        height: HEIGHT,
        width: WIDTH,
        maps: [0, 1]
            .into_iter()
            .flat_map(|camera| [0, 2, 4].map(|frame| map(camera, frame)))
            .collect(),
    }
}

/// Scores of a method (the number of which makes them differ), with renders where it is of the main run.
fn scores(clip: &str, method: &str, order: usize, index: usize) -> Scores {
    let level = 18.0 + order as f64 + 0.5 * index as f64;
    let score = |camera: &str, source_view: bool, frame: u32| {
        let psnr = level + if source_view { 3.0 } else { 0.0 } + 0.1 * f64::from(frame);
        ImageScore {
            camera: camera.to_owned(),
            source_view,
            frame: FrameIndex(frame),
            psnr: Some(psnr),
            ssim: Some(psnr / 30.0),
            lpips: None,
            absrel: (frame != 3).then_some(2.0 / psnr),
            rmse_m: Some(4.0 / psnr),
            delta1: Some(psnr / 30.0),
            absrel_scaled: Some(3.0 / psnr),
            far_absrel: Some(1.0 / psnr),
            support_n: 96,
        }
    };
    let render = |camera: u8, name: &str, frame: u32| RenderedView {
        camera: name.to_owned(),
        frame: FrameIndex(frame),
        height: HEIGHT,
        width: WIDTH,
        rgb: image(camera, frame as u8)
            .into_iter()
            .map(|byte| byte.saturating_add(5 + 10 * order as u8))
            .collect(),
        depth_m: (0..AREA).map(|index| index as f32 / 100.0).collect(),
    };
    let cameras = [("wrist", true), ("ext1", true), ("ext1_right", false)];
    let query = |camera: usize| (0..FRAMES).map(move |frame| (camera, frame));
    let main = !method.contains('/');
    Scores {
        summary: ScoreSheet {
            clip_id: clip.parse().unwrap(),
            method: method.to_owned(),
            setting: "recorded".to_owned(),
            ssim_variant: "skimage-sample-cov".to_owned(),
            lpips_note: Some("no LPIPS weights were given (input `lpips`)".to_owned()),
            weights: vec![WeightsInfo {
                trained: false,
                configuration: "compact".to_owned(),
                description: "seed <7>".to_owned(),
                hash: String::new(),
            }],
            images: (0..3)
                .flat_map(query)
                .map(|(camera, frame)| score(cameras[camera].0, cameras[camera].1, frame))
                .collect(),
            tracks: [2, 4].map(|frame| track(frame, level)).to_vec(),
            robot_depth: vec![RobotDepthScore {
                frame: FrameIndex(2),
                robot_depth_mm: Some(level - 5.0),
                core_n: 12,
            }],
            n_empty_support: 1,
            invalid_gaussians: 0,
            references: Vec::new(),
            cross_view: Vec::new(),
        },
        renders: if main {
            let views = (0..3).flat_map(query);
            views
                .map(|(camera, frame)| render(camera as u8, cameras[camera].0, frame))
                .collect()
        } else {
            Vec::new()
        },
    }
}

fn track(frame: u32, level: f64) -> TrackScore {
    TrackScore {
        anchor: FrameIndex(0),
        frame: FrameIndex(frame),
        epe_mm: (frame == 4).then_some(level / 2.0),
        n_tracks: if frame == 4 { 3 } else { 0 },
    }
}
