//! Every record survives its container, twice with the same bytes, and contradictions are refused.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::Scratch;
use rogs_r4c::{Error, FieldFile, Reader, Record, inspect, read_header, read_record, verify, write_record};
use rogs_schemas::records::clip::{Clip, SourceView};
use rogs_schemas::records::field::Field;
use rogs_schemas::{CameraIndex, FrameIndex};

fn survives<T: Record + std::fmt::Debug>(name: &str, record: &T) {
    let scratch = Scratch::new(&format!("survives-{name}"));
    let provenance = common::provenance(name);
    let (one, two) = (scratch.file("one.r4c"), scratch.file("two.r4c"));
    let info = write_record(&one, record, &provenance).unwrap();
    let (back, read) = read_record::<T>(&one).unwrap();
    // Debug text, because NaN is not equal to itself.
    assert_eq!(format!("{back:?}"), format!("{record:?}"));
    assert_eq!(read, info);
    assert_eq!(read.provenance, provenance);
    write_record(&two, &back, &provenance).unwrap();
    assert_eq!(
        std::fs::read(&one).unwrap(),
        std::fs::read(&two).unwrap(),
        "the same bytes again"
    );
    let header = read_header(&one).unwrap();
    assert_eq!((header.key, &header.info), (provenance.key(), &info));
    assert_eq!(header.schema, T::SCHEMA.name);
    assert_eq!(verify(&one).unwrap(), header);
    assert_eq!(
        std::fs::read_dir(&scratch.0).unwrap().count(),
        2,
        "no temporary file stays"
    );
}

#[test]
fn every_record_survives() {
    survives("clip", &common::clip());
    survives("rollout", &common::rollout_clip());
    survives("robot", &common::robot());
    survives("conditioning", &common::conditioning());
    survives("references", &common::references());
    survives("agreement", &common::agreement());
    survives("field", &common::field());
    survives("refinement", &common::refinement());
    survives("scores", &common::scores());
}

#[test]
fn a_clip_without_optional_parts_survives() {
    let mut clip = common::clip();
    clip.tracks = None;
    clip.cameras.truncate(1);
    clip.cameras[0].recorded = None;
    clip.query_frames.clear();
    survives("bare-clip", &clip);
}

#[test]
fn another_schema_is_refused() {
    let scratch = Scratch::new("schema");
    let path = scratch.file("a.r4c");
    write_record(&path, &common::clip(), &common::provenance("clip")).unwrap();
    let error = read_record::<Field>(&path).unwrap_err();
    assert!(
        matches!(&error, Error::WrongKind { found, .. } if *found == Clip::SCHEMA.to_string()),
        "{error}"
    );
}

#[test]
fn contradictions_are_refused_on_writing() {
    let scratch = Scratch::new("contradictions");
    let path = scratch.file("a.r4c");
    let refused = |what: &str, change: &dyn Fn(&mut Clip)| {
        let mut clip = common::clip();
        change(&mut clip);
        let error = write_record(&path, &clip, &common::provenance("clip")).unwrap_err();
        assert!(matches!(&error, Error::Inconsistent { .. }), "{what}: {error}");
        assert!(error.to_string().contains(what), "{what}: {error}");
        assert!(!path.exists());
    };
    refused("rgb has", &|clip| {
        clip.cameras[0].recorded.as_mut().unwrap().pop();
    });
    refused("depth has", &|clip| {
        clip.cameras[1].depth.as_mut().unwrap().depth_m.push(0.0)
    });
    refused("query frames", &|clip| clip.query_frames = vec![FrameIndex(3)]);
    refused("source frames", &|clip| {
        clip.source_frames = [2, 0].map(FrameIndex).to_vec()
    });
    refused("anchor frame", &|clip| clip.anchor_frame = FrameIndex(3));
    refused("focal length", &|clip| clip.cameras[1].intrinsics.fx = 0.0);
    refused("joint positions", &|clip| clip.robot.positions.truncate(5));
    refused("a joint position", &|clip| clip.robot.positions[2] = f64::NAN);
    refused("partner", &|clip| clip.cameras[2].partner = Some(CameraIndex(2)));
    refused("trajectory", &|clip| {
        let rogs_schemas::records::clip::CameraMount::Trajectory { base_from_camera } = &mut clip.cameras[2].mount
        else {
            panic!("a trajectory")
        };
        base_from_camera.pop();
    });
    refused("track visibility", &|clip| clip.tracks.as_mut().unwrap().visible[0] = 2);
    refused("a track lies", &|clip| {
        clip.tracks.as_mut().unwrap().camera[0] = CameraIndex(9)
    });
}

#[test]
fn a_rollout_is_seen_generated_and_compared_with_what_was_recorded() {
    let clip = common::rollout_clip();
    let view = |camera: u32, frame: u32| SourceView {
        camera: CameraIndex(camera),
        frame: FrameIndex(frame),
    };
    let image =
        |images: &Option<Vec<u8>>, frame: usize| images.as_ref().unwrap()[frame * 45..(frame + 1) * 45].to_vec();
    for (camera, own) in clip.cameras.iter().enumerate().take(2) {
        for frame in 0..3 {
            let seen = clip.observation(view(camera as u32, frame as u32)).unwrap();
            assert_eq!(seen.rgb(), image(&own.generated, frame));
            assert_eq!(
                clip.target(CameraIndex(camera as u32), FrameIndex(frame as u32))
                    .unwrap()
                    .rgb(),
                image(&own.recorded, frame)
            );
        }
    }
    assert_eq!(clip.setting(), "rollout");
    let recorded = common::clip();
    let seen = recorded.observation(view(1, 2)).unwrap();
    assert_eq!(seen.rgb(), image(&recorded.cameras[1].recorded, 2));
    assert_eq!(recorded.setting(), "recorded");
    // Held-out cameras are never observed; frames and cameras beyond the clip are not there.
    let mut lit = common::clip();
    lit.cameras[2].recorded = lit.cameras[1].recorded.clone();
    assert!(lit.target(CameraIndex(2), FrameIndex(0)).is_some());
    assert_eq!(lit.observation(view(2, 0)), None);
    for (camera, frame) in [(1, 3), (1, u32::MAX), (9, 0)] {
        assert_eq!(lit.observation(view(camera, frame)), None);
        assert_eq!(lit.target(CameraIndex(camera), FrameIndex(frame)), None);
    }
}

#[test]
fn generated_images_belong_to_the_source_cameras_of_rollouts() {
    let scratch = Scratch::new("generated");
    let path = scratch.file("a.r4c");
    let refused = |what: &str, change: &dyn Fn(&mut Clip)| {
        let mut clip = common::rollout_clip();
        change(&mut clip);
        let error = write_record(&path, &clip, &common::provenance("clip")).unwrap_err();
        assert!(error.to_string().contains(what), "{what}: {error}");
    };
    refused("they alone, have generated images", &|clip| clip.rollout = None);
    refused("they alone, have generated images", &|clip| {
        clip.cameras[0].generated = None
    });
    refused("they alone, have generated images", &|clip| {
        clip.cameras[2].generated = clip.cameras[1].generated.clone();
    });
    refused("generated rgb has", &|clip| {
        clip.cameras[1].generated.as_mut().unwrap().pop();
    });
    refused("first-frame figures", &|clip| {
        clip.rollout.as_mut().unwrap().first_frame_psnr_db.pop();
    });
    refused("NaN", &|clip| {
        clip.rollout.as_mut().unwrap().first_frame_psnr_db[0] = Some(f64::NAN);
    });
}

#[test]
fn a_missing_file_is_an_error_of_the_system() {
    let error = read_header(std::path::Path::new("no-such-folder/no-such.r4c")).unwrap_err();
    assert!(matches!(error, Error::Io { action: "opening", .. }));
}

#[test]
fn one_chunk_is_read_without_the_others() {
    use rogs_r4c::{Codec, Dtype, Frame, StreamSpec, Unit};
    let scratch = Scratch::new("one-chunk");
    let path = scratch.file("a.r4c");
    let clip = common::clip();
    write_record(&path, &clip, &common::provenance("clip")).unwrap();
    let reader = Reader::open(&path).unwrap();
    let spec = StreamSpec {
        name: "rgb",
        dtype: Dtype::U8,
        unit: Unit::One,
        frame: Frame::None,
        codec: Codec::Zstd,
        fill: "",
    };
    let image = reader.read_chunk::<u8>(&spec, &[3, 5, 3], [1, 2, 0, 0]).unwrap();
    assert_eq!(image, clip.cameras[1].recorded.as_ref().unwrap()[2 * 45..]);
    assert!(
        reader.read_chunk::<u8>(&spec, &[3, 5, 3], [2, 0, 0, 0]).is_err(),
        "that camera has no images"
    );
    assert!(
        reader.read_chunk::<u8>(&spec, &[5, 3, 3], [1, 2, 0, 0]).is_err(),
        "another shape"
    );
    let metres = StreamSpec {
        unit: Unit::Metre,
        ..spec
    };
    assert!(
        reader.read_chunk::<u8>(&metres, &[3, 5, 3], [1, 2, 0, 0]).is_err(),
        "another unit"
    );
}

#[test]
fn inspect_tells_ranges_and_sizes() {
    let scratch = Scratch::new("inspect");
    let path = scratch.file("a.r4c");
    write_record(&path, &common::clip(), &common::provenance("clip")).unwrap();
    let report = inspect(&path).unwrap();
    let depth = report.streams.iter().find(|stream| stream.name == "depth_m").unwrap();
    assert_eq!((depth.nan, depth.totals.chunks, depth.totals.elements), (1, 3, 3));
    assert_eq!(depth.totals.decoded_bytes, 4 * 45);
    assert!(depth.min.unwrap() >= 0.0 && depth.max.unwrap() < 1.0);
    let json = serde_json::to_value(&report).unwrap();
    assert_eq!(json["schema"], "rogs.clip");
    assert_eq!(json["provenance"]["material"]["stage"], "clip");
    let streams = json["streams"].as_array().unwrap();
    let depth_json = streams.iter().find(|stream| stream["name"] == "depth_m").unwrap();
    assert_eq!(depth_json["unit"], "metre");
    assert_eq!(depth_json["stored_bytes"].as_u64().unwrap(), depth.totals.stored_bytes);
}

#[test]
fn a_field_is_read_time_by_time() {
    let field = common::field();
    let scratch = Scratch::new("field-by-time");
    let path = scratch.file("field.r4c");
    write_record(&path, &field, &common::provenance("lift")).unwrap();
    let file = FieldFile::open(&path).unwrap();
    let times: Vec<f64> = field.slices.iter().map(|slice| slice.time).collect();
    assert_eq!(file.times(), times);
    let mut put_together = file.base().unwrap();
    put_together.slices = (0..times.len()).map(|index| file.slice(index).unwrap()).collect();
    put_together.query_state.clone_from(&field.query_state);
    assert_eq!(format!("{put_together:?}"), format!("{field:?}"));
    assert!(
        file.slice(times.len())
            .unwrap_err()
            .to_string()
            .contains("no stored time")
    );
    let bytes = Reader::open(&path).unwrap().stream_bytes("position_m").unwrap();
    assert_eq!(bytes.len(), 4 * field.position_m.len());
    assert_eq!(bytes[..4], field.position_m[0].to_le_bytes());
}
