//! The program `rogs-score` on a moving wall, see `support`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use rogs_schemas::FrameIndex;
use rogs_schemas::records::clip::{CameraRole, Rollout};
use support::{Bench, HEIGHT, WIDTH, clip};

#[test]
fn a_moving_wall_has_the_scores_it_should_have() {
    let bench = Bench::new(&clip(true));
    let (event, scores, _) = bench.run(&serde_json::json!({}), "2");
    let scores = scores.unwrap_or_else(|| panic!("no scores: {event}"));
    let sheet = &scores.summary;
    assert_eq!((sheet.method.as_str(), sheet.setting.as_str()), ("stage1", "recorded"));
    assert_eq!((sheet.images.len(), scores.renders.len()), (6, 6));
    assert!(sheet.lpips_note.is_some());

    let source = sheet
        .images
        .iter()
        .find(|image| image.camera == "wrist" && image.frame == FrameIndex(0))
        .unwrap();
    assert_eq!(source.support_n, (HEIGHT * WIDTH - 2) as u64);
    assert!((source.absrel.unwrap() - 0.02 / 1.02).abs() < 1e-3, "{source:?}");
    assert!((source.rmse_m.unwrap() - 0.02).abs() < 1e-3);
    assert_eq!(
        (source.delta1, source.lpips, source.far_absrel),
        (Some(1.0), None, None)
    );
    assert!(source.psnr.unwrap() > 30.0 && source.ssim.unwrap() > 0.9, "{source:?}");

    let novel = sheet.images.iter().find(|image| image.camera == "wrist_right").unwrap();
    assert!(!novel.source_view);
    assert_eq!(
        (novel.psnr, novel.ssim, novel.absrel, novel.support_n),
        (None, None, None, 0)
    );

    let depth = &sheet.robot_depth[0];
    assert_eq!(depth.core_n, ((HEIGHT - 4) * (WIDTH - 2)) as u64);
    assert!((depth.robot_depth_mm.unwrap() - 20.0).abs() < 1.0, "{depth:?}");

    let times: Vec<(u32, u32, u64)> = sheet
        .tracks
        .iter()
        .map(|t| (t.anchor.0, t.frame.0, t.n_tracks))
        .collect();
    assert_eq!(times, [(0, 4, 3), (0, 9, 2)]);
    for track in &sheet.tracks {
        assert!(track.epe_mm.unwrap() < 1e-3, "the wall moves as one piece: {track:?}");
    }
}

#[test]
fn a_refinement_is_scored_after_each_of_its_steps() {
    let mut bench = Bench::new(&clip(true));
    bench.add_refinement();
    let psnr = |params: serde_json::Value| {
        let (event, scores, _) = bench.run(&params, "2");
        let scores = scores.unwrap_or_else(|| panic!("no scores: {event}"));
        (scores.summary.method, scores.summary.images[0].psnr.unwrap())
    };
    let (last, after_two) = psnr(serde_json::json!({}));
    let (_, after_one) = psnr(serde_json::json!({"update": 1}));
    let (none, after_none) = psnr(serde_json::json!({"update": 0}));
    assert_eq!((last.as_str(), none.as_str()), ("stage1+2", "stage1"));
    assert!(
        after_none > after_one + 1.0 && after_one > after_two + 1.0,
        "{after_none} {after_one} {after_two}"
    );

    let (event, scores, _) = bench.run(&serde_json::json!({"update": 3}), "2");
    assert!(scores.is_none());
    assert!(event["message"].as_str().unwrap().contains("it holds: 1, 2"), "{event}");
}

#[test]
fn lpips_needs_weights_and_changes_nothing_else() {
    let mut own = clip(true);
    let pattern: Vec<u8> = (0..HEIGHT * WIDTH * 3).map(|k| (k * k % 251) as u8).collect();
    own.cameras[0].recorded = Some(pattern.repeat(own.frame_count()));
    let mut bench = Bench::new(&own);
    let none = serde_json::json!({});
    let without = bench.run(&none, "2").1.unwrap();
    assert!(without.summary.images.iter().all(|image| image.lpips.is_none()));
    let note = without.summary.lpips_note.clone().unwrap();
    assert!(note.contains("no LPIPS weights"), "{note}");

    bench.add_lpips();
    let (event, with, bytes) = bench.run(&none, "2");
    let mut with = with.unwrap_or_else(|| panic!("no scores: {event}"));
    assert_eq!(with.summary.lpips_note, None);
    let weights = &bench.inputs["lpips"];
    let network = rogs_lpips::Lpips::open(weights).unwrap();
    let reference = network.features_of_bytes(&pattern, HEIGHT, WIDTH).unwrap();
    for (image, render) in with.summary.images.iter().zip(&with.renders) {
        // The kept render has 8 bits, the scored one has not.
        let own = network.features_of_bytes(&render.rgb, HEIGHT, WIDTH).unwrap();
        let expected = network.distance(&own, &reference).unwrap();
        match image.lpips {
            Some(lpips) => assert!((lpips - expected).abs() < 0.02 * expected, "{lpips} {expected}"),
            None => assert_eq!(
                image.camera, "wrist_right",
                "only held-out views have no reference here"
            ),
        }
    }
    assert!(with.summary.images.iter().any(|image| image.lpips > Some(0.0)));
    assert_eq!(bytes, bench.run(&none, "1").2, "thread count");
    for image in &mut with.summary.images {
        image.lpips = None;
    }
    assert_eq!(with.summary.images, without.summary.images);

    std::fs::write(weights, b"no weights").unwrap();
    let (event, scores, _) = bench.run(&none, "2");
    assert!(scores.is_none());
    assert!(event["message"].as_str().unwrap().contains("LPIPS weights"), "{event}");
    assert!(event["hint"].as_str().unwrap().contains("VGG16"), "{event}");
}

/// Generated frames change what is reconstructed, never what it is compared with.
#[test]
fn a_rollout_is_compared_with_what_was_recorded() {
    let recorded = clip(true);
    let mut rollout = recorded.clone();
    for camera in rollout
        .cameras
        .iter_mut()
        .filter(|camera| camera.role == CameraRole::Source)
    {
        camera.generated = Some(vec![7; rollout.episode_frames.len() * HEIGHT * WIDTH * 3]);
    }
    rollout.rollout = Some(Rollout {
        model: "a world model".into(),
        layout: "views".into(),
        frames: [0, 1],
        first_frame_psnr_db: vec![None; rollout.cameras.len()],
    });
    let [recorded, rollout] = [&recorded, &rollout].map(|clip| {
        let (event, scores, _) = Bench::new(clip).run(&serde_json::json!({}), "2");
        scores.unwrap_or_else(|| panic!("no scores: {event}")).summary
    });
    assert_eq!(
        (recorded.setting.as_str(), rollout.setting.as_str()),
        ("recorded", "rollout")
    );
    assert!(rollout.images.iter().any(|image| image.psnr.is_some()));
    assert_eq!(recorded.images, rollout.images);
    assert_eq!(recorded.tracks, rollout.tracks);
}

#[test]
fn a_setting_is_not_a_label() {
    let labelled = serde_json::json!({"setting": "rollout"});
    let error = serde_json::from_value::<rogs_score::ScoreParams>(labelled)
        .unwrap_err()
        .to_string();
    assert!(error.contains("unknown field `setting`"), "{error}");
}

#[test]
fn without_references_every_score_is_null_and_the_renders_remain() {
    let bench = Bench::new(&clip(false));
    let (event, scores, _) = bench.run(&serde_json::json!({"method": "mine"}), "1");
    let scores = scores.unwrap_or_else(|| panic!("no scores: {event}"));
    assert_eq!(
        (scores.summary.method.as_str(), scores.summary.setting.as_str()),
        ("mine", "recorded")
    );
    assert!(
        scores
            .summary
            .images
            .iter()
            .all(|image| image.psnr.is_none() && image.absrel.is_none())
    );
    assert!(scores.summary.tracks.is_empty());
    assert!(
        scores
            .summary
            .robot_depth
            .iter()
            .all(|depth| depth.robot_depth_mm.is_none())
    );
    assert_eq!(scores.renders.len(), 6);
    assert!(
        event["warnings"][0].as_str().unwrap().contains("nothing to score"),
        "{event}"
    );
}

#[test]
fn the_bytes_do_not_depend_on_the_number_of_threads() {
    let bench = Bench::new(&clip(true));
    let (_, _, one) = bench.run(&serde_json::json!({}), "1");
    let (_, _, three) = bench.run(&serde_json::json!({}), "3");
    assert!(!one.is_empty() && one == three);
}

#[test]
fn wrong_inputs_are_explained() {
    let mut other = clip(true);
    other.query_frames = [0, 5].map(FrameIndex).to_vec();
    let (event, scores, _) = Bench::new(&other).run(&serde_json::json!({}), "2");
    assert!(scores.is_none());
    assert!(event["message"].as_str().unwrap().contains("0.3125"), "{event}");
    other.clip_id = "door".parse().unwrap();
    let (event, _, _) = Bench::new(&other).run(&serde_json::json!({}), "2");
    assert!(
        event["message"].as_str().unwrap().contains("different clips"),
        "{event}"
    );
}
