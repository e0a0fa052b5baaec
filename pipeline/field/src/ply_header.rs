//! The header of a PLY file: where the numbers of a vertex lie.

use std::collections::HashMap;

use rogs_splat::gaussians::MAX_GAUSSIANS;

use crate::error::{Error, Result};

/// Longest header that is read.
pub(crate) const MAX_HEADER: usize = 1 << 16;
/// Most properties of the vertex element.
const MAX_PROPERTIES: usize = 1024;

/// A number of each vertex.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Property {
    offset: usize,
    pub(crate) kind: Kind,
}

/// Types of numbers, as far as they are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Float,
    Double,
    Byte,
    Other,
}

impl Kind {
    /// By the name of a type in a header.
    fn of(name: &str) -> Self {
        match name {
            "float" | "float32" => Self::Float,
            "double" | "float64" => Self::Double,
            "uchar" | "uint8" => Self::Byte,
            _ => Self::Other,
        }
    }
}

impl Property {
    /// Stands where none is known yet.
    pub(crate) const NONE: Self = Self {
        offset: 0,
        kind: Kind::Other,
    };

    /// The number in the bytes of a vertex; bytes from 0 to 255.
    pub(crate) fn value(self, vertex: &[u8]) -> f32 {
        let bytes = &vertex[self.offset..];
        match self.kind {
            Kind::Float => bytes.first_chunk().map_or(0.0, |four| f32::from_le_bytes(*four)),
            Kind::Double => bytes
                .first_chunk()
                .map_or(0.0, |eight| f64::from_le_bytes(*eight) as f32),
            Kind::Byte => bytes.first().map_or(0.0, |byte| f32::from(*byte)),
            Kind::Other => 0.0,
        }
    }
}

pub(crate) fn wrong(what: String) -> Error {
    Error::Ply { what }
}

/// The part of a header that matters.
pub(crate) struct Header {
    /// Bytes of the header.
    pub(crate) length: usize,
    /// Bytes of elements before the vertices.
    pub(crate) skip: usize,
    pub(crate) vertices: usize,
    /// Bytes of a vertex.
    pub(crate) stride: usize,
    properties: HashMap<String, Property>,
    pub(crate) comments: Vec<String>,
}

impl Header {
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self> {
        let head = &bytes[..bytes.len().min(MAX_HEADER)];
        let mut header = Self {
            length: 0,
            skip: 0,
            vertices: 0,
            stride: 0,
            properties: HashMap::new(),
            comments: Vec::new(),
        };
        let mut element: Option<(bool, usize)> = None; // is it the vertices, and how many
        let (mut seen_format, mut seen_vertices) = (false, false);
        let mut at = 0;
        for number in 1.. {
            let Some(end) = head[at..].iter().position(|&b| b == b'\n') else {
                return Err(wrong(format!("no `end_header` in the first {} bytes", head.len())));
            };
            let line = std::str::from_utf8(&head[at..at + end])
                .map_err(|_| wrong(format!("line {number} of the header is not text")))?
                .trim_end_matches('\r');
            at += end + 1;
            let mut words = line.split_ascii_whitespace();
            let problem = |what: &str| wrong(format!("line {number} of the header, `{line}`: {what}"));
            match words.next() {
                Some("ply") if number == 1 => {}
                _ if number == 1 => return Err(wrong("the file does not begin with `ply`".into())),
                Some("format") => {
                    if words.next() != Some("binary_little_endian") {
                        return Err(problem("only binary_little_endian is read; save it as that"));
                    }
                    seen_format = true;
                }
                Some("comment" | "obj_info") => header.comments.push(words.collect::<Vec<_>>().join(" ")),
                Some("element") => {
                    let name = words.next();
                    let count = words.next().and_then(|c| c.parse::<usize>().ok());
                    let count = count
                        .filter(|&c| c <= MAX_GAUSSIANS)
                        .ok_or_else(|| problem("not a usable count"))?;
                    let vertices = name == Some("vertex");
                    if vertices && seen_vertices {
                        return Err(problem("a second vertex element"));
                    }
                    if vertices {
                        header.vertices = count;
                    }
                    seen_vertices |= vertices;
                    element = Some((vertices, count));
                }
                Some("property") => {
                    let (vertices, count) = element.ok_or_else(|| problem("a property before any element"))?;
                    let kind = words.next().unwrap_or("");
                    let Some(size) = size_of_type(kind) else {
                        // Lists of later elements (faces, say) are never reached.
                        if vertices || !seen_vertices {
                            return Err(problem(
                                "lists and unknown types are not read before or in the vertices",
                            ));
                        }
                        continue;
                    };
                    if vertices {
                        let name = words.next().ok_or_else(|| problem("a property without a name"))?;
                        let place = Property {
                            offset: header.stride,
                            kind: Kind::of(kind),
                        };
                        if header.properties.len() >= MAX_PROPERTIES {
                            return Err(problem("too many properties"));
                        }
                        if header.properties.insert(name.to_owned(), place).is_some() {
                            return Err(problem("a second property of that name"));
                        }
                        header.stride += size;
                    } else if !seen_vertices {
                        header.skip = size
                            .checked_mul(count)
                            .and_then(|bytes| bytes.checked_add(header.skip))
                            .ok_or_else(|| problem("an element of impossible size"))?;
                    }
                }
                Some("end_header") => break,
                Some(_) => return Err(problem("not a PLY header line")),
                None => {}
            }
        }
        if !seen_format || !seen_vertices || header.stride == 0 {
            return Err(wrong(
                "the header has no format line or no vertex element with properties".into(),
            ));
        }
        header.length = at;
        Ok(header)
    }

    /// A property of real numbers.
    pub(crate) fn real(&self, name: &str) -> Result<Property> {
        match self.properties.get(name) {
            Some(property) if matches!(property.kind, Kind::Float | Kind::Double) => Ok(*property),
            Some(_) => Err(wrong(format!(
                "property `{name}` has another type than `float` or `double`"
            ))),
            None => Err(wrong(format!(
                "property `{name}` is missing; a PLY of Gaussians has x, y, z, f_dc_0.., opacity, scale_0.., rot_0.. ({})",
                self.shown()
            ))),
        }
    }

    /// Refuses sizes that another program changes before it draws them.
    pub(crate) fn refuse_filters(&self) -> Result<()> {
        match self.properties.contains_key("filter_3D") {
            true => Err(wrong(
                "`filter_3D` of Mip-Splatting changes sizes and opacities and is not applied: fuse it into them first (its \
                 `create_fused_ply.py`)"
                    .to_owned(),
            )),
            false => Ok(()),
        }
    }

    /// The three properties of the base colour: harmonics, or bytes where there are only these.
    pub(crate) fn colours(&self) -> Result<[Property; 3]> {
        if self.properties.contains_key("f_dc_0") || !self.properties.contains_key("red") {
            return Ok([self.real("f_dc_0")?, self.real("f_dc_1")?, self.real("f_dc_2")?]);
        }
        let byte = |name: &str| match self.properties.get(name) {
            Some(property) if property.kind == Kind::Byte => Ok(*property),
            _ => Err(wrong(format!(
                "there is no `f_dc_0`, and `{name}` is not an `uchar`: export colours as spherical harmonics (nerfstudio: \
                 sh_coeffs)"
            ))),
        };
        Ok([byte("red")?, byte("green")?, byte("blue")?])
    }

    /// The properties that there are, for messages.
    fn shown(&self) -> String {
        let mut names: Vec<(&Property, &str)> = self.properties.iter().map(|(name, at)| (at, name.as_str())).collect();
        names.sort_by_key(|(at, _)| at.offset);
        let names: Vec<&str> = names.into_iter().map(|(_, name)| name).take(12).collect();
        format!("this one has {}", names.join(", "))
    }

    /// Number of `f_rest_*`, which must be numbered without gaps.
    pub(crate) fn rest_count(&self) -> Result<usize> {
        let count = self
            .properties
            .keys()
            .filter(|name| name.starts_with("f_rest_"))
            .count();
        for k in 0..count {
            self.real(&format!("f_rest_{k}"))?;
        }
        Ok(count)
    }
}

fn size_of_type(name: &str) -> Option<usize> {
    Some(match name {
        "char" | "uchar" | "int8" | "uint8" => 1,
        "short" | "ushort" | "int16" | "uint16" => 2,
        "int" | "uint" | "float" | "int32" | "uint32" | "float32" => 4,
        "double" | "float64" => 8,
        _ => return None,
    })
}
