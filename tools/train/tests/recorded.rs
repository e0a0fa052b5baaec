//! Clips that were recorded are trained on as procedural ones are, and what cannot be trained on is named before the first
//! update.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

#[path = "support/losses.rs"]
mod losses;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use burn::tensor::Device;
use losses::NONE;
use rogs_needs::{needs, shared};
use rogs_r4c::{Record, write_record};
use rogs_schemas::key::{KeyMaterial, Provenance};
use rogs_train::config::{DataSettings, LossWeights};
use rogs_train::plan::ClipPlan;
use rogs_train::recorded::Recordings;
use rogs_train::records::Records;
use rogs_train::sample::Sample;
use rogs_train::sources::{FramesSettings, RecordedSettings};
use rogs_train::{Stage1Trainer, Stage1Training, Trainer};

fn data() -> DataSettings {
    DataSettings {
        size: [56, 98],
        source_times: [2, 2],
        queries: 3,
        images_per_step: 6,
        ..DataSettings::default()
    }
}

fn plan(seed: u64) -> ClipPlan {
    ClipPlan::evaluation(seed, &data())
}

fn save<T: Record>(path: &Path, record: &T) {
    let material = KeyMaterial {
        stage: "test".into(),
        stage_version: 1,
        schema: String::new(),
        params: "{}".into(),
        inputs: BTreeMap::new(),
    };
    let provenance = Provenance {
        material,
        input_content: BTreeMap::new(),
    };
    write_record(path, record, &provenance).unwrap();
}

/// A run of two clips, both as `change` leaves them.
fn run(root: &Path, change: impl Fn(&mut Records)) -> PathBuf {
    for (name, seed) in [("a", 3), ("b", 4)] {
        let folder = root.join("run/clips").join(name);
        std::fs::create_dir_all(&folder).unwrap();
        let mut records = plan(seed).records(&data()).unwrap();
        change(&mut records);
        save(&folder.join("clip.r4c"), &records.clip);
        save(&folder.join("robot.r4c"), &records.robot);
    }
    root.join("run")
}

fn settings(run: PathBuf) -> DataSettings {
    DataSettings {
        recorded: vec![RecordedSettings {
            run,
            share: 0.5,
            held_out: 0.5,
            mesh_depth: false,
        }],
        ..data()
    }
}

fn held_out(settings: &DataSettings) -> Sample {
    let mut samples = Recordings::open(settings).unwrap().held_out(settings, 1).unwrap();
    assert_eq!(samples.len(), 1);
    samples.remove(0).1
}

/// A recorded clip holds what the procedural one that it was recorded from holds, as far as recordings know it.
#[test]
fn a_clip_from_records_is_the_clip_that_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let settings = settings(run(folder.path(), |_| ()));
    Recordings::open(&settings).unwrap().check(14).unwrap();
    let (read, made) = (held_out(&settings), plan(4).sample(&data(), true).unwrap());
    assert_eq!(
        (&read.images, &read.views, read.size),
        (&made.images, &made.views, made.size)
    );
    assert_eq!((&read.depth_iu, &read.valid), (&made.depth_iu, &made.valid));
    assert_eq!(
        (&read.mesh_depth_iu, &read.support),
        (&made.mesh_depth_iu, &made.support)
    );
    assert_eq!(read.scale_cap_iu, made.scale_cap_iu);
    assert!(!read.still && made.still);
    assert_eq!(read.near_tool, made.near_tool);
    let held = |sample: &Sample| {
        sample
            .queries
            .iter()
            .flat_map(|query| query.held.clone())
            .collect::<Vec<_>>()
    };
    assert!(held(&read).iter().all(Option::is_some) && held(&read).len() == held(&made).len());
    for (a, b) in read.cameras.iter().zip(&made.cameras) {
        let (a, b) = (a.world_from_camera_iu, b.world_from_camera_iu);
        assert!(a.translation.abs_diff_eq(b.translation, 1e-5) && a.rotation.abs_diff_eq(b.rotation, 1e-6));
    }
    // Of pixels that tracks go through at other times than their own, these do not hit the centre.
    let (mut robot, mut tracked, mut close, mut moved) = (0, 0, 0, 0);
    let area = made.size[0] * made.size[1];
    for (a, b) in read.queries.iter().zip(&made.queries) {
        assert_eq!(a.time, b.time);
        for (a, b) in a.kappa.iter().zip(&b.kappa).chain(a.fk_slope.iter().zip(&b.fk_slope)) {
            assert!((a - b).abs() < 2e-4, "{a} {b}");
        }
        for place in (0..read.trackable.len()).filter(|&place| read.trackable[place] > 0.0) {
            let at = |axis: usize| (3 * (place / area) + axis) * area + place % area;
            let of = |query: &rogs_train::sample::Query| [0, 1, 2].map(|axis| query.displacement_iu[at(axis)]);
            let (a, b) = (of(a), of(b));
            let off = (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
            if read.robot[place] > 0.0 {
                assert!(off < 2e-4, "{off}");
                robot += 1;
            } else {
                tracked += 1;
                close += usize::from(off < 0.03);
            }
            moved += usize::from(b.iter().any(|value| value.abs() > 0.01));
        }
        assert_eq!(a.targets.len(), 6);
        for (a, b) in a.targets.iter().zip(&b.targets) {
            assert_eq!(
                (a.right, &a.rgb, &a.depth_iu, &a.valid),
                (b.right, &b.rgb, &b.depth_iu, &b.valid)
            );
        }
    }
    assert!(robot > 100 && tracked > 100 && moved > 100, "{robot} {tracked} {moved}");
    assert!(10 * close > 9 * tracked, "{close} of {tracked}");
}

#[test]
fn what_cannot_be_trained_on_is_named_before_the_first_update() {
    let refused = |change: fn(&mut Records)| {
        let folder = tempfile::tempdir().unwrap();
        let settings = Stage1Training {
            data: settings(run(folder.path(), change)),
            ..Stage1Training::default()
        };
        let error = Stage1Trainer::new(settings, &Device::flex())
            .map(|_| ())
            .unwrap_err()
            .to_string();
        assert!(error.contains("clip.r4c") && error.contains("clip `synth-"), "{error}");
        error
    };
    let error = refused(|records| {
        for camera in &mut records.clip.cameras {
            if let Some(depth) = &mut camera.depth {
                depth.depth_m.fill(f32::NAN);
            }
        }
    });
    assert!(
        error.contains("camera `wrist`") && error.contains("has no valid value"),
        "{error}"
    );
    let error = refused(|records| {
        if let Some(tracks) = &mut records.clip.tracks {
            tracks.position_m.fill(f32::NAN);
        }
    });
    assert!(error.contains("tracks are empty"), "{error}");
    let error = refused(|records| {
        records.clip.tracks = None;
        records.clip.cameras.iter_mut().for_each(|camera| camera.depth = None);
    });
    assert!(error.contains("neither reference depth nor tracks"), "{error}");
    let error = refused(|records| records.robot.clip_id = rogs_schemas::ClipId::made_of("another"));
    assert!(error.contains("another clip"), "{error}");
    let missing = settings(PathBuf::from("/nowhere"));
    assert!(
        Recordings::open(&missing)
            .unwrap_err()
            .to_string()
            .starts_with("/nowhere/clips")
    );
}

/// Where a clip has no depth, the mesh of its robot is one, if that is asked for; a clip that has depth keeps it.
#[test]
fn the_mesh_is_depth_where_there_is_no_other() {
    let without = |records: &mut Records| {
        records.clip.tracks = None;
        records.clip.cameras.iter_mut().for_each(|camera| camera.depth = None);
    };
    let asked = |folder: &Path, change: &dyn Fn(&mut Records)| {
        let mut settings = settings(run(folder, change));
        settings.recorded[0].mesh_depth = true;
        settings
    };
    let folder = tempfile::tempdir().unwrap();
    let settings_of_mesh = asked(folder.path(), &without);
    Recordings::open(&settings_of_mesh).unwrap().check(14).unwrap();
    let (read, made) = (held_out(&settings_of_mesh), plan(4).sample(&data(), true).unwrap());
    assert_eq!((&read.depth_iu, &read.valid), (&made.mesh_depth_iu, &made.support));
    let targets = |sample: &Sample| -> Vec<_> {
        let all = sample.queries.iter().flat_map(|query| query.targets.clone());
        all.collect()
    };
    for target in targets(&read) {
        assert_eq!(target.valid, target.support);
        let known = target.valid.iter().zip(&target.depth_iu);
        assert!(known.clone().all(|(&valid, &depth)| (valid > 0.0) == (depth > 0.0)));
    }
    assert!(targets(&read).iter().any(|target| target.valid.contains(&1.0)));
    let folder = tempfile::tempdir().unwrap();
    let with_depth = held_out(&asked(folder.path(), &|_| ()));
    assert_eq!((&with_depth.depth_iu, &with_depth.valid), (&made.depth_iu, &made.valid));
    let folder = tempfile::tempdir().unwrap();
    let unseen = asked(folder.path(), &|records| {
        without(records);
        records.robot.maps.iter_mut().for_each(|map| map.support.fill(0));
    });
    let error = Recordings::open(&unseen).unwrap().check(14).unwrap_err().to_string();
    assert!(error.contains("its robot is not in view"), "{error}");
}

/// Three frames of a room become a clip whose depth of one view is that of another.
#[needs(shared)]
#[test]
fn frames_of_a_room_are_a_clip_that_fits_together() {
    let settings = DataSettings {
        frames: vec![FramesSettings {
            folder: shared!("data/hololens_rooms"),
            share: 1.0,
            held_out: 0.34,
            scale: [0.4, 1.0],
            base_distance_m: [1.0, 6.0],
            base_height_m: [0.0, 0.9],
        }],
        ..data()
    };
    let rooms = Recordings::open(&settings).unwrap();
    let (mut off, mut names, mut novel) = (Vec::new(), Vec::new(), 0);
    for index in 0..6 {
        let sample = rooms
            .clip(&settings, (7, index), ([84, 154], 3), true)
            .unwrap()
            .unwrap();
        assert_eq!((sample.views.len(), sample.queries.len()), (3, 1));
        novel += sample.queries[0].targets.iter().filter(|target| target.right).count();
        names.push(sample.origin.clone());
        let area = 84 * 154;
        for pixel in (0..area).step_by(5).filter(|&pixel| sample.valid[pixel] > 0.0) {
            let (u, v) = (
                ((pixel % 154) as f64 + 0.5) / 154.0,
                ((pixel / 154) as f64 + 0.5) / 84.0,
            );
            let point = sample.cameras[0].point(u, v, f64::from(sample.depth_iu[pixel]));
            let ([u, v], depth) = sample.cameras[1].project(point);
            if depth <= 0.0 || !(0.0..1.0).contains(&u) || !(0.0..1.0).contains(&v) {
                continue;
            }
            let there = area + (v * 84.0) as usize * 154 + (u * 154.0) as usize;
            if sample.valid[there] > 0.0 {
                off.push((depth / f64::from(sample.depth_iu[there]) - 1.0).abs());
            }
        }
    }
    names.dedup();
    assert!(
        names.len() > 3 && novel > 3 && off.len() > 1000,
        "{names:?} {}",
        off.len()
    );
    off.sort_by(f64::total_cmp);
    assert!(off[off.len() / 2] < 0.03, "median {}", off[off.len() / 2]);
    // The held-out part comes later than all of them.
    let held_out = rooms.held_out(&settings, 3).unwrap();
    let number = |origin: &str| {
        origin
            .chars()
            .filter(char::is_ascii_digit)
            .collect::<String>()
            .parse::<u32>()
            .unwrap()
    };
    let first = held_out.iter().map(|(_, sample)| number(&sample.origin)).min().unwrap();
    assert!(held_out.len() == 3 && names.iter().all(|name| number(name) < first));
}

#[test]
fn an_update_takes_recorded_clips_among_procedural_ones() {
    let folder = tempfile::tempdir().unwrap();
    let settings = Stage1Training {
        steps: 2,
        evaluation_clips: 1,
        data: DataSettings {
            images_per_step: 24,
            queries: 1,
            ..settings(run(folder.path(), |_| ()))
        },
        losses: LossWeights {
            stereo: 1.0,
            track_head: 1.0,
            ..NONE
        },
        ..Stage1Training::default()
    };
    let mut trainer = Stage1Trainer::new(settings, &Device::flex()).unwrap();
    let batch = trainer.stream().unwrap().next_item().unwrap().unwrap();
    let recorded = batch
        .clips
        .iter()
        .filter(|clip| clip.origin.starts_with("clip `"))
        .count();
    assert!(
        recorded > 0 && recorded < batch.clips.len(),
        "{recorded} of {}",
        batch.clips.len()
    );
    let report = trainer.update(&batch).unwrap();
    assert!(report.loss.is_finite() && report.terms["stereo"] > 0.0);
}
