//! Compressed 3DGS PLY files, as SuperSplat and splat-transform write them (`docs/spec/r4c.md` section 6).
//!
//! Gaussians come in chunks of 256. `element chunk` holds the range of centres, logarithms of scales and colours of each;
//! `element vertex` four `uint`: `packed_position` and `packed_scale` (11, 10 and 11 bits of x, y, z in the range of the
//! chunk), `packed_rotation` (2 bits for which of w, x, y, z is largest, 10 for each other, in +-1/sqrt 2),
//! `packed_color` (8 bits each of red, green, blue in the range of the chunk, and opacity). Harmonics above degree 0 lie in
//! an `element sh`, a byte each, in +-4.

use std::io::Write;
use std::path::Path;

use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, Gaussians, sh};

use crate::error::{Error, Result};
use crate::ply_header::{MAX_HEADER, wrong};
use crate::ply_scene::PlyScene;

/// Gaussians of a chunk.
const CHUNK: usize = 256;
/// Names of the ranges of a chunk, lowest and highest, in the order in which they are written.
const RANGES: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];
/// The packed numbers of a Gaussian.
const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
/// Harmonics above degree 0 are in plus and minus this.
const HARMONICS: f32 = 4.0;
/// Logarithms of scales are kept in plus and minus this: a scale may be 0.
const LOG_SCALE: f32 = 20.0;

/// Whether the header of a PLY file announces chunks or packed numbers.
pub(crate) fn is_packed(bytes: &[u8]) -> bool {
    let head = &bytes[..bytes.len().min(MAX_HEADER)];
    let end = find(head, b"end_header").unwrap_or(0);
    find(&head[..end], b"\nelement chunk ").is_some() || find(&head[..end], b" packed_").is_some()
}

fn find(bytes: &[u8], what: &[u8]) -> Option<usize> {
    bytes.windows(what.len()).position(|window| window == what)
}

/// An element of the header.
struct Element {
    name: String,
    count: usize,
    /// Bytes before it in the body.
    start: usize,
    /// Bytes of one.
    stride: usize,
    /// Names, and where the number lies in one.
    properties: Vec<(String, usize)>,
}

impl Element {
    fn offset(&self, name: &str) -> Result<usize> {
        let found = self.properties.iter().find(|(own, _)| own == name);
        let missing = || wrong(format!("element `{}` has no property `{name}`", self.name));
        found.map(|(_, offset)| *offset).ok_or_else(missing)
    }
}

/// Reads a compressed file.
///
/// # Errors
/// When it is none, or is shorter than its header says.
pub(crate) fn read(bytes: &[u8]) -> Result<PlyScene> {
    let (elements, comments, body) = parse(bytes)?;
    let need = |name: &str| {
        let found = elements.iter().find(|element| element.name == name);
        found.ok_or_else(|| wrong(format!("a compressed PLY has an element `{name}`, this one has none")))
    };
    let (chunks, vertices) = (need("chunk")?, need("vertex")?);
    let n = vertices.count;
    if chunks.count != n.div_ceil(CHUNK) {
        return Err(wrong(format!(
            "{n} Gaussians are {} chunks of {CHUNK}, the file has {}",
            n.div_ceil(CHUNK),
            chunks.count
        )));
    }
    let coloured = chunks.properties.iter().any(|(name, _)| name == "min_r");
    let ranges = &RANGES[..if coloured { 18 } else { 12 }];
    let ranges = ranges
        .iter()
        .map(|name| chunks.offset(name))
        .collect::<Result<Vec<_>>>()?;
    let packed = PACKED.map(|name| vertices.offset(name));
    let [position, rotation, scale, colour] = packed;
    let packed = [position?, rotation?, scale?, colour?];
    let (degree, rest) = harmonics(&elements, n)?;
    let of_chunk = |at: usize, range: usize, fallback: f32| {
        let start = chunks.start + at * chunks.stride;
        ranges
            .get(range)
            .map_or(fallback, |offset| float(&body[start + offset..]))
    };
    let bands = sh::coefficient_count(degree) - 1;
    let mut gaussians = Gaussians {
        means: Vec::with_capacity(3 * n),
        quats: Vec::with_capacity(4 * n),
        scales: Vec::with_capacity(3 * n),
        opacities: Vec::with_capacity(n),
        ..Gaussians::empty()
    };
    let mut coefficients = Vec::with_capacity(3 * (bands + 1) * n);
    for index in 0..n {
        let chunk = index / CHUNK;
        let vertex = &body[vertices.start + index * vertices.stride..];
        let [position, rotation, scale, colour] = packed.map(|offset| word(&vertex[offset..]));
        for (axis, share) in unpacked_11_10_11(position).into_iter().enumerate() {
            gaussians
                .means
                .push(mix(of_chunk(chunk, axis, 0.0), of_chunk(chunk, 3 + axis, 1.0), share));
        }
        for (axis, share) in unpacked_11_10_11(scale).into_iter().enumerate() {
            let log = mix(of_chunk(chunk, 6 + axis, 0.0), of_chunk(chunk, 9 + axis, 1.0), share);
            gaussians.scales.push(libm::expf(log));
        }
        gaussians.quats.extend(unpacked_rotation(rotation));
        for channel in 0..3 {
            let share = unit(colour >> (24 - 8 * channel), 8);
            let value = mix(
                of_chunk(chunk, 12 + channel, 0.0),
                of_chunk(chunk, 15 + channel, 1.0),
                share,
            );
            coefficients.push(sh::coefficient_from_colour(value));
        }
        gaussians.opacities.push(unit(colour, 8));
        if let Some((element, offsets)) = &rest {
            let row = &body[element.start + index * element.stride..];
            for band in 0..bands {
                coefficients.extend((0..3).map(|channel| coefficient(row[offsets[channel * bands + band]])));
            }
        }
    }
    gaussians.colour = Colour::Sh { degree, coefficients };
    Ok(PlyScene { gaussians, comments })
}

/// The element of the harmonics above degree 0, and where they lie in its rows.
type Rest<'a> = Option<(&'a Element, Vec<usize>)>;

/// Degree of the harmonics, and where those above degree 0 lie.
fn harmonics(elements: &[Element], n: usize) -> Result<(usize, Rest<'_>)> {
    let Some(element) = elements.iter().find(|element| element.name == "sh") else {
        return Ok((0, None));
    };
    if element.count != n {
        return Err(wrong(format!("{n} Gaussians have harmonics for {}", element.count)));
    }
    let degree = match element.properties.len() {
        9 => 1,
        24 => 2,
        45 => 3,
        other => return Err(wrong(format!("{other} harmonics; degrees 1 to 3 have 9, 24 or 45"))),
    };
    let names = (0..element.properties.len()).map(|k| format!("f_rest_{k}"));
    let offsets = names.map(|name| element.offset(&name)).collect::<Result<_>>()?;
    Ok((degree, Some((element, offsets))))
}

/// Elements, comments and body of a file that is as long as its header says.
fn parse(bytes: &[u8]) -> Result<(Vec<Element>, Vec<String>, &[u8])> {
    let head = &bytes[..bytes.len().min(MAX_HEADER)];
    let end = find(head, b"end_header\n").map(|at| (at, at + 11));
    let end = end.or_else(|| find(head, b"end_header\r\n").map(|at| (at, at + 12)));
    let (end, start) = end.ok_or_else(|| wrong(format!("no `end_header` in the first {} bytes", head.len())))?;
    let text = std::str::from_utf8(&head[..end]).map_err(|_| wrong("the header is not text".into()))?;
    let body = &bytes[start..];
    let mut elements: Vec<Element> = Vec::new();
    let (mut comments, mut length, mut little) = (Vec::new(), 0_usize, false);
    for (number, line) in text.lines().enumerate() {
        let problem = |what: &str| wrong(format!("line {} of the header, `{line}`: {what}", number + 1));
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 0 => {}
            ["format", form, _] => little = *form == "binary_little_endian",
            ["comment" | "obj_info", rest @ ..] => comments.push(rest.join(" ")),
            ["element", name, count] => {
                length = elements
                    .last()
                    .map_or(Some(0), |last| last.end())
                    .ok_or_else(|| problem("too large"))?;
                let count = count.parse().map_err(|_| problem("not a usable count"))?;
                elements.push(Element {
                    name: (*name).to_owned(),
                    count,
                    start: length,
                    stride: 0,
                    properties: Vec::new(),
                });
            }
            ["property", kind, name] => {
                let element = elements
                    .last_mut()
                    .ok_or_else(|| problem("a property before any element"))?;
                let wanted = match element.name.as_str() {
                    "chunk" => ["float", "float32"],
                    "vertex" => ["uint", "uint32"],
                    "sh" => ["uchar", "uint8"],
                    _ => return Err(problem("another element than chunk, vertex and sh")),
                };
                if !wanted.contains(kind) {
                    return Err(problem("another type than a compressed PLY has"));
                }
                element.properties.push(((*name).to_owned(), element.stride));
                element.stride += if element.name == "sh" { 1 } else { 4 };
            }
            [] => {}
            _ => return Err(problem("not a line of a compressed PLY")),
        }
    }
    if !little {
        return Err(wrong("only binary_little_endian is read; save it as that".into()));
    }
    let needed = elements.last().map_or(Some(0), Element::end);
    if needed.is_none_or(|needed| body.len() < needed.max(length)) {
        return Err(wrong(format!(
            "the header promises more than the {} bytes that follow it",
            body.len()
        )));
    }
    Ok((elements, comments, body))
}

impl Element {
    /// Bytes up to its end.
    fn end(&self) -> Option<usize> {
        self.count.checked_mul(self.stride)?.checked_add(self.start)
    }
}

fn float(bytes: &[u8]) -> f32 {
    bytes.first_chunk().map_or(0.0, |four| f32::from_le_bytes(*four))
}

fn word(bytes: &[u8]) -> u32 {
    bytes.first_chunk().map_or(0, |four| u32::from_le_bytes(*four))
}

fn mix(low: f32, high: f32, share: f32) -> f32 {
    low * (1.0 - share) + high * share
}

/// The lowest bits as a share of their largest value.
fn unit(value: u32, bits: u32) -> f32 {
    let most = (1_u32 << bits) - 1;
    (value & most) as f32 / most as f32
}

/// The nearest such value; what is no number is 0.
fn bits(share: f32, bits: u32) -> u32 {
    let most = ((1_u32 << bits) - 1) as f32;
    (share * most + 0.5).clamp(0.0, most) as u32
}

fn unpacked_11_10_11(value: u32) -> [f32; 3] {
    [unit(value >> 21, 11), unit(value >> 11, 10), unit(value, 11)]
}

fn packed_11_10_11([x, y, z]: [f32; 3]) -> u32 {
    bits(x, 11) << 21 | bits(y, 10) << 11 | bits(z, 11)
}

fn unpacked_rotation(value: u32) -> [f32; 4] {
    let largest = (value >> 30) as usize;
    let mut quat = [0.0; 4];
    let mut sum = 0.0;
    for (place, part) in (0..4).filter(|part| *part != largest).enumerate() {
        let share = unit(value >> (20 - 10 * place), 10);
        quat[part] = (share - 0.5) * std::f32::consts::SQRT_2;
        sum += quat[part] * quat[part];
    }
    quat[largest] = (1.0 - sum).max(0.0).sqrt();
    quat
}

fn packed_rotation(quat: &[f32]) -> u32 {
    let norm = quat.iter().map(|part| part * part).sum::<f32>().sqrt();
    if norm <= 0.0 || !norm.is_finite() {
        return packed_rotation(&[1.0, 0.0, 0.0, 0.0]);
    }
    let mut largest = 0;
    for part in 1..4 {
        if quat[part].abs() > quat[largest].abs() {
            largest = part;
        }
    }
    let sign = if quat[largest] < 0.0 { -norm } else { norm };
    let others = (0..4).filter(|part| *part != largest);
    others.fold(largest as u32, |packed, part| {
        packed << 10 | bits(quat[part] / sign * std::f32::consts::FRAC_1_SQRT_2 + 0.5, 10)
    })
}

/// A harmonic of a byte; the ends are the ends of the range.
fn coefficient(byte: u8) -> f32 {
    let share = match byte {
        0 => 0.0,
        255 => 1.0,
        other => (f32::from(other) + 0.5) / 256.0,
    };
    (2.0 * share - 1.0) * HARMONICS
}

fn byte_of(coefficient: f32) -> u8 {
    ((coefficient / HARMONICS + 1.0) / 2.0 * 256.0).clamp(0.0, 255.0) as u8
}

/// What is written of a Gaussian before it is packed: centre (m), logarithm of the scale, colour of degree 0.
fn plain(gaussians: &Gaussians, unit: LengthUnit, index: usize) -> [f32; 9] {
    let mean = |axis: usize| unit.to_m(gaussians.means[3 * index + axis]);
    let scale = |axis: usize| {
        let log = libm::logf(unit.to_m(gaussians.scales[3 * index + axis]).max(f32::MIN_POSITIVE));
        log.clamp(-LOG_SCALE, LOG_SCALE)
    };
    let colour = |channel: usize| match &gaussians.colour {
        Colour::Rgb(rgb) => rgb[3 * index + channel],
        Colour::Sh { degree, coefficients } => {
            0.5 + sh::C0 * coefficients[3 * sh::coefficient_count(*degree) * index + channel]
        }
    };
    std::array::from_fn(|k| match k / 3 {
        0 => mean(k),
        1 => scale(k - 3),
        _ => colour(k - 6),
    })
}

/// Writes Gaussians whose lengths have the given unit; in the file they are metres. Numbers that are not finite take the
/// lowest value of their chunk. Positions are kept to 1/4094 (x, z) and 1/2046 (y) of the extent of 256 Gaussians in a row.
///
/// # Errors
/// When arrays contradict each other or the writer fails (reported as an I/O error of `path_for_errors`).
pub fn write_packed_ply(
    gaussians: &Gaussians,
    unit: LengthUnit,
    comments: &[String],
    writer: &mut impl Write,
    path_for_errors: &Path,
) -> Result<()> {
    gaussians.validate()?;
    let mut write = |bytes: &[u8]| {
        let io = |source| Error::Io {
            action: "writing",
            path: path_for_errors.to_owned(),
            source,
        };
        writer.write_all(bytes).map_err(io)
    };
    let n = gaussians.len();
    let degree = match &gaussians.colour {
        Colour::Rgb(_) => 0,
        Colour::Sh { degree, .. } => *degree,
    };
    let bands = sh::coefficient_count(degree) - 1;
    write(header(n, 3 * bands, comments).as_bytes())?;
    let (mut chunks, mut words) = (Vec::new(), Vec::with_capacity(16 * n));
    for first in (0..n).step_by(CHUNK) {
        let rows: Vec<[f32; 9]> = (first..n.min(first + CHUNK))
            .map(|index| plain(gaussians, unit, index))
            .collect();
        let ranges: [(f32, f32); 9] = std::array::from_fn(|k| {
            let finite = rows.iter().map(|row| row[k]).filter(|value| value.is_finite());
            let ends = finite.fold((f32::MAX, f32::MIN), |(low, high), value| {
                (low.min(value), high.max(value))
            });
            if ends.0 <= ends.1 { ends } else { (0.0, 0.0) }
        });
        for group in ranges.chunks_exact(3) {
            chunks.extend(group.iter().flat_map(|range| range.0.to_le_bytes()));
            chunks.extend(group.iter().flat_map(|range| range.1.to_le_bytes()));
        }
        for (offset, row) in rows.iter().enumerate() {
            let share = |k: usize| {
                let (low, high) = ranges[k];
                if high > low { (row[k] - low) / (high - low) } else { 0.0 }
            };
            let index = first + offset;
            let opacity = bits(gaussians.opacities[index], 8);
            let colour = (6..9).fold(0, |packed, k| packed << 8 | bits(share(k), 8)) << 8 | opacity;
            let packed = [
                packed_11_10_11([share(0), share(1), share(2)]),
                packed_rotation(&gaussians.quats[4 * index..4 * index + 4]),
                packed_11_10_11([share(3), share(4), share(5)]),
                colour,
            ];
            words.extend(packed.into_iter().flat_map(u32::to_le_bytes));
        }
    }
    write(&chunks)?;
    write(&words)?;
    if let Colour::Sh { coefficients, .. } = &gaussians.colour {
        for own in coefficients.chunks_exact(3 * (bands + 1)) {
            let rest = (0..3).flat_map(|channel| (1..=bands).map(move |band| byte_of(own[3 * band + channel])));
            write(&rest.collect::<Vec<u8>>())?;
        }
    }
    Ok(())
}

fn header(n: usize, rest: usize, comments: &[String]) -> String {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    for comment in comments {
        let line: String = comment.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        text += &format!("comment {line}\n");
    }
    text += &format!("element chunk {}\n", n.div_ceil(CHUNK));
    text.extend(RANGES.map(|name| format!("property float {name}\n")));
    text += &format!("element vertex {n}\n");
    text.extend(PACKED.map(|name| format!("property uint {name}\n")));
    if rest > 0 {
        text += &format!("element sh {n}\n");
        text.extend((0..rest).map(|k| format!("property uchar f_rest_{k}\n")));
    }
    text + "end_header\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Many Gaussians over two chunks and a part, degree 1, some with values that are no numbers.
    fn scene() -> Gaussians {
        let n = 600;
        let value = |k: usize| (k * 7919 % 1009) as f32 / 1009.0;
        let mut scene = Gaussians {
            means: (0..3 * n).map(|k| 4.0 * value(k) - 2.0).collect(),
            quats: (0..4 * n).map(|k| 2.0 * value(k + 3) - 1.0).collect(),
            scales: (0..3 * n).map(|k| 0.002 + 0.3 * value(k + 7)).collect(),
            opacities: (0..n).map(|k| value(k + 11)).collect(),
            colour: Colour::Sh {
                degree: 1,
                coefficients: (0..12 * n).map(|k| 3.0 * value(k + 13) - 1.5).collect(),
            },
            ..Gaussians::empty()
        };
        scene.means[5] = f32::NAN;
        scene.scales[7] = 0.0;
        scene.quats[8..12].fill(0.0);
        scene
    }

    fn written(scene: &Gaussians) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_packed_ply(
            scene,
            LengthUnit::Metre,
            &["frame base".into()],
            &mut bytes,
            Path::new("x.ply"),
        )
        .unwrap();
        bytes
    }

    #[test]
    fn what_is_packed_is_read_back_within_its_steps() {
        let scene = scene();
        let bytes = written(&scene);
        assert!(is_packed(&bytes));
        let found = read(&bytes).unwrap();
        assert_eq!(found.comments, ["frame base"]);
        let found = found.gaussians;
        found.validate().unwrap();
        assert_eq!(found.len(), scene.len());
        for index in 8..scene.len() {
            for axis in 0..3 {
                let at = 3 * index + axis;
                assert!(
                    (found.means[at] - scene.means[at]).abs() < 4.0 / 2046.0 + 1e-5,
                    "{index} {axis}"
                );
                // The widest range of logarithms, e^-20 to 0.3, is in the chunk of the one without a scale.
                let steps = if index < CHUNK { 19.0 } else { 5.1 } / 2046.0;
                assert!(
                    (libm::logf(found.scales[at] / scene.scales[at])).abs() < steps + 1e-4,
                    "{index} {axis}"
                );
            }
            let (a, b) = (
                &found.quats[4 * index..4 * index + 4],
                &scene.quats[4 * index..4 * index + 4],
            );
            let norm = b.iter().map(|part| part * part).sum::<f32>().sqrt();
            let cosine = a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>().abs() / norm;
            assert!(cosine > 1.0 - 1e-5, "{index}: {cosine}");
            assert!((found.opacities[index] - scene.opacities[index]).abs() < 0.5 / 255.0 + 1e-6);
        }
        let (Colour::Sh { coefficients: a, .. }, Colour::Sh { coefficients: b, .. }) = (&found.colour, &scene.colour)
        else {
            panic!("harmonics stay harmonics")
        };
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 4.0 / 255.0 + 1e-4));
        assert_eq!(
            found.quats[8..12],
            unpacked_rotation(packed_rotation(&[1.0, 0.0, 0.0, 0.0]))
        );
    }

    #[test]
    fn what_is_cut_or_contradicts_itself_is_refused() {
        let bytes = written(&scene());
        let said = |bytes: &[u8]| read(bytes).unwrap_err().to_string();
        assert!(said(&bytes[..bytes.len() - 1]).contains("promises more"));
        for length in 0..bytes.len().min(2000) {
            assert!(read(&bytes[..length]).is_err(), "{length}");
        }
        let text = String::from_utf8_lossy(&bytes[..900]).into_owned();
        let end = text.find("end_header").unwrap();
        let with = |from: &str, to: &str| {
            let head = text[..end].replacen(from, to, 1);
            assert_ne!(head, text[..end]);
            [head.as_bytes(), &bytes[end..]].concat()
        };
        assert!(said(&with("chunk 3", "chunk 2")).contains("3 chunks"));
        assert!(said(&with("vertex 600", "vertex 18446744073709551615")).contains("too large"));
        assert!(said(&with("uint packed_scale", "float packed_scale")).contains("another type"));
        assert!(said(&with("packed_scale", "scale")).contains("packed_scale"));
        assert!(said(&with("binary_little_endian", "binary_big_endian")).contains("little"));
        assert!(said(&with("element sh 600", "element sh 599")).contains("599"));
    }
}
