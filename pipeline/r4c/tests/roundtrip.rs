//! Random containers survive, with the same bytes every time and for any number of threads.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod common;

use common::Scratch;
use proptest::prelude::*;
use rogs_r4c::{Chunk, Codec, Dtype, Element, Frame, Reader, StreamSpec, Unit, Writer, verify};
use rogs_schemas::SchemaId;

const SCHEMA: SchemaId = SchemaId {
    name: "test.random",
    major: 1,
    minor: 0,
};

#[derive(Debug, Clone)]
struct Stream<T> {
    codec: Codec,
    shape: Vec<u32>,
    /// Element counts of the chunks, and their values.
    chunks: Vec<Vec<T>>,
}

fn streams<T: Element + std::fmt::Debug>(
    value: BoxedStrategy<T>,
    codecs: &'static [Codec],
) -> impl Strategy<Value = Stream<T>> {
    let shape = prop::collection::vec(0u32..4, 0..4);
    (
        prop::sample::select(codecs),
        shape,
        prop::collection::vec(0usize..40, 0..5),
    )
        .prop_flat_map(move |(codec, shape, counts)| {
            let element: usize = shape.iter().map(|&dim| dim as usize).product();
            let chunk = |count: usize| prop::collection::vec(value.clone(), count * element);
            let chunks: Vec<_> = counts.into_iter().map(chunk).collect();
            (Just(codec), Just(shape), chunks).prop_map(|(codec, shape, chunks)| Stream { codec, shape, chunks })
        })
}

const FLOATS: &[Codec] = &[Codec::Raw, Codec::Zstd, Codec::ShuffleZstd, Codec::PlanesZstd];
const INTEGERS: &[Codec] = &[
    Codec::Raw,
    Codec::Zstd,
    Codec::ShuffleZstd,
    Codec::DeltaShuffleZstd,
    Codec::PlanesZstd,
];

/// All bit patterns, and values that repeat.
fn bits32() -> BoxedStrategy<u32> {
    prop_oneof![any::<u32>(), 0u32..3, Just(0x7f80_0001), Just(0xffff_ffff)].boxed()
}

fn spec(name: &'static str, dtype: Dtype, codec: Codec) -> StreamSpec {
    StreamSpec {
        name,
        dtype,
        unit: Unit::Metre,
        frame: Frame::RobotBase,
        codec,
        fill: "",
    }
}

fn add<T: Element>(writer: &mut Writer, name: &'static str, stream: &Stream<T>) {
    let chunks: Vec<Chunk<'_, T>> = stream
        .chunks
        .iter()
        .zip(0..)
        .map(|(part, at)| ([at, 0, 7, 0], part.as_slice()))
        .collect();
    writer
        .stream(&spec(name, T::DTYPE, stream.codec), &stream.shape, &chunks)
        .unwrap();
}

fn check<T: Element + std::fmt::Debug>(reader: &Reader, name: &'static str, stream: &Stream<T>, canonical: fn(T) -> T) {
    let spec = spec(name, T::DTYPE, stream.codec);
    let bytes = |values: &[T]| bytemuck::cast_slice::<T, u8>(values).to_vec();
    let expected: Vec<T> = stream.chunks.iter().flatten().map(|&value| canonical(value)).collect();
    assert_eq!(bytes(&reader.stream(&spec, &stream.shape).unwrap()), bytes(&expected));
    for (part, at) in stream.chunks.iter().zip(0..) {
        let expected: Vec<T> = part.iter().map(|&value| canonical(value)).collect();
        assert_eq!(
            bytes(&reader.read_chunk(&spec, &stream.shape, [at, 0, 7, 0]).unwrap()),
            bytes(&expected)
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn random_containers_survive(
        one in streams(bits32().prop_map(f32::from_bits).boxed(), FLOATS),
        two in streams(any::<u64>().prop_map(f64::from_bits).boxed(), FLOATS),
        three in streams(any::<u8>().boxed(), INTEGERS),
        four in streams(bits32(), INTEGERS),
        five in streams(any::<u16>().boxed(), INTEGERS),
        six in streams(any::<i32>().boxed(), INTEGERS),
    ) {
        let scratch = Scratch::new("roundtrip");
        let write = |name: &str, threads: usize| {
            let path = scratch.file(name);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let content = pool.install(|| {
                let mut writer = Writer::new(SCHEMA, &common::provenance("random"));
                add(&mut writer, "one", &one);
                add(&mut writer, "two", &two);
                add(&mut writer, "three", &three);
                add(&mut writer, "four", &four);
                add(&mut writer, "five", &five);
                add(&mut writer, "six", &six);
                writer.commit(&path).unwrap()
            });
            (path, content)
        };
        let (path, content) = write("a.r4c", 1);
        let (again, _) = write("b.r4c", 3);
        prop_assert_eq!(std::fs::read(&path).unwrap(), std::fs::read(&again).unwrap());
        prop_assert_eq!(verify(&path).unwrap().info.content, content);
        let reader = Reader::open(&path).unwrap();
        check(&reader, "one", &one, |value| if value.is_nan() { f32::from_bits(0x7fc0_0000) } else { value });
        check(&reader, "two", &two, |value| if value.is_nan() { f64::from_bits(0x7ff8 << 48) } else { value });
        check(&reader, "three", &three, |value| value);
        check(&reader, "four", &four, |value| value);
        check(&reader, "five", &five, |value| value);
        check(&reader, "six", &six, |value| value);
    }
}

#[test]
fn impossible_streams_are_refused() {
    let mut writer = Writer::new(SCHEMA, &common::provenance("random"));
    let values = [1.0f32; 6];
    let chunk = [([0; 4], &values[..])];
    let good = spec("good", Dtype::F32, Codec::ShuffleZstd);
    assert!(
        writer.stream(&good, &[4], &chunk).is_err(),
        "six values are not whole elements of four"
    );
    assert!(
        writer
            .stream(&spec("good", Dtype::F64, Codec::Raw), &[], &chunk)
            .is_err(),
        "another type"
    );
    assert!(
        writer
            .stream(&spec("delta", Dtype::F32, Codec::DeltaShuffleZstd), &[], &chunk)
            .is_err(),
        "differences of floats"
    );
    assert!(
        writer
            .stream(&spec("a b", Dtype::F32, Codec::Raw), &[], &chunk)
            .is_err(),
        "a space in the name"
    );
    assert!(
        writer.stream(&good, &[1, 1, 1, 1, 1], &chunk).is_err(),
        "five dimensions"
    );
    assert!(
        writer.stream(&good, &[u32::MAX, u32::MAX, 4], &chunk).is_err(),
        "an element that is too large"
    );
    writer.stream(&good, &[3], &chunk).unwrap();
    assert!(writer.stream(&good, &[3], &chunk).is_err(), "the same name twice");
}
