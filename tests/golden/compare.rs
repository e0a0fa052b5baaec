//! Comparing two containers stream by stream.

use std::fmt::Debug;
use std::path::Path;

use rogs_r4c::{Dtype, Reader, Record, StreamInfo, read_record};
use rogs_schemas::records::agreement::Agreements;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::field::Field;
use rogs_schemas::records::references::References;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::Scores;

/// How far values may lie apart on a machine whose instructions round otherwise. Integers are exact, but for `pixels`.
#[derive(Clone, Copy)]
pub(crate) struct Rule {
    /// Absolute tolerance, in the unit of the stream.
    absolute: f64,
    /// Tolerance as a share of the expected value.
    relative: f64,
    /// Steps of 255 by which a rendered colour may be off: a value beside the middle of two steps is rounded either way.
    pixels: u8,
}

impl Rule {
    const EXACT: Self = Self {
        absolute: 0.0,
        relative: 0.0,
        pixels: 0,
    };
    /// Resampled pixels and numbers read from text: no sum is long, nothing comes from the C library.
    pub(crate) const IMAGES: Self = Self {
        absolute: 1e-6,
        relative: 1e-6,
        pixels: 0,
    };
    /// Kinematics and meshes in f64, whose sines differ between C libraries in the last bit, stored as f32.
    pub(crate) const GEOMETRY: Self = Self {
        absolute: 1e-6,
        relative: 1e-6,
        pixels: 0,
    };
    /// Networks in f32: sums of some thousand products, in an order that depends on the width of the vectors, through some
    /// dozens of layers.
    pub(crate) const NETWORK: Self = Self {
        absolute: 1e-3,
        relative: 1e-3,
        pixels: 0,
    };
    /// Metrics over images in f32.
    pub(crate) const SCORES: Self = Self {
        absolute: 1e-4,
        relative: 1e-4,
        pixels: 1,
    };

    fn near(self, expected: f64, found: f64) -> bool {
        let close = (expected - found).abs() <= self.absolute + self.relative * expected.abs();
        close || expected.to_bits() == found.to_bits() || (expected.is_nan() && found.is_nan()) || expected == found
    }
}

/// Compares all that two files hold; `exact` asks for the same bits. Compression is not looked at.
///
/// # Errors
/// The first difference: where, what was expected, what was found.
pub(crate) fn compare(expected: &Path, found: &Path, rule: Rule, exact: bool) -> Result<(), String> {
    let open = |path: &Path| Reader::open(path).map_err(|error| error.to_string());
    let (ours, theirs) = (open(found)?, open(expected)?);
    let head = |reader: &Reader| (reader.header().schema, reader.header().version);
    equal("schema", &head(&theirs), &head(&ours))?;
    let (provenance, other) = (theirs.provenance(), ours.provenance());
    equal("stage", &provenance.material.stage, &other.material.stage)?;
    equal(
        "stage version",
        &provenance.material.stage_version,
        &other.material.stage_version,
    )?;
    equal("parameters", &provenance.material.params, &other.material.params)?;
    equal(
        "keys of the inputs",
        &provenance.material.inputs,
        &other.material.inputs,
    )?;
    equal(
        "contents of the inputs",
        &provenance.input_content,
        &other.input_content,
    )?;
    let names = |reader: &Reader| -> Vec<String> { reader.streams().iter().map(|info| info.name.clone()).collect() };
    equal("streams", &names(&theirs), &names(&ours))?;
    let mut structured = false;
    for (info, other) in theirs.streams().iter().zip(ours.streams()) {
        equal(&format!("description of `{}`", info.name), info, other)?;
        // Numbers inside a structured value are compared as numbers, below.
        if is_structured(info, &theirs) {
            let bytes = |reader: &Reader| reader.chunk_bytes(&info.name, 0).map_err(|error| error.to_string());
            structured |= bytes(&theirs)? != bytes(&ours)?;
            continue;
        }
        let chunks = |reader: &Reader| reader.chunks(&info.name).map_err(|error| error.to_string());
        let (chunks, other) = (chunks(&theirs)?, chunks(&ours)?);
        equal(&format!("chunks of `{}`", info.name), &chunks, &other)?;
        for (number, (coordinates, _)) in chunks.iter().enumerate() {
            let bytes = |reader: &Reader| {
                let bytes = reader.chunk_bytes(&info.name, number);
                bytes.map_err(|error| error.to_string())
            };
            let (expected, found) = (bytes(&theirs)?, bytes(&ours)?);
            if expected == found {
                continue;
            }
            let rule = (!exact).then_some(rule);
            if let Some(what) = first_difference(info, &expected, &found, rule) {
                return Err(format!("stream `{}`, chunk {coordinates:?}: {what}", info.name));
            }
        }
    }
    if !structured {
        return Ok(());
    }
    compare_records(expected, found, if exact { Rule::EXACT } else { rule })?;
    match exact {
        true => Err("the structured values differ in bits that do not print".to_owned()),
        false => Ok(()),
    }
}

/// A stream that holds one encoded value: the first ones of every record.
fn is_structured(info: &StreamInfo, reader: &Reader) -> bool {
    let values = match reader.header().schema.as_str() {
        "rogs.scores" => 3,
        "rogs.clip" => 2,
        _ => 1,
    };
    reader.streams()[..values].iter().any(|value| value.name == info.name)
}

fn equal<T: PartialEq + Debug>(what: &str, expected: &T, found: &T) -> Result<(), String> {
    if expected == found {
        return Ok(());
    }
    Err(format!("{what}: expected {expected:?}, found {found:?}"))
}

/// The first scalar of a chunk that is not as expected, within the rule if there is one.
fn first_difference(info: &StreamInfo, expected: &[u8], found: &[u8], rule: Option<Rule>) -> Option<String> {
    let size = info.dtype.size();
    let per_element = info.scalars().unwrap_or(1).max(1) as usize;
    let mut differing = expected
        .chunks_exact(size)
        .zip(found.chunks_exact(size))
        .enumerate()
        .filter(|(_, (expected, found))| differs(info, expected, found, rule));
    let (at, (expected, found)) = differing.next()?;
    let value = |bytes: &[u8]| scalar(info.dtype, bytes);
    Some(format!(
        "element {}, scalar {}: expected {:?}, found {:?}; {} more differ",
        at / per_element,
        at % per_element,
        value(expected),
        value(found),
        differing.count()
    ))
}

fn differs(info: &StreamInfo, expected: &[u8], found: &[u8], rule: Option<Rule>) -> bool {
    let Some(rule) = rule.filter(|_| expected != found) else {
        return expected != found;
    };
    match info.dtype {
        Dtype::F16 | Dtype::F32 | Dtype::F64 => !rule.near(scalar(info.dtype, expected), scalar(info.dtype, found)),
        Dtype::U8 if info.name == "rgb" => expected[0].abs_diff(found[0]) > rule.pixels,
        _ => true,
    }
}

fn scalar(dtype: Dtype, bytes: &[u8]) -> f64 {
    match dtype {
        Dtype::U8 => f64::from(bytes[0]),
        Dtype::U16 | Dtype::F16 => f64::from(u16::from_le_bytes(bytes.try_into().unwrap())),
        Dtype::U32 => f64::from(u32::from_le_bytes(bytes.try_into().unwrap())),
        Dtype::I32 => f64::from(i32::from_le_bytes(bytes.try_into().unwrap())),
        Dtype::F32 => f64::from(f32::from_le_bytes(bytes.try_into().unwrap())),
        Dtype::F64 => f64::from_le_bytes(bytes.try_into().unwrap()),
    }
}

/// Compares whole records by their text: words exactly, numbers within the rule.
fn compare_records(expected: &Path, found: &Path, rule: Rule) -> Result<(), String> {
    let text = |path: &Path| -> Result<String, String> {
        let schema = Reader::open(path).map_err(|error| error.to_string())?.header().schema;
        match schema.as_str() {
            "rogs.clip" => debug::<Clip>(path),
            "rogs.robot" => debug::<RobotMaps>(path),
            "rogs.conditioning" => debug::<Conditioning>(path),
            "rogs.references" => debug::<References>(path),
            "rogs.agreement" => debug::<Agreements>(path),
            "rogs.field" => debug::<Field>(path),
            "rogs.refinement" => debug::<Refinement>(path),
            "rogs.scores" => debug::<Scores>(path),
            _ => Err(format!("unknown schema `{schema}`")),
        }
    };
    let (expected, found) = (text(expected)?, text(found)?);
    let words = |text: &str| -> Vec<String> {
        let separators = |c: char| " ,()[]{}:\n".contains(c);
        let words = text.split(separators).filter(|word| !word.is_empty());
        words.map(str::to_owned).collect()
    };
    let (expected, found) = (words(&expected), words(&found));
    let numbers = |one: &str, other: &str| one.parse::<f64>().ok().zip(other.parse::<f64>().ok());
    let same = |one: &str, other: &str| one == other || numbers(one, other).is_some_and(|(a, b)| rule.near(a, b));
    match expected.iter().zip(&found).position(|(one, other)| !same(one, other)) {
        None => equal("length of the record", &expected.len(), &found.len()),
        Some(at) => Err(format!(
            "the record: after `{}` expected {}, found {}",
            expected[at.saturating_sub(12)..at].join(" "),
            expected[at],
            found[at]
        )),
    }
}

fn debug<T: Record + Debug>(path: &Path) -> Result<String, String> {
    let (record, _) = read_record::<T>(path).map_err(|error| error.to_string())?;
    Ok(format!("{record:?}"))
}
