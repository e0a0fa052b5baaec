//! The binary part of a glTF file, and the accessors into it.

use serde_json::{Value, json};

use crate::error::{Error, Result};

const FLOAT: u32 = 5126;
const UNSIGNED_INT: u32 = 5125;
const UNSIGNED_BYTE: u32 = 5121;
/// What a buffer view is for: vertices or indices of a mesh.
const VERTICES: u32 = 34_962;
const INDICES: u32 = 34_963;

/// What values are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Scalar,
    Vec3,
    Vec4,
}

impl Kind {
    const fn name(self) -> &'static str {
        match self {
            Self::Scalar => "SCALAR",
            Self::Vec3 => "VEC3",
            Self::Vec4 => "VEC4",
        }
    }

    const fn channels(self) -> usize {
        match self {
            Self::Scalar => 1,
            Self::Vec3 => 3,
            Self::Vec4 => 4,
        }
    }
}

/// Bytes, views of them and accessors.
#[derive(Debug, Default)]
pub(super) struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    fn view(&mut self, bytes: impl Iterator<Item = u8>, target: Option<u32>) -> usize {
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        let length = self.bytes.len() - start;
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut view = json!({"buffer": 0, "byteOffset": start, "byteLength": length});
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.views.push(view);
        self.views.len() - 1
    }

    fn accessor(&mut self, accessor: Value) -> usize {
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn floats(&mut self, values: &[f32], kind: Kind, bounded: bool, target: Option<u32>) -> usize {
        let view = self.view(values.iter().flat_map(|value| value.to_le_bytes()), target);
        let mut accessor = json!({
            "bufferView": view, "componentType": FLOAT, "type": kind.name(), "count": values.len() / kind.channels(),
        });
        if bounded {
            let [least, most] = bounds(values, kind.channels());
            accessor["min"] = least.into();
            accessor["max"] = most.into();
        }
        self.accessor(accessor)
    }

    /// An attribute of vertices; positions say their bounds.
    pub(super) fn attribute(&mut self, values: &[f32], kind: Kind, bounded: bool) -> usize {
        self.floats(values, kind, bounded, Some(VERTICES))
    }

    /// Numbers of an animation; times say their bounds.
    pub(super) fn animated(&mut self, values: &[f32], kind: Kind, bounded: bool) -> usize {
        self.floats(values, kind, bounded, None)
    }

    /// Colours with opacities of vertices, bytes that mean 0..1. `[N, 4]`
    pub(super) fn colours(&mut self, rgba: &[u8]) -> usize {
        let view = self.view(rgba.iter().copied(), Some(VERTICES));
        self.accessor(json!({
            "bufferView": view, "componentType": UNSIGNED_BYTE, "normalized": true, "type": "VEC4", "count": rgba.len() / 4,
        }))
    }

    /// Corners of triangles.
    pub(super) fn triangles(&mut self, triangles: &[[u32; 3]]) -> usize {
        let bytes = triangles.iter().flatten().flat_map(|corner| corner.to_le_bytes());
        let view = self.view(bytes, Some(INDICES));
        self.accessor(json!({
            "bufferView": view, "componentType": UNSIGNED_INT, "type": "SCALAR", "count": 3 * triangles.len(),
        }))
    }

    /// A binary glTF file with a document that names these accessors.
    ///
    /// # Errors
    /// When it would be longer than 4 GiB.
    pub(super) fn into_glb(self, mut document: Value) -> Result<Vec<u8>> {
        document["buffers"] = json!([{"byteLength": self.bytes.len()}]);
        document["bufferViews"] = self.views.into();
        document["accessors"] = self.accessors.into();
        let mut text = document.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let total = 12 + 8 + text.len() + 8 + self.bytes.len();
        let total = u32::try_from(total).map_err(|_| Error::Unfit {
            what: format!("{total} bytes are more than a binary glTF file holds (4 GiB): ask for fewer times"),
        })?;
        let mut out = Vec::with_capacity(total as usize);
        out.extend_from_slice(b"glTF");
        for number in [2, total, text.len() as u32] {
            out.extend(number.to_le_bytes());
        }
        out.extend_from_slice(b"JSON");
        out.extend(text);
        out.extend((self.bytes.len() as u32).to_le_bytes());
        out.extend_from_slice(b"BIN\0");
        out.extend(self.bytes);
        Ok(out)
    }
}

/// Least and largest values of each channel; exact, for they are compared with the values.
fn bounds(values: &[f32], channels: usize) -> [Vec<f64>; 2] {
    let of = |start: f32, choose: fn(f32, f32) -> f32| -> Vec<f64> {
        (0..channels)
            .map(|channel| {
                let own = values.iter().skip(channel).step_by(channels).copied();
                f64::from(own.fold(start, choose))
            })
            .collect()
    };
    [of(f32::INFINITY, f32::min), of(f32::NEG_INFINITY, f32::max)]
}
