//! Clips of wide worlds: any number of cameras and any size, anchors where the recorded camera has the robot.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

use burn::tensor::Device;
use rogs_random::Pcg64;
use rogs_stage1::{Stage1Config, seeded};
use rogs_synth::{CalibrationRanges, Layouts, World};
use rogs_tensors::parameters::to_host;
use rogs_train::config::{DataSettings, SizeShare};
use rogs_train::plan::ClipPlan;
use rogs_train::stage1::forward::{Heads, lift};
use rogs_train::stream::batches;
use rogs_train::{Stage1Trainer, Stage1Training};

fn wide(calibration: CalibrationRanges) -> DataSettings {
    DataSettings {
        size: [56, 98],
        queries: 1,
        world: Some(World {
            share: 1.0,
            layouts: Layouts {
                cell: 1.0,
                near: 1.0,
                ring: 1.0,
                room: 0.0,
            },
            calibration,
            ..World::default()
        }),
        ..DataSettings::default()
    }
}

const EXACT: CalibrationRanges = CalibrationRanges {
    share: 0.0,
    external_m: 0.0,
    external_deg: 0.0,
    wrist_m: 0.0,
    wrist_deg: 0.0,
    focal: 0.0,
};

/// Share of supported pixels whose mesh depth is that of the picture within 1 %.
fn agreement(data: &DataSettings) -> f64 {
    let (mut same, mut all) = (0, 0);
    for seed in 0..8 {
        let plan = ClipPlan::draw(60_000_000 + seed, 2, data, &mut Pcg64::from_seed(seed));
        let sample = plan.sample(data, false).unwrap();
        for (mesh, depth) in sample.mesh_depth_iu.iter().zip(&sample.depth_iu) {
            if *mesh > 0.0 && *depth > 0.0 {
                all += 1;
                same += usize::from((mesh / depth - 1.0).abs() < 0.01);
            }
        }
    }
    assert!(all > 2000, "{all}");
    f64::from(same as u32) / f64::from(all)
}

#[test]
fn the_mesh_lies_where_the_recorded_camera_has_it() {
    assert_eq!(agreement(&wide(EXACT)), 1.0);
    let wrong = agreement(&wide(CalibrationRanges {
        share: 1.0,
        external_m: 0.03,
        external_deg: 4.0,
        ..EXACT
    }));
    assert!(wrong < 0.9, "{wrong}");
}

#[test]
fn clips_of_one_to_four_cameras_and_of_two_sizes_are_lifted() {
    let data = wide(CalibrationRanges::default());
    let network = seeded::network(&Stage1Config::compact_sweep(), 5, &Device::flex()).unwrap();
    for (count, size) in [(1, [56, 98]), (2, [28, 42]), (3, [56, 98]), (4, [28, 42])] {
        let mut random = Pcg64::from_seed(u64::from(count));
        let plan = ClipPlan {
            size,
            ..ClipPlan::draw(60_000_100, 1, &data, &mut random).with_cameras(count, &mut random)
        };
        let sample = plan.sample(&data, true).unwrap();
        assert_eq!(
            (sample.views.len(), sample.size),
            (count as usize, size.map(|side| side as usize))
        );
        let targets = &sample.queries[0].targets;
        let held_out = targets.iter().position(|target| target.right).unwrap();
        assert_eq!((held_out, targets.len()), (count as usize, 6));
        let lifted = lift(&network, &sample, true, Heads::All).unwrap();
        assert_eq!(lifted.sweep.is_some(), count > 1);
        assert!(to_host(lifted.depth).unwrap().iter().all(|depth| depth.is_finite()));
    }
}

#[test]
fn a_share_of_updates_has_the_other_size_and_no_more_pixels() {
    let settings = Stage1Training {
        steps: 12,
        data: DataSettings {
            size: [28, 42],
            more_sizes: vec![SizeShare {
                size: [42, 70],
                share: 0.5,
            }],
            source_times: [1, 3],
            source_cameras: [1, 4],
            queries: 1,
            images_per_step: 12,
            ..DataSettings::default()
        },
        ..Stage1Training::default()
    };
    let mut stream = batches(&settings, 0);
    let (mut large, mut cameras) = (0, Vec::new());
    for _ in 0..12 {
        let batch = stream.next_item().unwrap().unwrap();
        let size = batch.clips[0].size;
        assert!(batch.clips.iter().all(|clip| clip.size == size));
        large += usize::from(size == [42, 70]);
        let pixels: usize = batch
            .clips
            .iter()
            .map(|clip| clip.views.len() * size[0] * size[1])
            .sum();
        assert!(pixels <= 12 * 28 * 42, "{pixels}");
        let times = batch.clips[0]
            .views
            .iter()
            .filter(|view| view.0 == batch.clips[0].views[0].0)
            .count();
        cameras.push(batch.clips[0].views.len() / times);
    }
    assert!((2..=10).contains(&large), "{large}");
    assert!(cameras.contains(&1) && cameras.contains(&4), "{cameras:?}");
}

#[test]
fn nonsense_is_refused_by_name() {
    let refused = |change: fn(&mut DataSettings)| {
        let mut settings = Stage1Training::default();
        change(&mut settings.data);
        Stage1Trainer::new(settings, &Device::flex())
            .map(|_| ())
            .unwrap_err()
            .to_string()
    };
    let error = refused(|data| {
        data.world = Some(World {
            photos: 2.0,
            ..World::default()
        });
    });
    assert!(error.contains("world.photos"), "{error}");
    assert!(refused(|data| data.props = Some("/nowhere".into())).contains("[data.world]"));
    let error = refused(|data| {
        data.world = Some(World::default());
        data.props = Some("/nowhere".into());
    });
    assert!(error.contains("/nowhere") && error.contains("fetch.py"), "{error}");
    let more = |data: &mut DataSettings| {
        data.more_sizes = vec![SizeShare {
            size: [30, 42],
            share: 0.5,
        }];
    };
    assert!(refused(more).contains("multiple of the patch side"));
    assert!(refused(|data| data.source_cameras = [0, 3]).contains("data.source_cameras"));
}
