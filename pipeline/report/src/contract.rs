//! What every method of a run was given, told from its records and the parameters that its outputs were made with.

use std::collections::BTreeSet;

use rogs_orchestrator::plan::Plan;
use rogs_orchestrator::stage::StageId;
use rogs_schemas::records::clip::{CameraRole, Clip};
use rogs_schemas::records::origin::ReferenceKind;
use rogs_schemas::records::scores::ScoreSheet;
use rogs_score::summary::{OUTSIDE, OUTSIDE_SCALED};
use rogs_score::tables::{MethodSignals, NOT_TOLD, SCALE_ONLY};
use serde_json::Value;

/// The signals of a method whose scores of a clip (node `score`) are this sheet.
pub(crate) fn signals(plan: &Plan, score: usize, sheet: &ScoreSheet, clip: &Clip) -> MethodSignals {
    let outside = sheet
        .weights
        .iter()
        .find(|info| [OUTSIDE, OUTSIDE_SCALED].contains(&&*info.configuration));
    let mut upstream = plan.upstream(score).map(|node| &plan.nodes[node]);
    let lifts = [StageId::Lift, StageId::Lift4dgt, StageId::LiftSom];
    let lift = upstream.find(|node| lifts.contains(&node.stage));
    let own = match (outside, lift) {
        (Some(info), _) => Own::outside((info.configuration == OUTSIDE_SCALED).then(|| scale_only(sheet, clip))),
        (None, Some(lift)) if lift.stage == StageId::Lift4dgt => Own::by_4dgt(&lift.params, clip),
        (None, Some(lift)) if lift.stage == StageId::LiftSom => Own::by_som(clip, &scale_only(sheet, clip)),
        (None, Some(lift)) => Own::lifted(&lift.params, clip, &scale_only(sheet, clip)),
        (None, None) => Own::outside(None),
    };
    let tracked = sheet.references.iter().any(|used| used.kind == ReferenceKind::Tracks);
    let evaluated = |there: bool| if there { "evaluation only" } else { "none" }.to_owned();
    let held_out = clip
        .cameras
        .iter()
        .filter(|camera| camera.role == CameraRole::Evaluation);
    let held_out = held_out
        .filter(|camera| camera.recorded.is_some() || camera.depth.is_some())
        .count();
    MethodSignals {
        setting: sheet.setting.clone(),
        method: sheet.method.clone(),
        given: [
            observations(clip),
            own.visual,
            "yes".to_owned(),
            own.states,
            own.mesh,
            own.stereo,
            evaluated(held_out > 0),
            evaluated(tracked),
            own.fitting,
        ],
    }
}

/// A scale and nothing else is taken from depth of the source cameras; and what made that depth.
fn scale_only(sheet: &ScoreSheet, clip: &Clip) -> String {
    let is_source = |id: &str| {
        let mut sources = clip.cameras.iter().filter(|camera| camera.role == CameraRole::Source);
        sources.any(|camera| camera.id == id)
    };
    let used = sheet.references.iter();
    let origins: BTreeSet<&str> = used
        .filter(|used| used.kind == ReferenceKind::Depth && is_source(&used.camera))
        .map(|used| used.origin.label())
        .collect();
    let origins: Vec<&str> = origins.into_iter().collect();
    match origins[..] {
        [] => SCALE_ONLY.to_owned(),
        _ => format!("{SCALE_ONLY}: {}", origins.join(", ")),
    }
}

fn observations(clip: &Clip) -> String {
    match &clip.rollout {
        None => "recorded".to_owned(),
        Some(rollout) if rollout.model.is_empty() => "generated".to_owned(),
        Some(rollout) => format!("generated ({})", rollout.model),
    }
}

/// What differs between methods.
struct Own {
    visual: String,
    states: String,
    mesh: String,
    stereo: String,
    fitting: String,
}

impl Own {
    /// Files of another method say only how their lengths were taken.
    fn outside(scaled: Option<String>) -> Self {
        Self {
            visual: NOT_TOLD.to_owned(),
            states: NOT_TOLD.to_owned(),
            mesh: NOT_TOLD.to_owned(),
            stereo: scaled.unwrap_or_else(|| NOT_TOLD.to_owned()),
            fitting: NOT_TOLD.to_owned(),
        }
    }

    /// 4DGT sees images alone, all of a camera or those at the source times.
    fn by_4dgt(params: &Value, clip: &Clip) -> Self {
        let frames = match params.get("frames").and_then(Value::as_str) {
            Some("source") => clip.source_frames.len(),
            _ => clip.frame_count(),
        };
        let no = || "no".to_owned();
        Self {
            visual: format!("{frames} / camera"),
            states: no(),
            mesh: no(),
            stereo: no(),
            fitting: no(),
        }
    }

    /// Shape of Motion is fitted to all images of each camera; the robot gives it masks, stereo one factor per camera.
    fn by_som(clip: &Clip, scale_only: &str) -> Self {
        Self {
            visual: format!("{} / camera", clip.frame_count()),
            states: "FK masks only".to_owned(),
            mesh: "foreground mask".to_owned(),
            stereo: scale_only.to_owned(),
            fitting: "no".to_owned(),
        }
    }

    /// By the parameters of the lift stage, which names what it leaves out.
    fn lifted(params: &Value, clip: &Clip, scale_only: &str) -> Self {
        let is = |name: &str, value: &str| params.get(name).and_then(Value::as_str) == Some(value);
        // Both are on unless they are turned off.
        let on = |name: &str| params.get(name).and_then(Value::as_bool).unwrap_or(true);
        let frames = params.get("source_frames").and_then(Value::as_array);
        let times = frames.map_or(clip.source_frames.len(), Vec::len);
        let cameras = clip.source_cameras().len();
        let camera_wise = is("attention", "camera-wise");
        let mut visual = match camera_wise {
            true => format!("{times} / camera"),
            false => format!("{times} times x {cameras} views"),
        };
        if is("tokens", "latents") {
            visual.push_str(", tokens from latents");
        }
        if let Some(factor) = params
            .get("rgb_downsample")
            .and_then(Value::as_u64)
            .filter(|factor| *factor > 1)
        {
            visual.push_str(&format!(", 1/{factor} of the resolution"));
        }
        let anchored = on("anchoring");
        let used = [
            anchored.then_some("anchoring"),
            on("fk_conditioning").then_some("FK"),
            is("robot_motion", "kinematics").then_some("analytic FK motion"),
        ];
        let states: Vec<&str> = used.into_iter().flatten().collect();
        Self {
            visual,
            states: if states.is_empty() {
                "no".to_owned()
            } else {
                states.join(", ")
            },
            mesh: if anchored { "geometry prior" } else { "no" }.to_owned(),
            stereo: if camera_wise { scale_only } else { "no" }.to_owned(),
            fitting: "no".to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use rogs_schemas::records::clip::RobotStates;
    use rogs_schemas::{EpisodeFrame, FrameIndex};
    use serde_json::json;

    use super::*;

    fn clip() -> Clip {
        Clip {
            clip_id: "c".parse().unwrap(),
            episode_id: "c".into(),
            layout: "rogs-episode".into(),
            task: String::new(),
            calibration_note: String::new(),
            fps: 15.0,
            episode_frames: (0..17).map(EpisodeFrame).collect(),
            source_frames: [0, 8, 16].map(FrameIndex).to_vec(),
            query_frames: vec![FrameIndex(1)],
            anchor_frame: FrameIndex(0),
            height: 1,
            width: 1,
            cameras: vec![],
            robot: RobotStates {
                joint_names: vec![],
                positions: vec![],
                gripper: vec![0.0; 17],
            },
            tracks: None,
            rollout: None,
        }
    }

    #[test]
    fn what_is_left_out_is_not_told_as_used() {
        let all = Own::lifted(&json!({}), &clip(), SCALE_ONLY);
        assert_eq!(
            (all.visual.as_str(), all.states.as_str()),
            ("3 times x 0 views", "anchoring, FK")
        );
        assert_eq!((all.mesh.as_str(), all.stereo.as_str()), ("geometry prior", "no"));
        let bare = json!({"anchoring": false, "fk_conditioning": false, "attention": "camera-wise", "source_frames": [0, 16],
            "tokens": "latents", "rgb_downsample": 8});
        let bare = Own::lifted(&bare, &clip(), SCALE_ONLY);
        assert_eq!(bare.visual, "2 / camera, tokens from latents, 1/8 of the resolution");
        assert_eq!(
            (bare.states.as_str(), bare.mesh.as_str(), bare.stereo.as_str()),
            ("no", "no", SCALE_ONLY)
        );
        let analytic = Own::lifted(&json!({"robot_motion": "kinematics"}), &clip(), SCALE_ONLY);
        assert_eq!(analytic.states, "anchoring, FK, analytic FK motion");
        assert_eq!(Own::outside(Some(SCALE_ONLY.to_owned())).stereo, SCALE_ONLY);
        assert_eq!(Own::by_4dgt(&json!({}), &clip()).visual, "17 / camera");
        let som = Own::by_som(&clip(), SCALE_ONLY);
        assert_eq!(
            (
                som.visual.as_str(),
                som.states.as_str(),
                som.mesh.as_str(),
                som.stereo.as_str()
            ),
            ("17 / camera", "FK masks only", "foreground mask", SCALE_ONLY)
        );
        let few = Own::by_4dgt(&json!({"frames": "source"}), &clip());
        assert_eq!((few.visual.as_str(), few.stereo.as_str()), ("3 / camera", "no"));
    }
}
