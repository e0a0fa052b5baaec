//! glTF 2.0 (`.gltf`, `.glb`): triangles of the scene after the node transforms.

use std::collections::BTreeSet;

use base64::Engine as _;
use glam::{DAffine3, DMat4, DVec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::json::validation::{Checked, Error as Fault};
use gltf::mesh::Mode;
use rogs_schemas::records::robot::MeshAxes;

use super::axes::{self, Up};
use super::{MAX_FILE_BYTES, MAX_TRIANGLES, Mesh, Parsed, fan, strip};

const MAX_INSTANCES: usize = 20_000;
const MAX_DEPTH: usize = 64;

/// Extensions that a file may require: how positions are stored, which is read, and how surfaces look, which does not
/// matter. A name that ends in `_` stands for all that begin with it.
const READABLE: [&str; 9] = [
    "KHR_mesh_quantization",
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_punctual",
    "KHR_xmp_",
    "EXT_texture_",
    "EXT_lights_",
    "MSFT_texture_dds",
    "KHR_animation_pointer",
];

pub(super) fn parse(bytes: &[u8], axes: MeshAxes, external: &dyn Fn(&str) -> Parsed<Vec<u8>>) -> Parsed<Mesh> {
    check_container(bytes)?;
    let gltf::Gltf { document, blob } = gltf::Gltf::from_slice_without_validation(bytes).map_err(refuse)?;
    let mut root = document.into_json();
    check_extensions(&root)?;
    check_attributes(&root)?;
    // They were checked here, by what they mean for shapes; the library knows fewer.
    root.extensions_required.clear();
    fill_in_bounds(&mut root);
    let file = gltf::Document::from_json(root).map_err(refuse)?;
    let buffers = buffers(&file, blob, external)?;
    let mut reader = Reader {
        buffers,
        mesh: Mesh::default(),
        instances: 0,
    };
    let scene = file.default_scene().or_else(|| file.scenes().next());
    let nodes: Vec<gltf::Node<'_>> = match scene {
        Some(scene) => scene.nodes().collect(),
        // A library of parts: every node that is nobody's child.
        None => {
            let children: BTreeSet<usize> = (file.nodes().flat_map(|node| node.children().collect::<Vec<_>>()))
                .map(|child| child.index())
                .collect();
            file.nodes().filter(|node| !children.contains(&node.index())).collect()
        }
    };
    // The standard's y up is said by no file, so there is nothing to note.
    let (turn, _) = axes::turn(axes, Up::Unsaid);
    for node in nodes {
        reader.node(&node, DAffine3::from_mat3(turn), 0)?;
    }
    Ok(reader.mesh)
}

/// What the library found, in words of the format: the first fault and where it is.
fn refuse(error: gltf::Error) -> String {
    let gltf::Error::Validation(faults) = error else {
        return format!("not a glTF file: {error}");
    };
    let more = match faults.len() {
        0 | 1 => String::new(),
        count => format!(", and {} more faults", count - 1),
    };
    let first = faults.first().map(|(path, fault)| {
        let what = match fault {
            Fault::IndexOutOfBounds => "points at nothing",
            Fault::Missing => "is missing",
            Fault::Oversize => "is too large",
            Fault::Unsupported => "is an extension that is not read",
            Fault::Invalid => "has an invalid value",
        };
        format!("`{path}` {what}")
    });
    format!("not a valid glTF file: {}{more}", first.unwrap_or_default())
}

/// Refuses extensions without which the shapes cannot be known, by name and with the way on.
fn check_extensions(root: &gltf::json::Root) -> Parsed<()> {
    let readable = |name: &str| {
        let known = |known: &&str| name == *known || (known.ends_with('_') && name.starts_with(*known));
        READABLE.iter().any(known)
    };
    match root.extensions_required.iter().find(|name| !readable(name)) {
        None => Ok(()),
        Some(name) if name.contains("draco") || name.contains("meshopt") => Err(format!(
            "its geometry is compressed (`{name}`), which is not read; export it again without compression, or \
             decompress it, e.g. `gltf-transform copy in.glb out.glb`"
        )),
        Some(name) => Err(format!(
            "it requires the extension `{name}`, which is not read; export it without"
        )),
    }
}

/// The library insists on the bounds of positions, which are not used here and which some writers leave out.
fn fill_in_bounds(root: &mut gltf::json::Root) {
    let positions: Vec<usize> = (root.meshes.iter().flat_map(|mesh| &mesh.primitives))
        .filter_map(|primitive| primitive.attributes.get(&Checked::Valid(gltf::Semantic::Positions)))
        .map(|accessor| accessor.value())
        .collect();
    for index in positions {
        if let Some(accessor) = root.accessors.get_mut(index) {
            let bounds = || Some(serde_json::json!([0.0, 0.0, 0.0]));
            (accessor.min, accessor.max) = (bounds(), bounds());
        }
    }
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
        let kind = positions.data_type();
        let items = self.items(&positions, kind, Dimensions::Vec3)?;
        let number = component(kind, positions.normalized());
        let to_scene = |item: &[u8]| {
            let value = |axis: usize| number(&item[axis * kind.size()..]);
            scene_from_node
                .transform_point3(DVec3::new(value(0), value(1), value(2)))
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
        let corners: Vec<u32> = corners.iter().map(|corner| corner + start as u32).collect();
        match mode {
            Mode::TriangleStrip => strip(&corners, &mut self.mesh.triangles),
            Mode::TriangleFan => fan(&corners, &mut self.mesh.triangles),
            _ => {
                if !corners.len().is_multiple_of(3) {
                    return Err(format!("{} corners make no triangles", corners.len()));
                }
                let triangles = corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]);
                self.mesh.triangles.extend(triangles);
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

/// The reader of one number of a kind, little-endian. Integers are steps, or with `normalized` parts of their range (glTF
/// 2.0 specification, section 3.11; extension `KHR_mesh_quantization`).
fn component(kind: DataType, normalized: bool) -> impl Fn(&[u8]) -> f64 {
    move |bytes| {
        let (value, range) = match kind {
            DataType::I8 => (f64::from(bytes[0].cast_signed()), f64::from(i8::MAX)),
            DataType::U8 => (f64::from(bytes[0]), f64::from(u8::MAX)),
            DataType::I16 => (f64::from(i16::from_le_bytes([bytes[0], bytes[1]])), f64::from(i16::MAX)),
            DataType::U16 => (f64::from(u16::from_le_bytes([bytes[0], bytes[1]])), f64::from(u16::MAX)),
            DataType::U32 => (
                f64::from(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
                1.0,
            ),
            DataType::F32 => (
                f64::from(f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])),
                1.0,
            ),
        };
        if normalized { (value / range).max(-1.0) } else { value }
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

    fn parse(bytes: &[u8], external: &dyn Fn(&str) -> Parsed<Vec<u8>>) -> Parsed<Mesh> {
        super::parse(bytes, MeshAxes::Viewers, external)
    }

    /// A file of one triangle whose positions are `data`, numbers of a type.
    fn quantized(kind: u32, normalized: bool, data: &[u8], node: &str, head: &str) -> String {
        let bytes = base64::engine::general_purpose::STANDARD.encode(data);
        let stride = data.len() / 3;
        format!(
            r#"{{"asset":{{"version":"2.0"}},{head}"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0{node}}}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}}}}]}}],
            "accessors":[{{"bufferView":0,"componentType":{kind},"normalized":{normalized},"count":3,"type":"VEC3"}}],
            "bufferViews":[{{"buffer":0,"byteLength":{},"byteStride":{stride}}}],
            "buffers":[{{"byteLength":{},"uri":"data:application/octet-stream;base64,{bytes}"}}]}}"#,
            data.len(),
            data.len(),
        )
    }

    #[test]
    fn positions_of_every_type() {
        let required = r#""extensionsRequired":["KHR_mesh_quantization","KHR_materials_unlit"],"#;
        let padded = |numbers: [[u8; 3]; 3]| numbers.iter().flat_map(|n| [n[0], n[1], n[2], 0]).collect::<Vec<u8>>();
        let words = |numbers: [[i16; 3]; 3]| {
            let bytes = numbers
                .iter()
                .flat_map(|n| [n[0], n[1], n[2], 0])
                .flat_map(i16::to_le_bytes);
            bytes.collect::<Vec<u8>>()
        };
        let cases = [
            // signed bytes: -1 is 255
            (
                5120,
                false,
                padded([[1, 0, 0], [0, 255, 0], [0, 0, 3]]),
                [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 3.0]],
            ),
            (
                5120,
                true,
                padded([[127, 0, 0], [0, 128, 0], [0, 0, 0]]),
                [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0; 3]],
            ),
            (
                5121,
                false,
                padded([[255, 0, 0], [0, 2, 0], [0, 0, 0]]),
                [[255.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0; 3]],
            ),
            (
                5121,
                true,
                padded([[255, 0, 0], [0, 51, 0], [0, 0, 0]]),
                [[1.0, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0; 3]],
            ),
            (
                5122,
                false,
                words([[300, 0, 0], [0, -2, 0], [0, 0, 0]]),
                [[300.0, 0.0, 0.0], [0.0, -2.0, 0.0], [0.0; 3]],
            ),
            (
                5122,
                true,
                words([[32767, 0, 0], [0, -32768, 0], [0, 0, 0]]),
                [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0; 3]],
            ),
            (
                5123,
                false,
                words([[-1, 0, 0], [0, 2, 0], [0, 0, 0]]),
                [[65535.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0; 3]],
            ),
            (
                5123,
                true,
                words([[-1, 0, 0], [0, 0, 0], [0, 0, -1]]),
                [[1.0, 0.0, 0.0], [0.0; 3], [0.0, 0.0, 1.0]],
            ),
        ];
        for (kind, normalized, data, expected) in cases {
            let mesh = parse(quantized(kind, normalized, &data, "", required).as_bytes(), &no_files).unwrap();
            assert_eq!(mesh.positions, expected, "{kind} {normalized}");
        }
        // The node undoes the steps, as writers do.
        let data = words([[2000, 0, 0], [0, 1000, 0], [0, 0, 500]]);
        let text = quantized(5122, false, &data, r#","scale":[0.001,0.001,0.001]"#, required);
        let mesh = parse(text.as_bytes(), &no_files).unwrap();
        assert!((mesh.positions[0][0] - 2.0).abs() < 1e-6 && (mesh.positions[2][2] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn y_up_turns_where_the_standard_is_asked_for() {
        let file = quad("", 3);
        let turned = super::parse(file.as_bytes(), MeshAxes::Standard, &no_files).unwrap();
        assert_eq!(turned.positions[2], [2.0, -5.0, 1.0]);
    }

    #[test]
    fn required_extensions_are_named_with_a_way_on() {
        for (name, words) in [
            ("KHR_draco_mesh_compression", "without compression"),
            ("EXT_meshopt_compression", "without compression"),
            ("KHR_meshopt_compression", "without compression"),
            ("EXT_mesh_gpu_instancing", "export it without"),
        ] {
            let head = format!(r#""extensionsRequired":["{name}"],"#);
            let message = parse(quantized(5126, false, &[0; 36], "", &head).as_bytes(), &no_files).unwrap_err();
            assert!(message.contains(name) && message.contains(words), "{message}");
        }
    }

    #[test]
    fn faults_are_told_in_words_of_the_format() {
        let text = quad("", 3).replace(r#""bufferView":1"#, r#""bufferView":7"#);
        let message = parse(text.as_bytes(), &no_files).unwrap_err();
        assert_eq!(
            message,
            "not a valid glTF file: `accessors[1].bufferView` points at nothing"
        );
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
