//! From the Gaussians of every time to the bytes of a scene.

use rayon::prelude::*;
use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, Gaussians};

use super::quantised::{ATTRIBUTES, Attributes, attributes, centre, harmonics};
use super::{Header, LinkMesh, MOST_TIMES, SCENE_MAGIC, SCENE_VERSION, SceneHead, ScenePicture, Section, planes};
use crate::error::{Error, Result};

/// What goes into a scene besides the Gaussians.
#[derive(Debug, Clone, Copy)]
pub struct SceneWriter<'a> {
    /// What it is.
    pub head: &'a SceneHead,
    /// Link id of every Gaussian, 255 for none; empty where nothing is known of it. `[N]`
    pub link_of: &'a [u8],
    /// Meshes of the robot's links.
    pub meshes: &'a [LinkMesh],
    /// What the cameras recorded.
    pub pictures: &'a [ScenePicture],
    /// Unit of the lengths of the Gaussians.
    pub unit: LengthUnit,
    /// Harmonics above this degree are left out.
    pub most_degree: usize,
}

impl SceneWriter<'_> {
    /// The bytes of the scene. `at` gives the Gaussians at a time of the head (index), row `n` the same Gaussian every time;
    /// it is asked twice for each time, so that never more than one time is held.
    ///
    /// # Errors
    /// Those of `at`; when the number of Gaussians changes, or the parts of the head do not fit each other.
    pub fn bytes<E: From<Error>>(&self, mut at: impl FnMut(usize) -> Result<Gaussians, E>) -> Result<Vec<u8>, E> {
        self.check()?;
        let mut file = Sections::default();
        let first = at(0)?;
        let count = first.len();
        if !self.link_of.is_empty() && self.link_of.len() != count {
            return Err(wrong(format!("{} links for {count} Gaussians", self.link_of.len())).into());
        }
        let degree = match first.colour {
            Colour::Rgb(_) => 0,
            Colour::Sh { degree, .. } => degree.min(self.most_degree),
        };
        let origin = centres(&first, self.unit);
        let rest = harmonics(&first, degree);
        let base = self.usual(first, &mut at)?;
        file.add_all(&[("position", &origin, 3), ("attributes", &flat(&base), ATTRIBUTES)]);
        if degree > 0 {
            file.add("harmonics", &rest, 3 * ((degree + 1) * (degree + 1) - 1));
        }
        if !self.link_of.is_empty() {
            let links: Vec<i32> = self.link_of.iter().map(|&link| i32::from(link)).collect();
            file.add("link", &links, 1);
        }
        self.add_meshes(&mut file);
        for time in 0..self.head.times.len() {
            let own = at(time)?;
            same_count(&own, count)?;
            let now = centres(&own, self.unit);
            let moved: Vec<i32> = now
                .iter()
                .zip(&origin)
                .map(|(now, first)| now.wrapping_sub(*first))
                .collect();
            let differs = |(index, base): (usize, &Attributes)| {
                let attributes = attributes(&own, self.unit, index);
                (attributes != *base).then_some((index as i32, attributes.map(i32::from)))
            };
            let changes: Vec<_> = base.par_iter().enumerate().filter_map(differs).collect();
            let (rows, changed): (Vec<i32>, Vec<[i32; ATTRIBUTES]>) = changes.into_iter().unzip();
            file.add_all(&[
                (&format!("moved/{time}"), &moved, 3),
                (&format!("rows/{time}"), &rows, 1),
                (&format!("attributes/{time}"), changed.as_flattened(), ATTRIBUTES),
            ]);
        }
        for picture in self.pictures {
            let name = format!("picture/{}/{}", picture.camera, picture.time);
            file.push(name, 0, Vec::new(), &picture.jpeg);
        }
        Ok(file.finish(self.head, count, degree)?)
    }

    /// What can be seen to be wrong before anything is asked for.
    fn check(&self) -> Result<()> {
        let head = self.head;
        let times = head.times.len();
        if times == 0 || times > MOST_TIMES {
            return Err(wrong(format!("{times} times, expected 1 to {MOST_TIMES}")));
        }
        if head
            .cameras
            .iter()
            .any(|camera| camera.recon_from_camera.len() != times)
        {
            return Err(wrong("a camera has not one pose for every time"));
        }
        let posed = head.recon_from_link.len() == times || head.recon_from_link.is_empty();
        if !posed || head.recon_from_link.iter().any(|links| links.len() != head.links.len()) {
            return Err(wrong("the robot has not one pose for every link and time"));
        }
        let strange = self.meshes.iter().any(|mesh| mesh.link >= head.links.len());
        let unseen = |picture: &ScenePicture| picture.camera >= head.cameras.len() || picture.time >= times;
        if strange || self.pictures.iter().any(unseen) {
            return Err(wrong(
                "a mesh or picture belongs to no link, camera or time of the head",
            ));
        }
        Ok(())
    }

    /// The attributes that each Gaussian has most of the time: the value that outlives a vote in which every other one takes
    /// a voice away (Boyer and Moore), which is the one of more than half of the times where there is such.
    fn usual<E: From<Error>>(
        &self,
        first: Gaussians,
        at: &mut impl FnMut(usize) -> Result<Gaussians, E>,
    ) -> Result<Vec<Attributes>, E> {
        let count = first.len();
        let mut own = first;
        let mut usual: Vec<Attributes> = Vec::new();
        let mut voices = vec![0u16; count];
        for time in 0..self.head.times.len() {
            if time == 0 {
                usual = (0..count)
                    .into_par_iter()
                    .map(|index| attributes(&own, self.unit, index))
                    .collect();
                voices.fill(1);
                continue;
            }
            own = at(time)?;
            same_count(&own, count)?;
            let vote = |(index, (usual, voices)): (usize, (&mut Attributes, &mut u16))| {
                let attributes = attributes(&own, self.unit, index);
                if attributes == *usual {
                    *voices += 1;
                } else if *voices == 0 {
                    (*usual, *voices) = (attributes, 1);
                } else {
                    *voices -= 1;
                }
            };
            usual.par_iter_mut().zip(&mut voices).enumerate().for_each(vote);
        }
        Ok(usual)
    }

    fn add_meshes(&self, file: &mut Sections) {
        for mesh in self.meshes {
            let steps = |value: &f32| libm::roundf(value / super::MESH_STEP_M) as i32;
            let positions: Vec<i32> = mesh.positions.iter().flatten().map(steps).collect();
            let triangles: Vec<i32> = mesh.triangles.iter().flatten().map(|&corner| corner as i32).collect();
            file.add(&format!("mesh/{}/positions", mesh.link), &positions, 3);
            file.add(&format!("mesh/{}/triangles", mesh.link), &triangles, 3);
        }
    }
}

fn same_count(gaussians: &Gaussians, count: usize) -> Result<()> {
    if gaussians.len() == count {
        return Ok(());
    }
    Err(wrong(format!(
        "{} Gaussians at one time, {count} at another",
        gaussians.len()
    )))
}

fn wrong(what: impl Into<String>) -> Error {
    Error::Scene { what: what.into() }
}

/// Centres in steps. `[N, 3]`
fn centres(gaussians: &Gaussians, unit: LengthUnit) -> Vec<i32> {
    let rows = (0..gaussians.len()).into_par_iter();
    rows.flat_map_iter(|index| centre(gaussians, unit, index)).collect()
}

fn flat(attributes: &[Attributes]) -> Vec<i32> {
    attributes.iter().flatten().map(|&value| i32::from(value)).collect()
}

/// Sections one behind the other.
#[derive(Default)]
struct Sections {
    table: Vec<Section>,
    bytes: Vec<u8>,
}

impl Sections {
    fn add(&mut self, name: &str, values: &[i32], channels: usize) {
        let (widths, packed) = planes::pack(values, channels);
        self.push(name.to_owned(), values.len() / channels, widths, &packed);
    }

    /// Sections that are packed side by side: names, values, channels.
    fn add_all(&mut self, sections: &[(&str, &[i32], usize)]) {
        let packed = sections.par_iter();
        let packed: Vec<_> = packed
            .map(|(_, values, channels)| planes::pack(values, *channels))
            .collect();
        for ((name, values, channels), (widths, bytes)) in sections.iter().zip(packed) {
            self.push((*name).to_owned(), values.len() / channels, widths, &bytes);
        }
    }

    fn push(&mut self, name: String, rows: usize, widths: Vec<u8>, bytes: &[u8]) {
        self.table.push(Section {
            name,
            offset: self.bytes.len() as u64,
            bytes: bytes.len() as u64,
            rows: rows as u32,
            widths,
        });
        self.bytes.extend_from_slice(bytes);
    }

    /// Prologue, header, sections.
    fn finish(self, head: &SceneHead, count: usize, degree: usize) -> Result<Vec<u8>> {
        let header = Header {
            head: head.clone(),
            gaussians: count as u32,
            degree: degree as u32,
            sections: self.table,
        };
        let header = serde_json::to_vec(&header).map_err(|error| wrong(error.to_string()))?;
        let mut out = Vec::with_capacity(16 + header.len() + self.bytes.len());
        out.extend_from_slice(&SCENE_MAGIC);
        out.extend_from_slice(&SCENE_VERSION.to_le_bytes());
        out.extend_from_slice(&(header.len() as u32).to_le_bytes());
        out.extend_from_slice(&header);
        out.extend_from_slice(&self.bytes);
        Ok(out)
    }
}
