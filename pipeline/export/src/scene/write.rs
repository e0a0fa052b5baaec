//! From the Gaussians of every time to the bytes of a scene.

use rayon::prelude::*;
use rogs_schemas::units::LengthUnit;
use rogs_splat::{Colour, Gaussians};

use super::looks::Looks;
use super::quantised::{ATTRIBUTES, centre, harmonics};
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

/// The Gaussians of a time.
#[derive(Debug, Clone, Copy)]
pub struct Moment<'a> {
    /// Row `n` is the same Gaussian every time.
    pub gaussians: &'a Gaussians,
    /// 0 for those whose attributes, centres aside, are the same at all times at which they are marked so; `None` where
    /// nothing is known of it. `[N]`
    pub open: Option<&'a [u8]>,
}

/// Gaussians over time.
pub trait Moments {
    /// Why there are none.
    type Error: From<Error>;

    /// The Gaussians at a time of the head (index). The first one is asked for twice.
    ///
    /// # Errors
    /// When there are none.
    fn at(&mut self, time: usize) -> Result<Moment<'_>, Self::Error>;
}

/// Gaussians made anew for every time.
struct Every<F> {
    at: F,
    gaussians: Gaussians,
}

impl<E: From<Error>, F: FnMut(usize) -> Result<Gaussians, E>> Moments for Every<F> {
    type Error = E;

    fn at(&mut self, time: usize) -> Result<Moment<'_>, E> {
        self.gaussians = (self.at)(time)?;
        Ok(Moment {
            gaussians: &self.gaussians,
            open: None,
        })
    }
}

impl SceneWriter<'_> {
    /// The bytes of the scene. `at` gives the Gaussians at a time of the head (index), row `n` the same Gaussian every time;
    /// it is asked for each time in their order, for the first one twice. One time is held, and what has changed.
    ///
    /// # Errors
    /// Those of `at`; when the number of Gaussians changes, or the parts of the head do not fit each other.
    pub fn bytes<E: From<Error>>(&self, at: impl FnMut(usize) -> Result<Gaussians, E>) -> Result<Vec<u8>, E> {
        self.bytes_of(&mut Every {
            at,
            gaussians: Gaussians::empty(),
        })
    }

    /// The same of Gaussians of which it is known where they may look different: the same bytes, in less time.
    ///
    /// # Errors
    /// As [`SceneWriter::bytes`].
    pub fn bytes_of<M: Moments>(&self, moments: &mut M) -> Result<Vec<u8>, M::Error> {
        self.check()?;
        let first = moments.at(0)?;
        let count = first.gaussians.len();
        if !self.link_of.is_empty() && self.link_of.len() != count {
            return Err(wrong(format!("{} links for {count} Gaussians", self.link_of.len())).into());
        }
        let degree = match first.gaussians.colour {
            Colour::Rgb(_) => 0,
            Colour::Sh { degree, .. } => degree.min(self.most_degree),
        };
        let origin = centres(first.gaussians, self.unit);
        let rest = harmonics(first.gaussians, degree);
        let mut looks = Looks::new(count);
        let mut moved = Vec::new();
        for time in 0..self.head.times.len() {
            let moment = moments.at(time)?;
            same_count(&moment, count)?;
            let way = || {
                let mut way = centres(moment.gaussians, self.unit);
                (way.iter_mut().zip(&origin)).for_each(|(now, first)| *now = now.wrapping_sub(*first));
                planes::pack(&way, 3)
            };
            let (packed, ()) = rayon::join(way, || looks.see(moment.gaussians, moment.open, self.unit));
            moved.push(packed);
        }
        let mut file = Sections::default();
        file.add_all(&[("position", &origin, 3), ("attributes", &looks.usual(), ATTRIBUTES)]);
        if degree > 0 {
            file.add("harmonics", &rest, 3 * ((degree + 1) * (degree + 1) - 1));
        }
        if !self.link_of.is_empty() {
            let links: Vec<i32> = self.link_of.iter().map(|&link| i32::from(link)).collect();
            file.add("link", &links, 1);
        }
        self.add_meshes(&mut file);
        for (time, ((widths, packed), (rows, changed))) in moved.into_iter().zip(looks.changes()).enumerate() {
            file.push(format!("moved/{time}"), count, widths, &packed);
            file.add_all(&[
                (&format!("rows/{time}"), &rows, 1),
                (&format!("attributes/{time}"), &changed, ATTRIBUTES),
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

fn same_count(moment: &Moment<'_>, count: usize) -> Result<()> {
    let found = moment.gaussians.len();
    if found != count {
        return Err(wrong(format!("{found} Gaussians at one time, {count} at another")));
    }
    match moment.open {
        Some(open) if open.len() != count => Err(wrong(format!("{} marks for {count} Gaussians", open.len()))),
        _ => Ok(()),
    }
}

fn wrong(what: impl Into<String>) -> Error {
    Error::Scene { what: what.into() }
}

/// Centres in steps. `[N, 3]`
fn centres(gaussians: &Gaussians, unit: LengthUnit) -> Vec<i32> {
    let mut out = vec![0; 3 * gaussians.len()];
    let rows = out.par_chunks_mut(3 * 4096).enumerate();
    rows.for_each(|(chunk, rows)| {
        for (local, row) in rows.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *row = centre(gaussians, unit, 4096 * chunk + local);
        }
    });
    out
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
