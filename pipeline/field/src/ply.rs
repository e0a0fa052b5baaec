//! 3DGS PLY files (`docs/spec/r4c.md` section 6).
//!
//! Binary little-endian, one `element vertex`, properties `float` or `double`: `x y z`, `f_dc_0..2`, `f_rest_*` (all of red,
//! then green, then blue), `opacity` as a logit, `scale_0..2` as natural logarithms of the standard deviations,
//! `rot_0..3` as (w, x, y, z). Properties are found by name; others (normals, say) are skipped. Where colours are bytes
//! `red green blue` instead (nerfstudio without harmonics), these are read. We write lengths in
//! metres and say so in comments, because the format itself has no unit.

use std::io::{Read, Write};
use std::path::Path;

use rogs_schemas::units::LengthUnit;

use rogs_splat::{Colour, Gaussians, sh};

use crate::attributes::sigmoid;
use crate::error::{Error, Result};
use crate::ply_header::{Header, Kind, Property, wrong};
use crate::ply_packed;
use crate::ply_scene::PlyScene;
use crate::timed::TimedField;

/// Opacities are written as logits of values at least this far from 0 and 1, which f32 can tell apart.
const OPACITY_MARGIN: f32 = 1e-6;

/// Reads a PLY file.
///
/// # Errors
/// When the file cannot be read, is no 3DGS PLY, or is shorter than its header says.
pub fn read_ply_file(path: &Path) -> Result<PlyScene> {
    let io = |action| {
        move |source| Error::Io {
            action,
            path: path.to_owned(),
            source,
        }
    };
    let file = rogs_files::open(path).map_err(io("opening"))?;
    let length = file.metadata().map_err(io("reading the size of"))?.len();
    // The header bounds what follows; nothing is allocated beyond the size of the file.
    let mut bytes = Vec::with_capacity(usize::try_from(length).unwrap_or(0).min(1 << 32));
    file.take(length).read_to_end(&mut bytes).map_err(io("reading"))?;
    read_ply(&bytes)
}

/// Reads a PLY file that lies in memory, plain or compressed.
///
/// # Errors
/// When it is no 3DGS PLY, or is shorter than its header says.
pub fn read_ply(bytes: &[u8]) -> Result<PlyScene> {
    if ply_packed::is_packed(bytes) {
        return ply_packed::read(bytes);
    }
    let header = Header::parse(bytes)?;
    let n = header.vertices;
    let body = &bytes[header.length..];
    let needed = n.checked_mul(header.stride).and_then(|b| b.checked_add(header.skip));
    if needed.is_none_or(|needed| body.len() < needed) {
        return Err(wrong(format!(
            "the header promises {n} vertices of {} bytes, {} bytes follow it",
            header.stride,
            body.len()
        )));
    }
    let names = [
        "x", "y", "z", "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ];
    header.refuse_filters()?;
    let mut offsets = [Property::NONE; 11];
    for (offset, name) in offsets.iter_mut().zip(names) {
        *offset = header.real(name)?;
    }
    let dc = header.colours()?;
    let rest_count = header.rest_count()?;
    let degree = match rest_count {
        0 => 0,
        9 => 1,
        24 => 2,
        45 => 3,
        other => {
            return Err(wrong(format!(
                "{other} properties `f_rest_*`; degrees 0 to 3 have 0, 9, 24 or 45"
            )));
        }
    };
    let rest = (0..rest_count)
        .map(|k| header.real(&format!("f_rest_{k}")))
        .collect::<Result<Vec<_>>>()?;

    let per = 3 * sh::coefficient_count(degree);
    let mut gaussians = Gaussians {
        means: Vec::with_capacity(3 * n),
        quats: Vec::with_capacity(4 * n),
        scales: Vec::with_capacity(3 * n),
        opacities: Vec::with_capacity(n),
        ..Gaussians::empty()
    };
    let mut coefficients = Vec::with_capacity(per * n);
    for vertex in body[header.skip..].chunks_exact(header.stride).take(n) {
        let float = |property: Property| property.value(vertex);
        gaussians.means.extend(offsets[..3].iter().map(|&o| float(o)));
        gaussians.opacities.push(sigmoid(float(offsets[3])));
        gaussians
            .scales
            .extend(offsets[4..7].iter().map(|&o| libm::expf(float(o))));
        gaussians.quats.extend(offsets[7..].iter().map(|&o| float(o)));
        coefficients.extend(dc.map(|property| match property.kind {
            Kind::Byte => sh::coefficient_from_colour(float(property) / 255.0),
            Kind::Float | Kind::Double | Kind::Other => float(property),
        }));
        for k in 1..per / 3 {
            let bands = per / 3 - 1;
            coefficients.extend((0..3).map(|c| float(rest[c * bands + k - 1])));
        }
    }
    gaussians.colour = Colour::Sh { degree, coefficients };
    Ok(PlyScene {
        gaussians,
        comments: header.comments,
    })
}

/// Writes Gaussians whose lengths have the given unit; in the file they are metres. Extra channels are not part of the
/// format.
///
/// # Errors
/// When arrays contradict each other or the writer fails (reported as an I/O error of `path_for_errors`).
pub fn write_ply(
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
    let degree = match &gaussians.colour {
        Colour::Rgb(_) => 0,
        Colour::Sh { degree, .. } => *degree,
    };
    let bands = sh::coefficient_count(degree) - 1;
    write(header(gaussians.len(), 3 * bands, comments).as_bytes())?;
    let mut row = Vec::with_capacity(4 * (14 + 3 * bands));
    for n in 0..gaussians.len() {
        row.clear();
        let mut put = |value: f32| row.extend_from_slice(&value.to_le_bytes());
        gaussians.means[3 * n..3 * n + 3]
            .iter()
            .for_each(|v| put(unit.to_m(*v)));
        match &gaussians.colour {
            Colour::Rgb(rgb) => rgb[3 * n..3 * n + 3]
                .iter()
                .for_each(|&v| put(sh::coefficient_from_colour(v))),
            Colour::Sh { coefficients, .. } => {
                let own = &coefficients[3 * (bands + 1) * n..3 * (bands + 1) * (n + 1)];
                own[..3].iter().for_each(|&v| put(v));
                for c in 0..3 {
                    (1..=bands).for_each(|k| put(own[3 * k + c]));
                }
            }
        }
        let opacity = gaussians.opacities[n].clamp(OPACITY_MARGIN, 1.0 - OPACITY_MARGIN);
        put(libm::logf(opacity / (1.0 - opacity)));
        gaussians.scales[3 * n..3 * n + 3]
            .iter()
            .for_each(|v| put(libm::logf(unit.to_m(*v).max(f32::MIN_POSITIVE))));
        let quat = &gaussians.quats[4 * n..4 * n + 4];
        let norm = quat.iter().map(|q| q * q).sum::<f32>().sqrt();
        if norm > 0.0 && norm.is_finite() {
            quat.iter().for_each(|q| put(q / norm));
        } else {
            [1.0, 0.0, 0.0, 0.0].into_iter().for_each(put);
        }
        write(&row)?;
    }
    Ok(())
}

fn header(vertices: usize, rest: usize, comments: &[String]) -> String {
    let mut text = String::from("ply\nformat binary_little_endian 1.0\n");
    for comment in comments {
        let line: String = comment.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
        text += &format!("comment {line}\n");
    }
    text += &format!("element vertex {vertices}\n");
    let fixed = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2"].map(str::to_owned);
    let rest = (0..rest).map(|k| format!("f_rest_{k}"));
    let tail = [
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ]
    .map(str::to_owned);
    for name in fixed.into_iter().chain(rest).chain(tail) {
        text += &format!("property float {name}\n");
    }
    text + "end_header\n"
}

/// The frame that a field is written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Axes {
    /// The reconstruction frame: OpenCV axes of the first source camera (x right, y down, z forward).
    #[default]
    Recon,
    /// The robot's base frame (z up for the robots we know).
    Base,
}

/// The Gaussians of a field at a stored time in a frame, internal units, and the comments that a PLY file has on them.
///
/// # Errors
/// When the time is not stored.
pub fn gaussians_in(field: &TimedField<'_>, time: f64, axes: Axes) -> Result<(Gaussians, [String; 2])> {
    let mut gaussians = field.gaussians(time)?;
    let frame = match axes {
        Axes::Recon => "recon_opencv",
        Axes::Base => {
            let base_from_recon_iu = field.recon_from_base()?.inverse().in_unit(LengthUnit::Internal);
            gaussians = gaussians.moved(&base_from_recon_iu.into());
            "base"
        }
    };
    Ok((gaussians, [format!("frame {frame} unit m"), format!("time {time}")]))
}

/// Writes a field at a stored time: metres, in the frame asked for, which a comment of the file names; one row per Gaussian
/// in the field's order. The file appears under its name only when it is complete.
///
/// # Errors
/// When the time is not stored or the file cannot be written.
pub fn export_field(field: &TimedField<'_>, time: f64, axes: Axes, path: &Path) -> Result<()> {
    let (gaussians, comments) = gaussians_in(field, time, axes)?;
    rogs_files::try_write_with(path, |file| {
        write_ply(&gaussians, LengthUnit::Internal, &comments, file, path)
    })
}
