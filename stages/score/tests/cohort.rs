//! Cohort selection: the rules on made-up episodes, the real manifest where it is there.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use rogs_needs::{needs, shared};
use rogs_random::Pcg64;
use rogs_score::cohort::{
    CohortError, CohortOptions, EpisodeRecord, ExclusionReason, PointWorldManifest, episode_of_key, read_episodes,
    select,
};

fn episode(number: usize) -> EpisodeRecord {
    EpisodeRecord {
        episode_id: format!("ILIAD+abc+2023-01-01-10h-00m-{number:02}s"),
        lab: None,
        scene: Some(format!("scene{}", number % 3)),
        clip_name: Some(format!("clip_{:03}", 97 - number)),
        train_or_val: false,
        stereo: true,
        frames: 33,
        calibration: true,
        gripper_range: Some([0.0, 1.0]),
    }
}

fn manifest(episodes: &[EpisodeRecord]) -> PointWorldManifest {
    PointWorldManifest {
        path_name: "manifest.json".into(),
        sha256: String::new(),
        domain: "droid".into(),
        seed: 42,
        test_fraction: 0.1,
        clips: episodes.len(),
        episodes: episodes.iter().map(|episode| episode.episode_id.clone()).collect(),
    }
}

#[test]
fn every_reason_excludes_once_and_in_order() {
    let mut episodes: Vec<EpisodeRecord> = (0..12).map(episode).collect();
    let manifest = manifest(&episodes[..11]);
    episodes[0].train_or_val = true;
    episodes[0].clip_name = None;
    episodes[1].clip_name = None;
    episodes[2].stereo = false;
    episodes[3].frames = 23;
    episodes[4].calibration = false;
    episodes[5].gripper_range = Some([0.0, 1.1]);
    episodes[6].gripper_range = None;
    episodes[7].gripper_range = Some([-1e-7, 1.0]);
    episodes.push(EpisodeRecord {
        episode_id: "TRI+x+2023".into(),
        ..episode(50)
    });
    let selection = select(
        &episodes,
        &manifest,
        &CohortOptions {
            take: 2,
            ..CohortOptions::default()
        },
    )
    .unwrap();
    let counts = selection.counts;
    assert_eq!((counts.reserved, counts.cached, counts.candidates), (12, 9, 8));
    assert_eq!((counts.eligible, counts.selected), (4, 2));
    use ExclusionReason::{GripperRange, NoCalibration, NoClip, NoStereo, NotInTestManifest, TooFewFrames, TrainOrVal};
    let expected = [
        (TrainOrVal, 1),
        (NoClip, 1),
        (NoStereo, 1),
        (NotInTestManifest, 1),
        (TooFewFrames, 1),
        (NoCalibration, 1),
        (GripperRange, 2),
    ];
    assert_eq!(selection.exclusion_counts.into_iter().collect::<Vec<_>>(), expected);
    assert!(selection.eligible_sorted.is_sorted());
    let mut first = Pcg64::from_seed(42).permutation(4)[..2].to_vec();
    first.sort_unstable();
    assert_eq!(selection.selected_indices, first);
    for one in &selection.selected {
        assert_eq!(one.clip_name, selection.eligible_sorted[one.index as usize]);
        assert_eq!(one.lab, "ILIAD");
    }
}

#[test]
fn the_order_of_the_list_does_not_matter() {
    let mut episodes: Vec<EpisodeRecord> = (0..30).map(episode).collect();
    let manifest = manifest(&episodes);
    let options = CohortOptions {
        take: 7,
        ..CohortOptions::default()
    };
    let first = select(&episodes, &manifest, &options).unwrap();
    episodes.reverse();
    assert_eq!(first, select(&episodes, &manifest, &options).unwrap());
    let text = serde_json::to_string(&first).unwrap();
    assert_eq!(
        serde_json::from_str::<rogs_score::cohort::Selection>(&text).unwrap(),
        first
    );
    assert!(text.contains("\"algorithm\":\"numpy-pcg64-permutation\""));
}

#[test]
fn duplicates_are_refused() {
    let episodes = vec![episode(1), episode(1)];
    let result = select(&episodes, &manifest(&episodes), &CohortOptions::default());
    assert!(matches!(result, Err(CohortError::Duplicate { .. })));
}

#[test]
fn clip_keys_lose_only_their_range() {
    assert_eq!(
        episode_of_key("ILIAD+5e9+2023-06-12-14h-47m-26s-15:26"),
        Some("ILIAD+5e9+2023-06-12-14h-47m-26s")
    );
    for bad in ["", "-0:11", "abc", "abc-0", "abc-0:", "abc-x:11"] {
        assert_eq!(episode_of_key(bad), None, "{bad}");
    }
}

#[test]
fn episode_lists_are_arrays_or_lines() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("episodes.json");
    let episodes = vec![episode(1), episode(2)];
    std::fs::write(&path, serde_json::to_string(&episodes).unwrap()).unwrap();
    assert_eq!(read_episodes(&path).unwrap(), episodes);
    let lines: Vec<String> = episodes.iter().map(|one| serde_json::to_string(one).unwrap()).collect();
    std::fs::write(&path, lines.join("\n")).unwrap();
    assert_eq!(read_episodes(&path).unwrap(), episodes);
    std::fs::write(&path, "{\"episode_id\":\"a\"}\n{\"episode\":\"b\"}\n").unwrap();
    assert!(read_episodes(&path).unwrap_err().to_string().contains("line 2"));
}

#[needs(shared)]
#[test]
fn the_real_manifest_has_the_counts_it_should_have() {
    let path = shared!("data/pointworld_droid/droid_paper_split_manifest.json");
    let manifest = PointWorldManifest::read(&path).unwrap();
    assert_eq!(
        (manifest.domain.as_str(), manifest.seed, manifest.test_fraction),
        ("droid", 42, 0.1)
    );
    assert_eq!((manifest.clips, manifest.episodes.len()), (51_040, 26_069));
    let labs = manifest.episodes_by_lab();
    assert_eq!(labs.len(), 13);
    assert_eq!((labs["ILIAD"], labs["PennPAL"]), (1189, 836));
    println!("test episodes by laboratory: {labs:?}");
}
