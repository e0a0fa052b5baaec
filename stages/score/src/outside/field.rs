//! The field of an outside method, as it left it in a folder of files.
//!
//! A folder holds one field: `frame-N.ply` (3DGS PLY files, one a clip frame), or `gaussians`, `4dgt` or `som` with the
//! ending `.npz` or `.safetensors`. Camera-wise methods have one such folder per source camera, named by the camera's id;
//! their union is rendered (calibrated merging).

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use glam::Vec3;
use rogs_arrays::ArrayFile;
use rogs_field::ply::read_ply_file;
use rogs_field::polynomial;
use rogs_geometry::{Base, Camera, Frame, Pose, Similarity};
use rogs_schemas::records::motion_bases::MotionBasisField;
use rogs_schemas::records::polynomial::Polynomials;
use rogs_schemas::{CameraIndex, FrameIndex, WrittenPose};
use rogs_splat::Gaussians;
use serde::{Deserialize, Serialize};

use crate::outside::{BasisField, OutsideError, SampledField, merge, read_basis_gaussians, read_polynomials};

/// The frame that the fields of a method are given in. An array `base_from_field` (4x4) in a file goes before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FieldFrame {
    /// The robot's base.
    #[default]
    Base,
    /// The camera of the field (of a field of all cameras: the first source camera) at the first source frame.
    Camera,
}

/// The frame of a field as the method left it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Left {}

impl Frame for Left {
    const NAME: &'static str = "field";
}

/// What a folder holds.
#[derive(Debug)]
enum Content {
    Ply(BTreeMap<FrameIndex, PathBuf>),
    Sampled(SampledField),
    Polynomial(Polynomials),
    MotionBasis(BasisField),
}

/// The field of one camera, or of all.
#[derive(Debug)]
struct Part {
    folder: PathBuf,
    content: Content,
    /// Index of the source camera it was made from.
    camera: Option<CameraIndex>,
    base_from_field: Similarity<Base, Left>,
}

/// A field that can be asked for clip frames.
#[derive(Debug)]
pub struct OutsideField {
    parts: Vec<Part>,
    /// Clip frames per second.
    fps: f64,
}

impl OutsideField {
    /// Reads a folder. `cameras` are the source cameras: index, id and pose (`base_from_camera`) at the first source frame.
    /// `None` when there is no field in it, or not one of every source camera.
    ///
    /// # Errors
    /// When a file cannot be understood, or a folder holds more than one kind of field.
    pub fn read(
        folder: &Path,
        cameras: &[(CameraIndex, &str, Pose<Base, Camera>)],
        frame: FieldFrame,
        fps: f64,
    ) -> Result<Option<Self>, OutsideError> {
        let pose = |camera: &Pose<Base, Camera>| match frame {
            FieldFrame::Base => Pose::IDENTITY,
            FieldFrame::Camera => camera.relabelled(),
        };
        let mut parts = Vec::new();
        if let Some((content, own)) = content(folder)? {
            let first = cameras.first().map_or(Pose::IDENTITY, |(_, _, camera)| pose(camera));
            parts.push(Part {
                folder: folder.to_owned(),
                content,
                camera: None,
                base_from_field: own.unwrap_or(first).into(),
            });
        } else {
            for (index, id, camera) in cameras {
                let folder = folder.join(id);
                let Some((content, own)) = content(&folder)? else {
                    return Ok(None);
                };
                parts.push(Part {
                    folder,
                    content,
                    camera: Some(*index),
                    base_from_field: own.unwrap_or_else(|| pose(camera)).into(),
                });
            }
        }
        Ok((!parts.is_empty()).then_some(Self { parts, fps }))
    }

    /// The field that 4DGT made in this pipeline: base frame, metres.
    #[must_use]
    pub fn polynomial(gaussians: Polynomials, fps: f64) -> Self {
        let part = Part {
            folder: PathBuf::new(),
            content: Content::Polynomial(gaussians),
            camera: None,
            base_from_field: Pose::IDENTITY.into(),
        };
        Self { parts: vec![part], fps }
    }

    /// The fields of the cameras that Shape of Motion made in this pipeline: base frame, metres.
    ///
    /// # Errors
    /// When the arrays of a camera contradict each other.
    pub fn motion_bases(field: MotionBasisField, fps: f64) -> Result<Self, OutsideError> {
        let part = |(camera, gaussians)| {
            Ok(Part {
                folder: PathBuf::new(),
                content: Content::MotionBasis(BasisField::new(gaussians).map_err(OutsideError::Contradiction)?),
                camera: Some(camera),
                base_from_field: Pose::IDENTITY.into(),
            })
        };
        let parts = field
            .cameras
            .into_iter()
            .map(part)
            .collect::<Result<_, OutsideError>>()?;
        Ok(Self { parts, fps })
    }

    /// The source camera of every part; `None` for a field of all cameras.
    #[must_use]
    pub fn cameras(&self) -> Vec<Option<CameraIndex>> {
        self.parts.iter().map(|part| part.camera).collect()
    }

    /// Scales a part about the origin of its own frame, on top of what it has been scaled by before.
    pub fn scale(&mut self, part: usize, factor: f64) {
        if let Some(part) = self.parts.get_mut(part) {
            part.base_from_field.scale *= factor;
        }
    }

    /// All Gaussians at a clip frame, base frame, metres.
    ///
    /// # Errors
    /// When a file cannot be read or does not have the frame.
    pub fn gaussians(&self, frame: FrameIndex) -> Result<Gaussians, OutsideError> {
        let parts: Vec<Gaussians> = (0..self.parts.len())
            .map(|part| self.part(part, frame))
            .collect::<Result<_, _>>()?;
        // Parts have no extra channels, so that the union always exists.
        merge(&parts).ok_or_else(|| OutsideError::file(&self.parts[0].folder, "the fields do not fit together"))
    }

    /// The Gaussians of one part at a clip frame, base frame, metres.
    ///
    /// # Errors
    /// As [`OutsideField::gaussians`].
    pub fn part(&self, part: usize, frame: FrameIndex) -> Result<Gaussians, OutsideError> {
        let part = &self.parts[part];
        let (gaussians, _) = part.state(frame, self.fps)?;
        // What further channels mean is unknown.
        let gaussians = Gaussians {
            extra: Vec::new(),
            extra_channels: 0,
            ..gaussians
        };
        Ok(gaussians.moved(&part.base_from_field))
    }

    /// Displacement between two clip frames of every Gaussian that [`OutsideField::gaussians`] gives at `from`, base
    /// frame, metres; `None` where Gaussians have no identity over time (numbers of rows differ). `[N, 3]`
    ///
    /// # Errors
    /// As [`OutsideField::gaussians`].
    pub fn displacement_m(&self, from: FrameIndex, to: FrameIndex) -> Result<Option<Vec<f32>>, OutsideError> {
        let mut all = Vec::new();
        for part in &self.parts {
            let Some(own) = part.displacement(from, to, self.fps)? else {
                return Ok(None);
            };
            let linear = part.base_from_field.linear();
            let turned = |d: &[f32]| (linear * Vec3::from_slice(d).as_dvec3()).as_vec3().to_array();
            all.extend(own.chunks_exact(3).flat_map(turned));
        }
        Ok(Some(all))
    }
}

impl Part {
    /// The Gaussians at a clip frame and, where some are left out, the indices of those that are not.
    fn state(&self, frame: FrameIndex, fps: f64) -> Result<(Gaussians, Option<Vec<u32>>), OutsideError> {
        match &self.content {
            Content::Ply(files) => Ok((self.ply(files, frame)?, None)),
            Content::Sampled(field) => Ok((field.at(frame)?, None)),
            Content::Polynomial(field) => {
                let state = polynomial::state_at(field, seconds(frame, fps));
                Ok((state.gaussians, Some(state.kept)))
            }
            Content::MotionBasis(field) => Ok((field.at(frame.at())?, None)),
        }
    }

    fn displacement(&self, from: FrameIndex, to: FrameIndex, fps: f64) -> Result<Option<Vec<f32>>, OutsideError> {
        match &self.content {
            Content::Ply(files) => {
                let (from, to) = (self.ply(files, from)?.means, self.ply(files, to)?.means);
                let same = from.len() == to.len();
                Ok(same.then(|| to.iter().zip(&from).map(|(to, from)| to - from).collect()))
            }
            Content::Sampled(field) => field.displacement(from, to).map(Some),
            Content::Polynomial(field) => {
                let all = polynomial::displacement_m(field, seconds(from, fps), seconds(to, fps));
                let kept = polynomial::state_at(field, seconds(from, fps)).kept;
                let of = |index: u32| all[3 * index as usize..][..3].to_vec();
                Ok(Some(kept.into_iter().flat_map(of).collect()))
            }
            Content::MotionBasis(field) => field.displacement_m(from.at(), to.at()).map(Some),
        }
    }

    fn ply(&self, files: &BTreeMap<FrameIndex, PathBuf>, frame: FrameIndex) -> Result<Gaussians, OutsideError> {
        let path = files.get(&frame).ok_or_else(|| OutsideError::MissingFrame {
            frame,
            frames: files.keys().copied().collect(),
        })?;
        let scene = read_ply_file(path).map_err(|error| OutsideError::file(path, error.to_string()))?;
        Ok(scene.gaussians)
    }
}

/// Seconds of a clip frame since the first.
fn seconds(frame: FrameIndex, fps: f64) -> f32 {
    (f64::from(frame.0) / fps) as f32
}

/// What a folder holds, and where its frame stands.
type Found = (Content, Option<Pose<Base, Left>>);

/// The field in a folder and its own pose, where there is one.
fn content(folder: &Path) -> Result<Option<Found>, OutsideError> {
    let mut found = Vec::new();
    for name in ["gaussians", "4dgt", "som"] {
        for ending in ["npz", "safetensors"] {
            let path = folder.join(format!("{name}.{ending}"));
            if path.is_file() {
                found.push(path);
            }
        }
    }
    let frames = ply_files(folder)?;
    if found.len() + usize::from(!frames.is_empty()) > 1 {
        return Err(OutsideError::file(
            folder,
            "it holds more than one field; which one is meant?",
        ));
    }
    let Some(path) = found.pop() else {
        return Ok((!frames.is_empty()).then_some((Content::Ply(frames), None)));
    };
    let file = ArrayFile::open(&path)?;
    let content = match path.file_stem().and_then(|stem| stem.to_str()) {
        Some("gaussians") => Content::Sampled(SampledField::read(&file)?),
        Some("4dgt") => Content::Polynomial(read_polynomials(&file)?),
        _ => {
            let field = BasisField::new(read_basis_gaussians(&file)?);
            Content::MotionBasis(field.map_err(|what| OutsideError::file(&path, what))?)
        }
    };
    Ok(Some((content, own_pose(&file)?)))
}

/// `frame-N.ply` by N.
fn ply_files(folder: &Path) -> Result<BTreeMap<FrameIndex, PathBuf>, OutsideError> {
    let mut files = BTreeMap::new();
    let entries = match rogs_files::entries(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(files),
        other => other.map_err(|error| OutsideError::file(folder, error.to_string()))?,
    };
    for entry in entries {
        let path = entry
            .map_err(|error| OutsideError::file(folder, error.to_string()))?
            .path();
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
        let number = name
            .as_deref()
            .and_then(|name| name.strip_prefix("frame-")?.strip_suffix(".ply"));
        let Some(number) = number else { continue };
        let frame: FrameIndex = number
            .parse()
            .map_err(|_| OutsideError::file(&path, "the name must be `frame-N.ply` with a clip frame N"))?;
        if files.insert(frame, path.clone()).is_some() {
            return Err(OutsideError::file(
                &path,
                format!("there are two files of frame {frame}"),
            ));
        }
    }
    Ok(files)
}

/// The array `base_from_field`: a rigid transform as a 4x4 (or 3x4) matrix, metres.
fn own_pose(file: &ArrayFile) -> Result<Option<Pose<Base, Left>>, OutsideError> {
    let Some(array) = file.find(&["base_from_field"])? else {
        return Ok(None);
    };
    array.expect_shape(file.path(), &[&[4, 4], &[3, 4]])?;
    let numbers: Vec<f64> = array.into_floats().into_iter().map(f64::from).collect();
    let written = WrittenPose::from_numbers(&numbers);
    let pose = written
        .and_then(|written| Pose::from_written(&written).ok())
        .ok_or_else(|| {
            let what = "`base_from_field` is not a rigid transform (rotation of determinant +1, translation in metres)";
            OutsideError::file(file.path(), what)
        })?;
    Ok(Some(pose))
}
