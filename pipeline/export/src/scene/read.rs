//! From the bytes of a scene to Gaussians: what the viewer does, for tests and for programs.

use rogs_splat::{Gaussians, sh};

use super::quantised::{ATTRIBUTES, Attributes, gaussians};
use super::{
    Header, LinkMesh, MESH_STEP_M, MOST_TIMES, SCENE_MAGIC, SCENE_VERSION, SceneHead, ScenePicture, Section, planes,
};
use crate::error::{Error, Result};

/// Longest header, bytes.
const LONGEST_HEADER: usize = 64 << 20;

/// A scene as it was read.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// What it is.
    pub head: SceneHead,
    /// Link id of every Gaussian, 255 for none; empty where nothing is known of it.
    pub link_of: Vec<u8>,
    /// Meshes of the robot's links.
    pub meshes: Vec<LinkMesh>,
    /// What the cameras recorded.
    pub pictures: Vec<ScenePicture>,
    /// What each time adds. `[T]`
    pub planes: Vec<ScenePlane>,
    degree: usize,
    position: Vec<i32>,
    attributes: Vec<Attributes>,
    harmonics: Vec<i32>,
}

/// What a time adds.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenePlane {
    /// How far each Gaussian has moved since the first time, in steps of a quarter of a millimetre. `[N, 3]`
    pub moved: Vec<i32>,
    rows: Vec<usize>,
    changed: Vec<Attributes>,
}

impl Scene {
    /// Reads a scene. What is allocated is bounded by the length of the file.
    ///
    /// # Errors
    /// When it is none, is cut off, or contradicts itself.
    pub fn parse(bytes: &[u8]) -> Result<Self> {
        let (header, body) = split(bytes)?;
        let file = File {
            sections: &header.sections,
            body,
        };
        let (count, degree) = (header.gaussians as usize, header.degree as usize);
        let times = header.head.times.len();
        if times == 0 || times > MOST_TIMES || degree > sh::MAX_DEGREE {
            return Err(wrong(format!("{times} times, harmonics of degree {degree}")));
        }
        let more = 3 * (sh::coefficient_count(degree) - 1);
        let mut scene = Self {
            position: file.rows("position", Some(count), 3)?,
            attributes: attributes(&file.rows("attributes", Some(count), ATTRIBUTES)?),
            harmonics: match more {
                0 => Vec::new(),
                more => file.rows("harmonics", Some(count), more)?,
            },
            link_of: Vec::new(),
            meshes: Vec::new(),
            pictures: Vec::new(),
            planes: Vec::new(),
            degree,
            head: header.head,
        };
        if file.section("link").is_ok() {
            let links = file.rows("link", Some(count), 1)?;
            scene.link_of = links.into_iter().map(|link| link.clamp(0, 255) as u8).collect();
        }
        for time in 0..times {
            scene.planes.push(plane(&file, time, count)?);
        }
        for link in 0..scene.head.links.len() {
            if file.section(&format!("mesh/{link}/positions")).is_ok() {
                scene.meshes.push(mesh(&file, link)?);
            }
        }
        for (camera, time) in
            (0..scene.head.cameras.len()).flat_map(|camera| (0..times).map(move |time| (camera, time)))
        {
            if let Ok(section) = file.section(&format!("picture/{camera}/{time}")) {
                let jpeg = file.bytes(section)?.to_vec();
                scene.pictures.push(ScenePicture { camera, time, jpeg });
            }
        }
        Ok(scene)
    }

    /// The Gaussians at a time of the head (index), metres, reconstruction frame; none where there is no such time.
    #[must_use]
    pub fn gaussians(&self, time: usize) -> Option<Gaussians> {
        let plane = self.planes.get(time)?;
        let pairs = self.position.iter().zip(&plane.moved);
        let centres: Vec<i32> = pairs.map(|(first, moved)| first.wrapping_add(*moved)).collect();
        let mut own = self.attributes.clone();
        for (row, changed) in plane.rows.iter().zip(&plane.changed) {
            own[*row] = *changed;
        }
        Some(gaussians(&centres, &own, self.degree, &self.harmonics))
    }
}

fn wrong(what: impl Into<String>) -> Error {
    Error::Scene { what: what.into() }
}

/// Header and sections.
fn split(bytes: &[u8]) -> Result<(Header, &[u8])> {
    let word = |at: usize| {
        let part = bytes.get(at..at + 4).and_then(|part| part.try_into().ok());
        part.map(u32::from_le_bytes)
    };
    if !bytes.starts_with(&SCENE_MAGIC) {
        return Err(wrong("the file does not begin as one"));
    }
    if word(8) != Some(SCENE_VERSION) {
        return Err(wrong(format!("version {:?}, expected {SCENE_VERSION}", word(8))));
    }
    let length = word(12).map_or(usize::MAX, |length| length as usize);
    let header = bytes[16.min(bytes.len())..]
        .get(..length)
        .filter(|_| length <= LONGEST_HEADER);
    let header = header.ok_or_else(|| wrong("the header is cut off"))?;
    let parsed = serde_json::from_slice(header).map_err(|error| wrong(format!("header: {error}")))?;
    Ok((parsed, &bytes[16 + length..]))
}

/// Sections by name.
struct File<'a> {
    sections: &'a [Section],
    body: &'a [u8],
}

impl<'a> File<'a> {
    fn section(&self, name: &str) -> Result<&'a Section> {
        let found = self.sections.iter().find(|section| section.name == name);
        found.ok_or_else(|| wrong(format!("there is no `{name}`")))
    }

    fn bytes(&self, section: &Section) -> Result<&'a [u8]> {
        let (from, length) = (section.offset as usize, section.bytes as usize);
        let to = from.checked_add(length).filter(|&to| to <= self.body.len());
        let to = to.ok_or_else(|| wrong(format!("`{}` is cut off", section.name)))?;
        Ok(&self.body[from..to])
    }

    /// The integers of a section, of so many rows where that is known.
    fn rows(&self, name: &str, rows: Option<usize>, channels: usize) -> Result<Vec<i32>> {
        let section = self.section(name)?;
        let found = section.rows as usize;
        if rows.is_some_and(|rows| rows != found) || section.widths.len() != channels {
            return Err(wrong(format!("`{name}` has {found} rows of {}", section.widths.len())));
        }
        let bytes = self.bytes(section)?;
        planes::unpack(bytes, found, &section.widths).map_err(|what| wrong(format!("`{name}`: {what}")))
    }
}

fn plane(file: &File<'_>, time: usize, count: usize) -> Result<ScenePlane> {
    let rows = file.rows(&format!("rows/{time}"), None, 1)?;
    let changed = file.rows(&format!("attributes/{time}"), Some(rows.len()), ATTRIBUTES)?;
    let index = |row: i32| usize::try_from(row).ok().filter(|&row| row < count);
    let rows: Option<Vec<usize>> = rows.into_iter().map(index).collect();
    Ok(ScenePlane {
        moved: file.rows(&format!("moved/{time}"), Some(count), 3)?,
        rows: rows.ok_or_else(|| wrong(format!("`rows/{time}` names a Gaussian that does not exist")))?,
        changed: attributes(&changed),
    })
}

fn mesh(file: &File<'_>, link: usize) -> Result<LinkMesh> {
    let positions = file.rows(&format!("mesh/{link}/positions"), None, 3)?;
    let triangles = file.rows(&format!("mesh/{link}/triangles"), None, 3)?;
    let corners = positions.len() / 3;
    if triangles
        .iter()
        .any(|&corner| usize::try_from(corner).map_or(true, |corner| corner >= corners))
    {
        return Err(wrong(format!(
            "mesh of link {link}: a triangle has a corner that does not exist"
        )));
    }
    let metres = |steps: &[i32; 3]| steps.map(|value| value as f32 * MESH_STEP_M);
    Ok(LinkMesh {
        link,
        positions: positions.as_chunks::<3>().0.iter().map(metres).collect(),
        triangles: (triangles.as_chunks::<3>().0.iter())
            .map(|corners| corners.map(|corner| corner as u32))
            .collect(),
    })
}

fn attributes(values: &[i32]) -> Vec<Attributes> {
    let short = |value: i32| value.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16;
    (values.as_chunks::<ATTRIBUTES>().0.iter())
        .map(|row| row.map(short))
        .collect()
}
