//! glTF 2.0 (`.gltf`, `.glb`): triangles of the scene after the node transforms.

use base64::Engine as _;
use glam::{DAffine3, DMat4, DVec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::mesh::Mode;

use super::{MAX_FILE_BYTES, MAX_TRIANGLES, Mesh, Parsed};

const MAX_INSTANCES: usize = 20_000;
const MAX_DEPTH: usize = 64;

pub(super) fn parse(bytes: &[u8], external: &dyn Fn(&str) -> Parsed<Vec<u8>>) -> Parsed<Mesh> {
    let refuse = |error: gltf::Error| format!("not a glTF file: {error}");
    check_container(bytes)?;
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice_without_validation(bytes).map_err(refuse)?;
    let root = document.into_json();
    check_attributes(&root)?;
    let file = gltf::Document::from_json(root).map_err(refuse)?;
    if let Some(name) = file.extensions_required().next() {
        return Err(format!("it requires the extension `{name}`, which is not supported"));
    }
    let buffers = buffers(&file, blob, external)?;
    let mut reader = Reader {
        buffers,
        mesh: Mesh::default(),
        instances: 0,
    };
    let scene = file.default_scene().or_else(|| file.scenes().next());
    let Some(scene) = scene else {
        return Err("it has no scene".into());
    };
    for node in scene.nodes() {
        reader.node(&node, DAffine3::IDENTITY, 0)?;
    }
    Ok(reader.mesh)
}

/// The `gltf` crate subtracts the head of a binary file from the length in it without a look at which is larger.
fn check_container(bytes: &[u8]) -> Parsed<()> {
    const HEAD: u32 = 12;
    let length = (bytes.strip_prefix(b"glTF")).and_then(|rest| rest.get(4..8)?.try_into().ok());
    match length.map(u32::from_le_bytes) {
        Some(length) if length < HEAD => Err(format!(
            "not a glTF file: its head says that it has {length} bytes, fewer than a head has"
        )),
        _ => Ok(()),
    }
}

/// The validation of the `gltf` crate looks up position accessors before it has checked their indices.
fn check_attributes(root: &gltf::json::Root) -> Parsed<()> {
    let primitives = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let mut accessors = primitives.flat_map(|primitive| primitive.attributes.values());
    match accessors.find(|accessor| accessor.value() >= root.accessors.len()) {
        Some(accessor) => Err(format!("accessor {} of {}", accessor.value(), root.accessors.len())),
        None => Ok(()),
    }
}

fn buffers(
    file: &gltf::Document,
    blob: Option<Vec<u8>>,
    external: &dyn Fn(&str) -> Parsed<Vec<u8>>,
) -> Parsed<Vec<Vec<u8>>> {
    let mut buffers = Vec::new();
    let mut total = 0usize;
    for buffer in file.buffers() {
        let data = match buffer.source() {
            gltf::buffer::Source::Bin => blob
                .clone()
                .ok_or("it refers to a binary chunk that it does not have")?,
            gltf::buffer::Source::Uri(uri) => match uri.strip_prefix("data:") {
                Some(rest) => {
                    let (_, encoded) = rest.split_once(";base64,").ok_or("a data URI is not base64")?;
                    base64::engine::general_purpose::STANDARD
                        .decode(encoded)
                        .map_err(|error| format!("a data URI: {error}"))?
                }
                None => external(uri)?,
            },
        };
        if data.len() < buffer.length() {
            return Err(format!(
                "buffer {} has {} bytes, {} are declared",
                buffer.index(),
                data.len(),
                buffer.length()
            ));
        }
        total = total.saturating_add(data.len());
        if total as u64 > MAX_FILE_BYTES {
            return Err("its buffers are too large".into());
        }
        buffers.push(data);
    }
    Ok(buffers)
}

struct Reader {
    buffers: Vec<Vec<u8>>,
    mesh: Mesh,
    instances: usize,
}

impl Reader {
    fn node(&mut self, node: &gltf::Node<'_>, scene_from_parent: DAffine3, depth: usize) -> Parsed<()> {
        self.instances += 1;
        if depth > MAX_DEPTH || self.instances > MAX_INSTANCES {
            return Err("its nodes are nested or shared without end".into());
        }
        let local = DMat4::from_cols_array_2d(&node.transform().matrix().map(|column| column.map(f64::from)));
        let scene_from_node = scene_from_parent * DAffine3::from_mat4(local);
        if let Some(mesh) = node.mesh() {
            for primitive in mesh.primitives() {
                self.primitive(&primitive, scene_from_node)?;
            }
        }
        for child in node.children() {
            self.node(&child, scene_from_node, depth + 1)?;
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: &gltf::Primitive<'_>, scene_from_node: DAffine3) -> Parsed<()> {
        self.instances += 1;
        let mode = primitive.mode();
        if matches!(mode, Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
            return Ok(());
        }
        let positions = primitive
            .get(&gltf::Semantic::Positions)
            .ok_or("a primitive has no positions")?;
        let start = self.mesh.positions.len();
        let count = positions.count();
        let items = self.items(&positions, DataType::F32, Dimensions::Vec3)?;
        let to_scene = |item: &[u8]| {
            let value = |at: usize| f64::from(f32::from_le_bytes([item[at], item[at + 1], item[at + 2], item[at + 3]]));
            scene_from_node
                .transform_point3(DVec3::new(value(0), value(4), value(8)))
                .as_vec3()
                .to_array()
        };
        let positions: Vec<[f32; 3]> = items.map(to_scene).collect();
        let corners: Vec<u32> = match primitive.indices() {
            None => (0..count as u32).collect(),
            Some(accessor) => self.indices(&accessor)?,
        };
        if let Some(corner) = corners.iter().find(|&&corner| corner as usize >= count) {
            return Err(format!("vertex {corner} of {count}"));
        }
        self.mesh.positions.extend(positions);
        let shifted = |a: u32, b: u32, c: u32| [a, b, c].map(|corner| corner + start as u32);
        match mode {
            Mode::TriangleStrip => {
                let strip = corners.windows(3).enumerate();
                self.mesh.triangles.extend(strip.map(|(index, w)| {
                    if index % 2 == 0 {
                        shifted(w[0], w[1], w[2])
                    } else {
                        shifted(w[1], w[0], w[2])
                    }
                }));
            }
            Mode::TriangleFan => {
                self.mesh
                    .triangles
                    .extend(corners.windows(2).skip(1).map(|w| shifted(corners[0], w[0], w[1])));
            }
            _ => {
                if !corners.len().is_multiple_of(3) {
                    return Err(format!("{} corners make no triangles", corners.len()));
                }
                self.mesh
                    .triangles
                    .extend(corners.chunks_exact(3).map(|c| shifted(c[0], c[1], c[2])));
            }
        }
        if self.mesh.triangles.len() > MAX_TRIANGLES || self.mesh.positions.len() > 3 * MAX_TRIANGLES {
            return Err("it has too many triangles".into());
        }
        Ok(())
    }

    fn indices(&self, accessor: &gltf::Accessor<'_>) -> Parsed<Vec<u32>> {
        let kind = accessor.data_type();
        let items = self.items(accessor, kind, Dimensions::Scalar)?;
        Ok(match kind {
            DataType::U8 => items.map(|item| u32::from(item[0])).collect(),
            DataType::U16 => items
                .map(|item| u32::from(u16::from_le_bytes([item[0], item[1]])))
                .collect(),
            DataType::U32 => items
                .map(|item| u32::from_le_bytes([item[0], item[1], item[2], item[3]]))
                .collect(),
            other => return Err(format!("indices of type {other:?}")),
        })
    }

    /// The bytes of each element of an accessor, checked against view and buffer.
    fn items<'s>(
        &'s self,
        accessor: &gltf::Accessor<'_>,
        kind: DataType,
        dimensions: Dimensions,
    ) -> Parsed<impl Iterator<Item = &'s [u8]>> {
        let refuse = |what: &str| format!("accessor {}: {what}", accessor.index());
        if accessor.data_type() != kind || accessor.dimensions() != dimensions {
            return Err(refuse(&format!(
                "holds {:?} of {:?}",
                accessor.dimensions(),
                accessor.data_type()
            )));
        }
        if accessor.sparse().is_some() {
            return Err(refuse("sparse accessors are not supported"));
        }
        let view = accessor.view().ok_or_else(|| refuse("has no buffer view"))?;
        let size = kind.size() * dimensions.multiplicity();
        let stride = view.stride().unwrap_or(size);
        let buffer = self
            .buffers
            .get(view.buffer().index())
            .ok_or_else(|| refuse("has no buffer"))?;
        let end = view.offset().checked_add(view.length());
        let view_bytes = end
            .and_then(|end| buffer.get(view.offset()..end))
            .ok_or_else(|| refuse("its view leaves the buffer"))?;
        let data = view_bytes
            .get(accessor.offset()..)
            .ok_or_else(|| refuse("it starts beyond its view"))?;
        let needed = accessor
            .count()
            .checked_sub(1)
            .map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        if stride < size || needed.is_none_or(|needed| needed > data.len()) {
            return Err(refuse("its elements leave the view"));
        }
        Ok((0..accessor.count()).map(move |index| &data[index * stride..index * stride + size]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad(extra_nodes: &str, index: u16) -> String {
        let mut bytes = Vec::new();
        for value in [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0] {
            bytes.extend(value.to_le_bytes());
        }
        for corner in [0u16, 1, 2, 0, 2, index] {
            bytes.extend(corner.to_le_bytes());
        }
        let data = base64::engine::general_purpose::STANDARD.encode(&bytes);
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
            "nodes":[{{"children":[1],"translation":[0,0,5]}},{{"mesh":0,"scale":[2,1,1]{extra_nodes}}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,0],"max":[1,1,0]}},
            {{"bufferView":1,"componentType":5123,"count":6,"type":"SCALAR"}}],
            "bufferViews":[{{"buffer":0,"byteOffset":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":12}}],
            "buffers":[{{"byteLength":60,"uri":"data:application/octet-stream;base64,{data}"}}]}}"#
        )
    }

    fn no_files(_: &str) -> Parsed<Vec<u8>> {
        Err("no file".into())
    }

    #[test]
    fn nodes_transform_and_indices_are_read() {
        let mesh = parse(quad("", 3).as_bytes(), &no_files).unwrap();
        assert_eq!(mesh.positions[2], [2.0, 1.0, 5.0]);
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    }

    #[test]
    fn damaged_files_say_what_is_wrong() {
        assert!(
            parse(quad("", 4).as_bytes(), &no_files)
                .unwrap_err()
                .contains("vertex 4 of 4")
        );
        assert!(
            parse(quad(r#","children":[0]"#, 3).as_bytes(), &no_files)
                .unwrap_err()
                .contains("without end")
        );
        let long = quad("", 3).replace(
            r#""byteOffset":48,"byteLength":12"#,
            r#""byteOffset":50,"byteLength":12"#,
        );
        assert!(
            parse(long.as_bytes(), &no_files)
                .unwrap_err()
                .contains("leaves the buffer")
        );
        let many = quad("", 3).replace(r#""count":6"#, r#""count":18446744073709551615"#);
        assert!(
            parse(many.as_bytes(), &no_files)
                .unwrap_err()
                .contains("leave the view")
        );
        let outside = quad("", 3).replace("data:application/octet-stream;base64,", "../secret.bin?");
        assert!(parse(outside.as_bytes(), &no_files).unwrap_err().contains("no file"));
        assert!(parse(b"{}", &no_files).unwrap_err().contains("not a glTF file"));
    }
}
