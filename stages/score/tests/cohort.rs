//! Cohort selection: the rules on made-up episodes, the real manifest where it is there.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use rogs_needs::{needs, shared};
use rogs_random::Pcg64;
use rogs_score::cohort::{
    CohortError, CohortOptions, EpisodeRecord, ExclusionReason, PointWorldManifest, differences, episode_of_key,
    read_episodes, select,
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
        unreadable: None,
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
        Some(&manifest),
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
    let first = select(&episodes, Some(&manifest), &options).unwrap();
    episodes.reverse();
    assert_eq!(first, select(&episodes, Some(&manifest), &options).unwrap());
    let text = serde_json::to_string(&first).unwrap();
    assert_eq!(
        serde_json::from_str::<rogs_score::cohort::Selection>(&text).unwrap(),
        first
    );
    assert!(text.contains("\"algorithm\":\"numpy-pcg64-permutation\""));
}

#[test]
fn what_a_list_cannot_tell_excludes_nobody_and_is_said() {
    let episodes: Vec<EpisodeRecord> = (0..5).map(episode).collect();
    let manifest = manifest(&episodes);
    let options = CohortOptions {
        source: "manifest".into(),
        not_checked: PointWorldManifest::says_nothing_of(),
        ..CohortOptions::default()
    };
    let selection = select(&manifest.as_list(), Some(&manifest), &options).unwrap();
    assert_eq!((selection.counts.eligible, selection.exclusions.len()), (5, 0));
    assert_eq!(selection.selected[0].clip_name, selection.selected[0].episode_id);
    let candidates = selection.candidates.unwrap();
    assert_eq!(candidates.source, "manifest");
    assert!(!candidates.not_checked.contains(&ExclusionReason::NotInTestManifest));
    assert_eq!(candidates.not_checked.len(), 7);
    // No manifest: everybody may be selected, and the file says that this was not asked.
    let free = select(&episodes, None, &CohortOptions::default()).unwrap();
    assert_eq!(
        free.candidates.unwrap().not_checked,
        [ExclusionReason::NotInTestManifest]
    );
    assert_eq!((free.counts.eligible, free.source_manifest), (5, None));
}

#[test]
fn an_episode_that_cannot_be_read_is_excluded_with_the_reason() {
    let mut episodes: Vec<EpisodeRecord> = (0..3).map(episode).collect();
    let manifest = manifest(&episodes);
    episodes[1].unreadable = Some("no gripper".into());
    episodes[1].frames = 0;
    let selection = select(&episodes, Some(&manifest), &CohortOptions::default()).unwrap();
    assert_eq!(selection.exclusion_counts[&ExclusionReason::Unreadable], 1);
    assert_eq!((selection.counts.cached, selection.counts.eligible), (2, 2));
    let candidates = selection.candidates.unwrap();
    assert_eq!(candidates.unreadable[&episodes[1].episode_id], "no gripper");
}

#[test]
fn selections_of_other_seeds_and_lists_are_told_apart() {
    let episodes: Vec<EpisodeRecord> = (0..30).map(episode).collect();
    let manifest = manifest(&episodes);
    let options = |seed| CohortOptions {
        take: 7,
        seed,
        ..CohortOptions::default()
    };
    let first = select(&episodes, Some(&manifest), &options(42)).unwrap();
    assert_eq!(differences(&first, &first), Vec::<String>::new());
    first.check().unwrap();
    let seed = select(&episodes, Some(&manifest), &options(7)).unwrap();
    let said = differences(&first, &seed).join("; ");
    assert!(said.starts_with("seed: 42, now 7; "), "{said}");
    let list = select(&episodes[..29], Some(&manifest), &options(42)).unwrap();
    let said = differences(&first, &list).join("; ");
    assert!(
        said.starts_with("episode list (SHA-256): ") && said.contains("eligible episodes: 30, now 29"),
        "{said}"
    );
    let mut edited = first.clone();
    edited.selected[0].clip_name = "another".into();
    assert!(edited.check().unwrap_err().contains("differ about `another`"));
    edited = first.clone();
    edited.schema_version = 3;
    assert!(edited.check().unwrap_err().contains("version is 3"));
}

#[test]
fn duplicates_are_refused() {
    let episodes = vec![episode(1), episode(1)];
    let result = select(&episodes, Some(&manifest(&episodes)), &CohortOptions::default());
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
