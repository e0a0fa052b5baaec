//! No damage goes unnoticed and none is a panic (`docs/spec/r4c.md` section 4).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod common;
mod forge;

use std::fmt::Debug;
use std::path::Path;

use common::Scratch;
use forge::{CODEC, COORDINATES, DECODED, ELEMENTS, FLAGS, HASH, OFFSET, Parts, RESERVED, STORED, set};
use rogs_r4c::{
    Codec, Dtype, Frame, Limits, Reader, Record, StreamSpec, Unit, Writer, inspect, read_header, read_record, verify,
    write_record,
};
use rogs_schemas::SchemaId;
use rogs_schemas::records::agreement::Agreements;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::motion_bases::MotionBasisField;
use rogs_schemas::records::polynomial::PolynomialField;
use rogs_schemas::records::progress::Progress;
use rogs_schemas::records::references::References;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::Scores;

fn written<T: Record>(path: &Path, record: &T) -> Vec<u8> {
    write_record(path, record, &common::provenance("test")).unwrap();
    std::fs::read(path).unwrap()
}

/// Every byte with one flipped bit (all eight when `every_bit`): an error, from the record and from `verify`.
fn flips_are_noticed<T: Record + Debug + Sync>(name: &str, record: &T, every_bit: bool) {
    // In a pool of one thread, so that a small file costs no hand-over between threads.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    pool.install(|| flip(name, record, every_bit));
}

fn flip<T: Record + Debug>(name: &str, record: &T, every_bit: bool) {
    let scratch = Scratch::new(&format!("flip-{name}"));
    let path = scratch.file("a.r4c");
    let mut bytes = written(&path, record);
    for at in 0..bytes.len() {
        for bit in 0..8 {
            if !every_bit && bit != at % 8 {
                continue;
            }
            bytes[at] ^= 1 << bit;
            std::fs::write(&path, &bytes).unwrap();
            let read = read_record::<T>(&path);
            assert!(read.is_err(), "{name}: bit {bit} of byte {at} went unnoticed");
            if bit == at % 8 {
                assert!(
                    verify(&path).is_err(),
                    "{name}: `verify` did not notice bit {bit} of byte {at}"
                );
            }
            bytes[at] ^= 1 << bit;
        }
    }
}

#[test]
fn every_flipped_bit_is_noticed() {
    flips_are_noticed("conditioning", &common::conditioning(), true);
}

#[test]
fn a_flipped_bit_of_every_byte_is_noticed_in_every_record() {
    flips_are_noticed::<Clip>("clip", &common::clip(), false);
    flips_are_noticed::<RobotMaps>("robot", &common::robot(), false);
    flips_are_noticed::<References>("references", &common::references(), false);
    flips_are_noticed::<Agreements>("agreement", &common::agreement(), false);
    flips_are_noticed::<PolynomialField>("polynomial", &common::polynomial(), false);
    flips_are_noticed::<MotionBasisField>("motion-bases", &common::motion_bases(), false);
    flips_are_noticed::<Progress>("progress", &common::progress(), false);
    flips_are_noticed::<Refinement>("refinement", &common::refinement(), false);
    flips_are_noticed::<Scores>("scores", &common::scores(), false);
    let mut field = common::field();
    field.slices.truncate(1);
    flips_are_noticed::<Field>("field", &field, false);
}

#[test]
fn every_truncation_and_appended_junk_are_noticed() {
    let scratch = Scratch::new("truncate");
    let path = scratch.file("a.r4c");
    let bytes = written(&path, &common::conditioning());
    for length in 0..bytes.len() {
        std::fs::write(&path, &bytes[..length]).unwrap();
        assert!(read_header(&path).is_err(), "cut to {length} bytes");
    }
    for junk in [&[0u8][..], b"C4R.", &bytes] {
        std::fs::write(&path, [&bytes, junk].concat()).unwrap();
        assert!(read_header(&path).is_err(), "{} bytes appended", junk.len());
    }
    std::fs::write(&path, [&[0; 8], &bytes[..]].concat()).unwrap();
    assert!(read_header(&path).is_err(), "bytes in front");
}

#[test]
fn footers_of_other_files_do_not_fit() {
    let scratch = Scratch::new("footers");
    let path = scratch.file("a.r4c");
    let one = written(&path, &common::conditioning());
    let mut other = common::conditioning();
    other.view_maps[0].depth_m[0] = 0.75;
    let two = written(&path, &other);
    let swapped = [&one[..one.len() - 64], &two[two.len() - 64..]].concat();
    std::fs::write(&path, swapped).unwrap();
    assert!(read_record::<Conditioning>(&path).is_err());
}

#[test]
fn forged_indices_are_refused() {
    let scratch = Scratch::new("forged");
    let path = scratch.file("a.r4c");
    let parts = Parts::of(&written(&path, &common::conditioning()));
    assert!(parts.entries() >= 6);
    let refused = |what: &str, change: &dyn Fn(&mut Parts)| {
        let mut changed = parts.clone();
        change(&mut changed);
        std::fs::write(&path, changed.file()).unwrap();
        let error = read_record::<Conditioning>(&path).expect_err(what).to_string();
        assert!(error.contains("a.r4c"), "{what}: {error}");
    };
    std::fs::write(&path, parts.file()).unwrap();
    read_record::<Conditioning>(&path).expect("putting the parts together changes nothing");

    let u32s = |value: u32| value.to_le_bytes();
    refused("an entry twice", &|parts| {
        let copy = parts.entry(1).to_vec();
        parts.entry(2).copy_from_slice(&copy);
    });
    refused("two entries traded", &|parts| {
        let (one, two) = (parts.entry(1).to_vec(), parts.entry(2).to_vec());
        parts.entry(1).copy_from_slice(&two);
        parts.entry(2).copy_from_slice(&one);
    });
    refused("an entry missing", &|parts| {
        let count = parts.entries() as u64 - 1;
        parts.index.drain(72..136);
        parts.index[..8].copy_from_slice(&count.to_le_bytes());
    });
    refused("a count beyond the index", &|parts| {
        parts.index[..8].copy_from_slice(&(1u64 << 40).to_le_bytes())
    });
    refused("an offset near 2^64", &|parts| {
        set(parts.entry(0), OFFSET, &(u64::MAX - 8).to_le_bytes())
    });
    refused("an offset in the prologue", &|parts| {
        set(parts.entry(0), OFFSET, &0u64.to_le_bytes())
    });
    refused("a stored length beyond the file", &|parts| {
        set(parts.entry(0), STORED, &u32s(u32::MAX))
    });
    refused("a bomb", &|parts| {
        set(parts.entry(0), DECODED, &u32s(u32::MAX));
        set(parts.entry(0), ELEMENTS, &u32s(u32::MAX));
    });
    refused("a bomb below the chunk limit", &|parts| {
        set(parts.entry(0), DECODED, &u32s(200 << 20));
        set(parts.entry(0), ELEMENTS, &u32s(200 << 20));
    });
    refused("elements that do not fit", &|parts| {
        set(parts.entry(0), ELEMENTS, &u32s(3))
    });
    refused("an unknown codec", &|parts| {
        set(parts.entry(0), CODEC, &9u16.to_le_bytes())
    });
    refused("another codec", &|parts| {
        set(parts.entry(0), CODEC, &2u16.to_le_bytes())
    });
    refused("an unknown flag", &|parts| {
        set(parts.entry(0), FLAGS, &2u16.to_le_bytes())
    });
    refused("a constant that is none", &|parts| {
        set(parts.entry(0), FLAGS, &1u16.to_le_bytes())
    });
    refused("a reserved field", &|parts| set(parts.entry(0), RESERVED, &u32s(1)));
    refused("another stream", &|parts| set(parts.entry(0), 0, &u32s(77)));
    refused("another content", &|parts| {
        // Two chunks of a stream trade their bytes with checksums that fit: only the values can tell.
        let last = parts.chunks.len() - 1;
        parts.chunks[last] ^= 1;
    });
}

#[test]
fn traded_coordinates_change_the_content_hash() {
    let scratch = Scratch::new("coordinates");
    let path = scratch.file("a.r4c");
    let mut parts = Parts::of(&written(&path, &common::conditioning()));
    let last = parts.entries() - 1;
    set(parts.entry(last), COORDINATES, &7u32.to_le_bytes());
    std::fs::write(&path, parts.file()).unwrap();
    assert!(verify(&path).unwrap_err().to_string().contains("content hash"));
}

#[test]
fn forged_prologues_are_refused() {
    let scratch = Scratch::new("prologue");
    let path = scratch.file("a.r4c");
    let parts = Parts::of(&written(&path, &common::conditioning()));
    let refused = |at: usize, value: u8, message: &str| {
        let mut changed = parts.clone();
        changed.prologue[at] = value;
        std::fs::write(&path, changed.file()).unwrap();
        let error = read_record::<Conditioning>(&path).unwrap_err().to_string();
        assert!(error.contains(message), "byte {at}: {error}");
    };
    refused(8, 2, "a newer program wrote it");
    refused(12, 2, "required features");
    refused(12, 0, "features that the prologue announces");
    refused(20, 0xaa, "schema id");
    refused(32, 9, "rogs.conditioning 9.0");
    refused(36, 1, "reserved");
    refused(40, 0xaa, "has key");
    let mut newer = parts.clone();
    newer.prologue[10] = 9;
    newer.prologue[34] = 9;
    std::fs::write(&path, newer.file()).unwrap();
    read_record::<Conditioning>(&path).expect("newer additive versions are read");
}

#[test]
fn index_frames_must_say_their_size() {
    let scratch = Scratch::new("frames");
    let path = scratch.file("a.r4c");
    let parts = Parts::of(&written(&path, &common::conditioning()));
    let length = parts.index.len() as u32;
    let silent = |bytes: &[u8]| {
        let mut compressor = zstd::bulk::Compressor::new(3).unwrap();
        compressor.include_contentsize(false).unwrap();
        compressor.compress(bytes).unwrap()
    };
    std::fs::write(&path, parts.file_with(silent, length)).unwrap();
    assert!(read_header(&path).unwrap_err().to_string().contains("announces"));
    let doubled = |bytes: &[u8]| {
        let one = zstd::bulk::compress(bytes, 3).unwrap();
        [one.clone(), one].concat()
    };
    std::fs::write(&path, parts.file_with(doubled, length)).unwrap();
    assert!(read_header(&path).unwrap_err().to_string().contains("frame ends"));
    let plain = |bytes: &[u8]| zstd::bulk::compress(bytes, 3).unwrap();
    std::fs::write(&path, parts.file_with(plain, length - 1)).unwrap();
    assert!(read_header(&path).is_err());
    std::fs::write(&path, parts.file_with(plain, u32::MAX)).unwrap();
    assert!(read_header(&path).unwrap_err().to_string().contains("larger than"));
}

#[test]
fn values_out_of_range_are_refused_although_every_checksum_fits() {
    // The value is changed and written by the container alone, without the checks of the record.
    const SCHEMA: SchemaId = Conditioning::SCHEMA;
    let scratch = Scratch::new("values");
    let path = scratch.file("a.r4c");
    let good = written(&path, &common::conditioning());
    let head = Parts::of(&good);
    let value: Vec<u8> = {
        let spec = spec("conditioning", Dtype::U8, Codec::Zstd);
        Reader::open(&path).unwrap().stream(&spec, &[]).unwrap()
    };
    assert!(!head.chunks.is_empty());
    let mut writer = Writer::new(SCHEMA, &common::provenance("test"));
    let whole = |bytes: &[u8]| ([0; 4], bytes.to_vec());
    let (at, bytes) = whole(&value);
    writer
        .stream(
            &spec("conditioning", Dtype::U8, Codec::Zstd),
            &[],
            &[(at, bytes.as_slice())],
        )
        .unwrap();
    // Pixel 99 of an image of 15 pixels.
    writer
        .stream(
            &spec("pixels", Dtype::U32, Codec::DeltaShuffleZstd),
            &[],
            &[([0; 4], &[0u32, 3, 4, 99][..])],
        )
        .unwrap();
    writer
        .stream(&spec("link", Dtype::U8, Codec::Zstd), &[], &[([0; 4], &[1u8; 4][..])])
        .unwrap();
    let depth = StreamSpec {
        unit: Unit::Metre,
        frame: Frame::Camera,
        ..spec("mesh_depth_m", Dtype::F32, Codec::PlanesZstd)
    };
    writer.stream(&depth, &[], &[([0; 4], &[1.0f32; 4][..])]).unwrap();
    let displacement = StreamSpec {
        unit: Unit::InternalUnit,
        frame: Frame::Recon,
        ..spec("displacement_iu", Dtype::F32, Codec::PlanesZstd)
    };
    writer
        .stream(&displacement, &[3], &[([0; 4], &[0.5f32; 24][..])])
        .unwrap();
    writer.commit(&path).unwrap();
    verify(&path).expect("the container is whole");
    let error = read_record::<Conditioning>(&path).unwrap_err().to_string();
    assert!(error.contains("view 0: pixels do not ascend below 15"), "{error}");
}

#[test]
fn a_file_may_not_decode_to_more_than_the_caller_allows() {
    let scratch = Scratch::new("budget");
    let path = scratch.file("a.r4c");
    written(&path, &common::clip());
    let error = Reader::open_with(
        &path,
        Limits {
            decoded: 100,
            ..Limits::default()
        },
    )
    .unwrap_err()
    .to_string();
    assert!(error.contains("limit of 100 bytes"), "{error}");
    assert!(
        Reader::open_with(
            &path,
            Limits {
                file: 100,
                ..Limits::default()
            }
        )
        .is_err()
    );
}

#[test]
fn random_files_are_errors() {
    let scratch = Scratch::new("random");
    let path = scratch.file("a.r4c");
    let good = written(&path, &common::conditioning());
    for seed in 0..300u64 {
        let length = (seed as usize * 7) % 600;
        let mut bytes = common::small_bytes(seed, length, 256.0);
        // Half of them with edges that look right.
        if seed % 2 == 0 && length >= 128 {
            bytes[..64].copy_from_slice(&good[..64]);
            bytes[length - 64..].copy_from_slice(&good[good.len() - 64..]);
        }
        std::fs::write(&path, &bytes).unwrap();
        assert!(read_header(&path).is_err());
        assert!(inspect(&path).is_err());
    }
}

#[test]
fn constant_chunks_of_a_damaged_scalar_are_noticed() {
    let scratch = Scratch::new("constant");
    let path = scratch.file("a.r4c");
    let mut writer = Writer::new(
        SchemaId {
            name: "test",
            major: 1,
            minor: 0,
        },
        &common::provenance("test"),
    );
    writer
        .stream(
            &spec("zeros", Dtype::F32, Codec::PlanesZstd),
            &[],
            &[([0; 4], &[0.0f32; 1000][..])],
        )
        .unwrap();
    writer.commit(&path).unwrap();
    let mut parts = Parts::of(&std::fs::read(&path).unwrap());
    assert_eq!(parts.chunks.len(), 8, "one scalar and its padding");
    // Another scalar with its own checksum: the decoded bytes tell.
    parts.chunks[0] = 1;
    let hash = xxhash_rust::xxh3::xxh3_64(&parts.chunks[..4]);
    set(parts.entry(0), HASH, &hash.to_le_bytes());
    std::fs::write(&path, parts.file()).unwrap();
    assert!(verify(&path).unwrap_err().to_string().contains("decoded bytes"));
}

fn spec(name: &'static str, dtype: Dtype, codec: Codec) -> StreamSpec {
    StreamSpec {
        name,
        dtype,
        unit: Unit::One,
        frame: Frame::None,
        codec,
        fill: "",
    }
}
