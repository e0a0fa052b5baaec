//! SPZ, the compressed Gaussians of Niantic (version 3; `docs/exports.md`).
//!
//! One gzip member. Header of 16 bytes: `NGSP`, version, number of Gaussians (u32 each), degree of the harmonics, fractional
//! bits of centres, flags, 0. Then all of each attribute: centres (3 x 24-bit fixed point), opacities (u8), colours (3 x u8,
//! harmonic of degree 0 times 0.15 plus a half), logarithms of scales (3 x u8, sixteenths from -10 on), rotations (u32: which
//! of x, y, z, w is largest in the upper 2 bits, then sign and 9 bits of each other one over 1/sqrt 2), other harmonics (u8,
//! 128ths in -1..1, colours fastest). Axes are x right, y up, z backward.

use rogs_schemas::units::LengthUnit;
use rogs_splat::Gaussians;

use crate::error::{Error, Result};
use crate::splats::Splats;

const MAGIC: &[u8; 4] = b"NGSP";
const VERSION: u32 = 3;
/// Most fractional bits of a centre that are used; 2^-18 m is 4 micrometres, within 32 m of the origin.
const MOST_BITS: u8 = 18;
/// Largest number of a 24-bit centre.
const MOST_STEPS: f64 = (1 << 23) as f64 - 1.0;
/// Harmonic of degree 0 to colour byte.
const COLOUR_SCALE: f32 = 0.15;
/// Level of the compression: the default of gzip.
const LEVEL: u8 = 6;

/// The bytes of a file. `gaussians` have y up ([`y_up_from_world`](crate::splats::y_up_from_world)) and lengths in `unit`.
///
/// # Errors
/// When a number is not finite, or a centre lies more than 8,000 km away.
pub fn spz_bytes(gaussians: &Gaussians, unit: LengthUnit) -> Result<Vec<u8>> {
    let splats = Splats::new(gaussians, unit)?;
    let n = splats.len();
    let bits = fractional_bits(&splats)?;
    let rest = gaussians.colour.values_per_gaussian() - 3;
    let mut out = Vec::with_capacity(16 + n * (20 + rest));
    out.extend_from_slice(MAGIC);
    out.extend_from_slice(&VERSION.to_le_bytes());
    out.extend_from_slice(&(n as u32).to_le_bytes());
    out.extend_from_slice(&[splats.degree() as u8, bits, 0, 0]);
    let steps = f64::from(1_u32 << bits);
    for index in 0..n {
        for value in splats.centre_m(index) {
            let fixed = libm::round(f64::from(value) * steps) as i32;
            out.extend_from_slice(&fixed.to_le_bytes()[..3]);
        }
    }
    out.extend((0..n).map(|index| byte(255.0 * splats.opacity(index))));
    for index in 0..n {
        out.extend(
            splats
                .constant(index)
                .map(|value| byte(255.0 * (COLOUR_SCALE * value + 0.5))),
        );
    }
    for index in 0..n {
        out.extend(
            splats
                .scale_m(index)
                .map(|value| byte(16.0 * (libm::logf(value) + 10.0))),
        );
    }
    for index in 0..n {
        out.extend_from_slice(&packed(splats.rotation(index)).to_le_bytes());
    }
    for index in 0..n {
        out.extend(splats.rest(index).iter().map(|value| byte(128.0 * value + 128.0)));
    }
    Ok(gzip(&out))
}

/// As many as leave room for the farthest centre.
fn fractional_bits(splats: &Splats<'_>) -> Result<u8> {
    let mut farthest = 0.0_f64;
    for index in 0..splats.len() {
        for value in splats.centre_m(index) {
            farthest = farthest.max(f64::from(value).abs());
        }
    }
    let fits = |bits: &u8| farthest * f64::from(1_u32 << bits) <= MOST_STEPS;
    (0..=MOST_BITS).rev().find(fits).ok_or_else(|| Error::Unfit {
        what: format!("a Gaussian lies {farthest:.0} m away, farther than SPZ can say; leave it out (`--min-opacity`)"),
    })
}

fn byte(value: f32) -> u8 {
    libm::roundf(value).clamp(0.0, 255.0) as u8
}

/// A unit quaternion (x, y, z, w) without its largest part.
fn packed(quat: [f64; 4]) -> u32 {
    let mut largest = 0;
    for part in 1..4 {
        if quat[part].abs() > quat[largest].abs() {
            largest = part;
        }
    }
    let flip = quat[largest] < 0.0;
    let others = (0..4).filter(|part| *part != largest);
    others.fold(largest as u32, |packed, part| {
        let negative = (quat[part] < 0.0) != flip;
        let size = libm::round(511.0 * quat[part].abs() * std::f64::consts::SQRT_2).min(511.0) as u32;
        (packed << 10) | (u32::from(negative) << 9) | size
    })
}

/// One gzip member (RFC 1952) without name and time.
fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut out = vec![0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 255];
    out.extend(miniz_oxide::deflate::compress_to_vec(bytes, LEVEL));
    out.extend_from_slice(&crc32fast::hash(bytes).to_le_bytes());
    out.extend_from_slice(&(bytes.len() as u32).to_le_bytes());
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splats::tests::scene;

    fn unpacked(bytes: &[u8]) -> Vec<u8> {
        let body = miniz_oxide::inflate::decompress_to_vec(&bytes[10..bytes.len() - 8]).unwrap();
        assert_eq!(bytes[bytes.len() - 8..][..4], crc32fast::hash(&body).to_le_bytes());
        body
    }

    /// The decoder's formulas, written from the description of the format.
    #[test]
    fn what_is_written_comes_back_within_the_steps_of_the_format() {
        let scene = scene(37, 3);
        let body = unpacked(&spz_bytes(&scene, LengthUnit::Metre).unwrap());
        let n = 37;
        assert_eq!(&body[..4], b"NGSP");
        assert_eq!(body[4..12], [3, 0, 0, 0, 37, 0, 0, 0]);
        assert_eq!(body[12..16], [3, 18, 0, 0]);
        assert_eq!(body.len(), 16 + n * (9 + 1 + 3 + 3 + 4 + 45));
        let (centres, rest) = body[16..].split_at(9 * n);
        let (alphas, rest) = rest.split_at(n);
        let (colours, rest) = rest.split_at(3 * n);
        let (scales, rest) = rest.split_at(3 * n);
        let (quats, rest) = rest.split_at(4 * n);
        let splats = Splats::new(&scene, LengthUnit::Metre).unwrap();
        for index in 0..n {
            for k in 0..3 {
                let at = 3 * (3 * index + k);
                let raw = i32::from_le_bytes([0, centres[at], centres[at + 1], centres[at + 2]]) >> 8;
                let error = f64::from(raw) / f64::from(1 << 18) - f64::from(scene.means[3 * index + k]);
                assert!(error.abs() <= 1.0 / f64::from(1 << 18), "{error}");
                let log = f32::from(scales[3 * index + k]) / 16.0 - 10.0;
                assert!((log - scene.scales[3 * index + k].ln()).abs() <= 1.0 / 32.0 + 1e-5);
                let dc = (f32::from(colours[3 * index + k]) / 255.0 - 0.5) / 0.15;
                assert!((dc - splats.constant(index)[k]).abs() <= 0.5 / 255.0 / 0.15 + 1e-5);
            }
            assert!((f32::from(alphas[index]) / 255.0 - scene.opacities[index]).abs() <= 0.5 / 255.0 + 1e-6);
            let mut word = u32::from_le_bytes(quats[4 * index..4 * index + 4].try_into().unwrap());
            let largest = (word >> 30) as usize;
            let (mut quat, mut sum) = ([0.0_f64; 4], 0.0);
            for part in (0..4).rev().filter(|part| *part != largest) {
                let size = f64::from(word & 511) / 511.0 * std::f64::consts::FRAC_1_SQRT_2;
                quat[part] = if word & 512 != 0 { -size } else { size };
                sum += size * size;
                word >>= 10;
            }
            quat[largest] = (1.0 - sum).sqrt();
            let dot: f64 = quat.iter().zip(splats.rotation(index)).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 1.0 - 1e-5, "{dot}");
            for (k, value) in splats.rest(index).iter().enumerate() {
                assert!((f32::from(rest[45 * index + k]) / 128.0 - 1.0 - value).abs() <= 0.5 / 128.0 + 1e-5);
            }
        }
    }

    #[test]
    fn far_scenes_have_coarser_centres_and_the_farthest_are_refused() {
        let mut scene = scene(2, 0);
        scene.means[0] = 4000.0;
        assert_eq!(unpacked(&spz_bytes(&scene, LengthUnit::Metre).unwrap())[13], 11);
        scene.means[0] = 1e8;
        assert!(
            spz_bytes(&scene, LengthUnit::Metre)
                .unwrap_err()
                .to_string()
                .contains("farther")
        );
        scene.means[0] = f32::NAN;
        assert!(spz_bytes(&scene, LengthUnit::Metre).is_err());
    }
}
