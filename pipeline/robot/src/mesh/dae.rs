//! COLLADA (`.dae`): triangles, polylists, polygons, strips and fans of the visual scene, converted to metres.

use std::collections::BTreeMap;

use glam::{DAffine3, DMat3, DMat4, DVec3};
use rogs_schemas::records::robot::MeshAxes;
use roxmltree::Node;

use super::axes::{self, Up};
use super::{MAX_TRIANGLES, Mesh, MeshFile, Parsed, fan, strip};
use crate::model::guard::XmlLimits;
use crate::model::xml::{child, is, text_of, with_root};

const LIMITS: XmlLimits = XmlLimits {
    depth: 64,
    attributes: 48,
    elements: 2_000_000,
};
/// Bound on nodes visited, because nodes may be instantiated many times.
const MAX_INSTANCES: usize = 20_000;
const MAX_DEPTH: usize = 64;

pub(super) fn parse(bytes: &[u8], axes: MeshAxes) -> Parsed<MeshFile> {
    with_root(&text_of(bytes)?, LIMITS, |root| scene(root, axes))
}

fn scene(root: Node<'_, '_>, axes: MeshAxes) -> Parsed<MeshFile> {
    if root.tag_name().name() != "COLLADA" {
        return Err(format!("its root element is `{}`, not COLLADA", root.tag_name().name()));
    }
    let mut reader = Reader::new(root);
    let (metres, up) = asset(root)?;
    let (turn, note) = axes::turn(axes, up);
    let scene_from_file = DAffine3::from_mat3(turn * DMat3::from_diagonal(DVec3::splat(metres)));
    match visual_scene(root, &reader.ids) {
        Some(scene) => reader.nodes(scene, scene_from_file, 0)?,
        None => {
            let geometries: Vec<Node<'_, '_>> = root.descendants().filter(|node| is(*node, "geometry")).collect();
            for geometry in geometries {
                reader.geometry(geometry, scene_from_file)?;
            }
        }
    }
    Ok(MeshFile {
        mesh: reader.mesh,
        notes: note.into_iter().collect(),
    })
}

fn children<'a, 'i: 'a>(node: Node<'a, 'i>, name: &'a str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |node| is(*node, name))
}

/// Metres per file unit, and the axis that the file calls up.
fn asset(root: Node<'_, '_>) -> Parsed<(f64, Up)> {
    let asset = child(root, "asset");
    let unit = asset
        .and_then(|asset| child(asset, "unit"))
        .and_then(|unit| unit.attribute("meter"));
    let metres = match unit {
        None => 1.0,
        Some(text) => text
            .trim()
            .parse::<f64>()
            .ok()
            .filter(|value| (1e-9..1e9).contains(value))
            .ok_or_else(|| format!("its unit is `{text}` metres"))?,
    };
    let axis = asset
        .and_then(|asset| child(asset, "up_axis"))
        .and_then(|axis| axis.text())
        .map(str::trim);
    let up = match axis.map(str::to_ascii_uppercase).as_deref() {
        // The standard's default, written by nobody.
        None | Some("") => Up::Unsaid,
        Some("Z_UP") => Up::Z,
        Some("Y_UP") => Up::Y,
        Some("X_UP") => Up::X,
        Some(other) => return Err(format!("its up axis is `{other}`; known are X_UP, Y_UP, Z_UP")),
    };
    Ok((metres, up))
}

fn visual_scene<'a, 'i>(root: Node<'a, 'i>, ids: &BTreeMap<&'a str, Node<'a, 'i>>) -> Option<Node<'a, 'i>> {
    let url = child(root, "scene")
        .and_then(|scene| child(scene, "instance_visual_scene"))?
        .attribute("url")?;
    ids.get(url.strip_prefix('#')?).copied()
}

struct Reader<'a, 'i> {
    ids: BTreeMap<&'a str, Node<'a, 'i>>,
    mesh: Mesh,
    instances: usize,
}

impl<'a, 'i> Reader<'a, 'i> {
    fn new(root: Node<'a, 'i>) -> Self {
        let with_id = |node: Node<'a, 'i>| node.attribute("id").map(|id| (id, node));
        Self {
            ids: root.descendants().filter_map(with_id).collect(),
            mesh: Mesh::default(),
            instances: 0,
        }
    }

    fn target(&self, node: Node<'a, 'i>, attribute: &str) -> Parsed<Node<'a, 'i>> {
        let url = node.attribute(attribute).unwrap_or_default();
        let id = url
            .strip_prefix('#')
            .ok_or_else(|| format!("`{url}` refers to another file"))?;
        self.ids
            .get(id)
            .copied()
            .ok_or_else(|| format!("nothing has the id `{id}`"))
    }

    fn nodes(&mut self, parent: Node<'a, 'i>, scene_from_parent: DAffine3, depth: usize) -> Parsed<()> {
        let nodes: Vec<Node<'a, 'i>> = parent.children().filter(|node| is(*node, "node")).collect();
        for node in nodes {
            self.node(node, scene_from_parent, depth)?;
        }
        Ok(())
    }

    fn node(&mut self, node: Node<'a, 'i>, scene_from_parent: DAffine3, depth: usize) -> Parsed<()> {
        self.instances += 1;
        if depth > MAX_DEPTH || self.instances > MAX_INSTANCES {
            return Err("its nodes are nested or instantiated without end".into());
        }
        let scene_from_node = scene_from_parent * node_transform(node)?;
        for part in node.children().filter(Node::is_element) {
            match part.tag_name().name() {
                "instance_geometry" => {
                    let geometry = self.target(part, "url")?;
                    self.geometry(geometry, scene_from_node)?;
                }
                "instance_node" => {
                    let instance = self.target(part, "url")?;
                    self.node(instance, scene_from_node, depth + 1)?;
                }
                "instance_controller" => {
                    return Err(
                        "its geometry is skinned (`instance_controller`); apply the armature when you export it".into(),
                    );
                }
                _ => {}
            }
        }
        self.nodes(node, scene_from_node, depth + 1)
    }

    fn geometry(&mut self, geometry: Node<'a, 'i>, scene_from_node: DAffine3) -> Parsed<()> {
        self.instances += 1;
        let Some(mesh) = child(geometry, "mesh") else {
            return Ok(());
        };
        for primitive in mesh.children().filter(Node::is_element) {
            match primitive.tag_name().name() {
                "triangles" | "polylist" | "polygons" | "tristrips" | "trifans" => {
                    self.primitive(primitive, scene_from_node)?;
                }
                _ => {}
            }
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: Node<'a, 'i>, scene_from_node: DAffine3) -> Parsed<()> {
        let (mut stride, mut vertex) = (0usize, None);
        for input in children(primitive, "input") {
            let offset = attribute_number(input, "offset")?;
            stride = stride.max(offset + 1);
            if input.attribute("semantic") == Some("VERTEX") {
                vertex = Some((offset, self.target(input, "source")?));
            }
        }
        let (offset, vertices) = vertex.ok_or("a primitive has no VERTEX input")?;
        if stride > 64 {
            return Err(format!("a primitive has an input offset of {}", stride - 1));
        }
        let start = self.mesh.positions.len();
        let position = children(vertices, "input").find(|input| input.attribute("semantic") == Some("POSITION"));
        let source = self.target(position.ok_or("vertices have no POSITION input")?, "source")?;
        let count = self.positions(source, scene_from_node)?;
        let sizes = match (primitive.tag_name().name(), child(primitive, "vcount")) {
            ("polylist", Some(counts)) => numbers::<u32>(counts)?,
            ("polylist", None) => return Err("a polylist has no vcount".into()),
            _ => Vec::new(),
        };
        let mut sizes = sizes.into_iter();
        if child(primitive, "ph").is_some() {
            return Err("it has polygons with holes; triangulate the mesh when you export it".into());
        }
        for indices in children(primitive, "p") {
            let corners = corners(&numbers::<u32>(indices)?, stride, offset, start, count)?;
            match primitive.tag_name().name() {
                "triangles" => {
                    if !corners.len().is_multiple_of(3) {
                        return Err(format!("{} corners make no triangles", corners.len()));
                    }
                    self.mesh
                        .triangles
                        .extend(corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]));
                }
                "polylist" => {
                    let mut rest = corners.as_slice();
                    for size in sizes.by_ref() {
                        let (polygon, after) = rest
                            .split_at_checked(size as usize)
                            .ok_or("vcount asks for more corners than there are")?;
                        fan(polygon, &mut self.mesh.triangles);
                        rest = after;
                    }
                }
                "tristrips" => strip(&corners, &mut self.mesh.triangles),
                _ => fan(&corners, &mut self.mesh.triangles),
            }
            if self.mesh.triangles.len() > MAX_TRIANGLES {
                return Err("it has too many triangles".into());
            }
        }
        Ok(())
    }

    /// Appends the positions of a source and returns their number.
    fn positions(&mut self, source: Node<'a, 'i>, scene_from_node: DAffine3) -> Parsed<usize> {
        let array = child(source, "float_array").ok_or("a position source has no float_array")?;
        let values = numbers::<f64>(array)?;
        let accessor = child(source, "technique_common").and_then(|technique| child(technique, "accessor"));
        let (stride, offset) = match accessor {
            Some(accessor) => (
                attribute_number(accessor, "stride")?.max(1),
                attribute_number(accessor, "offset")?,
            ),
            None => (3, 0),
        };
        if !(3..=64).contains(&stride) {
            return Err(format!("positions have a stride of {stride}"));
        }
        let values = values.get(offset..).ok_or("positions start beyond their array")?;
        let start = self.mesh.positions.len();
        if start + values.len() / stride > 3 * MAX_TRIANGLES {
            return Err("it has too many vertices".into());
        }
        let to_scene = |value: &[f64]| {
            scene_from_node
                .transform_point3(DVec3::new(value[0], value[1], value[2]))
                .as_vec3()
                .to_array()
        };
        self.mesh
            .positions
            .extend(values.chunks(stride).filter(|chunk| chunk.len() >= 3).map(to_scene));
        Ok(self.mesh.positions.len() - start)
    }
}

/// Picks the vertex indices out of interleaved indices and shifts them to the mesh.
fn corners(indices: &[u32], stride: usize, offset: usize, start: usize, count: usize) -> Parsed<Vec<u32>> {
    let shifted = |index: u32| {
        let inside = (index as usize) < count;
        if inside {
            Ok(index + start as u32)
        } else {
            Err(format!("vertex {index} of {count}"))
        }
    };
    indices
        .iter()
        .skip(offset)
        .step_by(stride)
        .map(|&index| shifted(index))
        .collect()
}

/// The product of a node's transform elements, in document order.
fn node_transform(node: Node<'_, '_>) -> Parsed<DAffine3> {
    let mut transform = DAffine3::IDENTITY;
    for part in node.children().filter(Node::is_element) {
        let name = part.tag_name().name();
        let expected = match name {
            "matrix" => 16,
            "translate" | "scale" => 3,
            "rotate" => 4,
            "skew" | "lookat" => {
                return Err(format!(
                    "the node transform `{name}` is not read; export the mesh with matrices"
                ));
            }
            _ => continue,
        };
        let values = numbers::<f64>(part)?;
        if values.len() != expected || !values.iter().all(|value| value.is_finite()) {
            return Err(format!("a `{name}` needs {expected} finite numbers"));
        }
        let vector = |at: usize| DVec3::new(values[at], values[at + 1], values[at + 2]);
        transform *= match name {
            "matrix" => {
                let columns: [f64; 16] = std::array::from_fn(|index| values[(index % 4) * 4 + index / 4]);
                DAffine3::from_mat4(DMat4::from_cols_array(&columns))
            }
            "translate" => DAffine3::from_translation(vector(0)),
            "scale" => DAffine3::from_scale(vector(0)),
            _ => {
                let axis = vector(0).try_normalize().ok_or("a `rotate` has no axis")?;
                DAffine3::from_mat3(rogs_geometry::rotation_about_axis(axis, values[3].to_radians()))
            }
        };
    }
    Ok(transform)
}

fn numbers<T: std::str::FromStr>(node: Node<'_, '_>) -> Parsed<Vec<T>> {
    let mut values = Vec::new();
    for text in node
        .children()
        .filter_map(|child| child.is_text().then(|| child.text()).flatten())
    {
        for word in text.split_ascii_whitespace() {
            let name = node.tag_name().name();
            values.push(word.parse().map_err(|_| {
                format!(
                    "invalid number `{}` in a `{name}`",
                    word.chars().take(20).collect::<String>()
                )
            })?);
        }
    }
    Ok(values)
}

fn attribute_number(node: Node<'_, '_>, name: &str) -> Parsed<usize> {
    match node.attribute(name) {
        None => Ok(0),
        Some(text) => text
            .trim()
            .parse::<u32>()
            .map(|value| value as usize)
            .map_err(|_| format!("invalid count `{text}` in the attribute `{name}`")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(bytes: &[u8]) -> Parsed<Mesh> {
        super::parse(bytes, MeshAxes::Viewers).map(|file| file.mesh)
    }

    fn document(up: &str, node: &str, primitive: &str) -> String {
        format!(
            r##"<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
            <asset><unit name="centimeter" meter="0.01"/><up_axis>{up}</up_axis></asset>
            <library_geometries><geometry id="g"><mesh>
              <source id="s"><float_array id="a" count="12">0 0 0 100 0 0 100 200 0 0 200 0</float_array>
                <technique_common><accessor source="#a" count="4" stride="3"/></technique_common></source>
              <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>{primitive}
            </mesh></geometry></library_geometries>
            <library_visual_scenes><visual_scene id="scene"><node>{node}<instance_geometry url="#g"/></node></visual_scene></library_visual_scenes>
            <scene><instance_visual_scene url="#scene"/></scene></COLLADA>"##
        )
    }

    const POLYLIST: &str = r##"<polylist count="1"><input semantic="NORMAL" source="#s" offset="1"/><input semantic="VERTEX" source="#v" offset="0"/>
        <vcount>4</vcount><p>0 0 1 0 2 0 3 0</p></polylist>"##;

    #[test]
    fn units_axes_and_node_transforms() {
        let node = "<translate>0 0 50</translate><rotate>0 0 1 90</rotate><scale>2 1 1</scale>";
        let mesh = parse(document("Z_UP", node, POLYLIST).as_bytes()).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        let near = |a: [f32; 3], b: [f32; 3]| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-6);
        assert!(near(mesh.positions[1], [0.0, 2.0, 0.5]), "{:?}", mesh.positions);
        assert!(near(mesh.positions[3], [-2.0, 0.0, 0.5]), "{:?}", mesh.positions);
    }

    #[test]
    fn strips_and_fans() {
        let input = r##"<input semantic="VERTEX" source="#v" offset="0"/>"##;
        let triangles = |kind: &str| {
            let primitive = format!("<{kind} count='1'>{input}<p>0 1 3 2</p></{kind}>");
            parse(document("Z_UP", "", &primitive).as_bytes()).unwrap().triangles
        };
        assert_eq!(triangles("tristrips"), [[0, 1, 3], [3, 1, 2]]);
        assert_eq!(triangles("trifans"), [[0, 1, 3], [0, 3, 2]]);
    }

    #[test]
    fn triangles_and_polygons() {
        let input = r##"<input semantic="VERTEX" source="#v" offset="0"/>"##;
        let triangles = document(
            "Z_UP",
            "",
            &format!("<triangles count='1'>{input}<p>0 1 2</p></triangles>"),
        );
        assert_eq!(parse(triangles.as_bytes()).unwrap().triangles, [[0, 1, 2]]);
        let polygons = document(
            "Z_UP",
            "",
            &format!("<polygons count='2'>{input}<p>0 1 2 3</p><p>1 2 3</p></polygons>"),
        );
        assert_eq!(parse(polygons.as_bytes()).unwrap().triangles.len(), 3);
    }

    #[test]
    fn damaged_files_say_what_is_wrong() {
        let input = r##"<input semantic="VERTEX" source="#v" offset="0"/>"##;
        let wrong = |primitive: String| parse(document("Z_UP", "", &primitive).as_bytes()).unwrap_err();
        assert!(wrong(format!("<triangles>{input}<p>0 1 4</p></triangles>")).contains("vertex 4 of 4"));
        assert!(wrong(format!("<triangles>{input}<p>0 1</p></triangles>")).contains("no triangles"));
        assert!(wrong(format!("<polylist>{input}<vcount>5</vcount><p>0 1 2 3</p></polylist>")).contains("vcount"));
        assert!(wrong("<triangles><p>0 1 2</p></triangles>".into()).contains("VERTEX"));
        assert!(parse(b"<a/>").unwrap_err().contains("COLLADA"));
        let endless = document("Z_UP", "<instance_node url='#n'/>", "").replace(
            "<visual_scene id",
            "<node id='n'><instance_node url='#n'/></node><visual_scene id",
        );
        assert!(parse(endless.as_bytes()).unwrap_err().contains("without end"));
    }
}
