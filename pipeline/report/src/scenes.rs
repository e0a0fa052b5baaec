//! Scenes of the players: from the records of a clip to what the viewer reads (`docs/spec/scene.md`).

use std::path::{Path, PathBuf};

use rogs_export::scene::{LinkMesh, Moment, Moments, SceneCamera, SceneHead, ScenePicture, SceneWriter};
use rogs_field::{TimedField, Turned};
use rogs_geometry::{Base, Link, Pose, PosedCamera, Recon};
use rogs_r4c::{FieldFile, read_record, read_refinement_of};
use rogs_robot::{Mesh, MeshScene, RobotModel, names};
use rogs_schemas::records::clip::{CameraRole, Clip};
use rogs_schemas::records::field::Field;
use rogs_schemas::records::motion_bases::MotionBasisField;
use rogs_schemas::records::polynomial::PolynomialField;
use rogs_schemas::records::refinement::Refinement;
use rogs_schemas::records::robot::{RobotMaps, RobotSpec};
use rogs_schemas::units::LengthUnit;
use rogs_schemas::{CameraIndex, ClipId, FrameIndex};
use rogs_score::outside::OutsideError;

use crate::baseline_scenes::{MotionBasisScene, PolynomialScene};
use crate::pictures::photograph;

/// Most triangles of a robot that is drawn.
const MOST_TRIANGLES: usize = 300_000;
/// Name of the scene of Stage 1.
const STAGE_1: &str = "Stage 1";
/// Name of the scene with the corrections of Stage 2.
const STAGE_2: &str = "Stage 1+2";
/// Name of the scene of the stage `fit`.
const FITTED: &str = "Fit";
/// Name of the scene of the baseline 4DGT.
const FOUR_DGT: &str = "4DGT";
/// Name of the scene of the baseline Shape of Motion.
const SHAPE_OF_MOTION: &str = "Shape of Motion";
/// Highest degree of harmonics that the viewer draws.
const DEGREE: usize = 1;

/// Why there is no scene.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SceneError {
    /// A file of the clip cannot be read.
    #[error(transparent)]
    Record(#[from] rogs_r4c::Error),
    /// The field contradicts itself or its refinement.
    #[error(transparent)]
    Field(#[from] rogs_field::Error),
    /// The field of a baseline contradicts itself.
    #[error(transparent)]
    Baseline(#[from] OutsideError),
    /// A pose is none.
    #[error(transparent)]
    Geometry(#[from] rogs_geometry::Error),
    /// The robot cannot be read.
    #[error(transparent)]
    Robot(#[from] rogs_robot::Error),
    /// The scene cannot be written.
    #[error(transparent)]
    Scene(#[from] rogs_export::Error),
    /// Files of different clips.
    #[error("clip, robot maps or another field belong to clip `{found}`, the field to `{expected}`")]
    OtherClip {
        /// Clip of the file.
        found: String,
        /// Clip of the field.
        expected: String,
    },
    /// A fitted field of other times.
    #[error("the fitted field has other times than the field: make it again")]
    OtherTimes,
}

/// Files that the scenes of a clip are made of.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SceneFiles {
    /// The field of Stage 1.
    pub field: PathBuf,
    /// What Stage 2 adds.
    pub refinement: Option<PathBuf>,
    /// The field that the stage `fit` made of it.
    pub fitted: Option<PathBuf>,
    /// The field of the baseline 4DGT.
    pub polynomial: Option<PathBuf>,
    /// The field of the baseline Shape of Motion.
    pub motion_bases: Option<PathBuf>,
    /// Cameras and recorded images.
    pub clip: PathBuf,
    /// Poses of cameras and links.
    pub robot: PathBuf,
}

/// The meshes of a robot, by the names of its links.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RobotMesh {
    links: Vec<(String, Mesh)>,
}

impl RobotMesh {
    /// Reads the description and its meshes, those that robot maps are drawn with. A scene holds nothing of a robot with more
    /// than 300,000 triangles.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn load(urdf: &Path, spec: &RobotSpec) -> Result<Self, SceneError> {
        let model = RobotModel::load(urdf)?;
        let mut links = Vec::new();
        for link in &model.links {
            if names::matches_any(&spec.exclude_links, &link.name) {
                continue;
            }
            let collision = names::matches_any(&spec.collision_links, &link.name);
            let mut mesh = Mesh::default();
            for shape in if collision { &link.collision } else { &link.visual } {
                mesh.append(&Mesh::of_shape(shape, &model.folder, spec.mesh_axes)?.mesh);
            }
            mesh.weld();
            links.push((link.name.clone(), mesh));
        }
        Ok(Self { links })
    }

    /// The robot for pictures, its links numbered as they are in a clip's robot maps.
    pub(crate) fn scene(&self, names: &[String]) -> MeshScene {
        let mut scene = MeshScene::new();
        for (link, name) in (0..=u8::MAX).zip(names) {
            if let Some((_, mesh)) = self.links.iter().find(|(own, _)| own == name) {
                scene.add(link, mesh);
            }
        }
        scene
    }

    fn of_links(&self, names: &[String]) -> Vec<LinkMesh> {
        let triangles: usize = self.links.iter().map(|(_, mesh)| mesh.triangles.len()).sum();
        if triangles > MOST_TRIANGLES {
            return Vec::new();
        }
        let mesh = |(link, name): (usize, &String)| {
            let (_, mesh) = self.links.iter().find(|(own, _)| own == name)?;
            (!mesh.triangles.is_empty()).then(|| LinkMesh {
                link,
                positions: mesh.positions.clone(),
                triangles: mesh.triangles.clone(),
            })
        };
        names.iter().enumerate().filter_map(mesh).collect()
    }
}

impl SceneFiles {
    /// The names of the scenes, in the order in which [`scenes_of`] gives them.
    #[must_use]
    pub fn names(&self) -> Vec<&'static str> {
        let more = [
            (&self.refinement, STAGE_2),
            (&self.fitted, FITTED),
            (&self.polynomial, FOUR_DGT),
            (&self.motion_bases, SHAPE_OF_MOTION),
        ];
        let more = more.into_iter().filter(|(path, _)| path.is_some());
        [STAGE_1].into_iter().chain(more.map(|(_, name)| name)).collect()
    }
}

/// The scenes of a clip, by name: of Stage 1, with the corrections of Stage 2, of `fit` and of baselines, where there are
/// such.
///
/// # Errors
/// When a file cannot be read or belongs to another clip.
pub fn scenes_of(
    files: &SceneFiles,
    robot_mesh: Option<&RobotMesh>,
) -> Result<Vec<(&'static str, Vec<u8>)>, SceneError> {
    let mut field = OneTime::open(&files.field)?;
    let (clip, _) = read_record::<Clip>(&files.clip)?;
    let (robot, _) = read_record::<RobotMaps>(&files.robot)?;
    for found in [&clip.clip_id, &robot.clip_id] {
        same_clip(found, &field)?;
    }
    let times = field.file.times().to_vec();
    let mut head = head(&clip, &robot, &field.held, &times)?;
    let pictures = pictures(&clip, &times);
    let meshes = robot_mesh.map(|mesh| mesh.of_links(&robot.link_names));
    let meshes = meshes.unwrap_or_default();
    let (frames, fps) = (frames(&clip, &times), clip.fps);
    drop((clip, robot));
    let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&field.held.recon_from_base)?;
    let links = field.held.link.clone();
    let mut scenes: Vec<(&'static str, Vec<u8>)> = Vec::new();
    let mut add = |name: &'static str, link_of: &[u8], unit, write: Write<'_>| {
        head.name = name.to_owned();
        // The viewer takes what scenes have in common from the first one.
        let first = scenes.is_empty();
        let writer = SceneWriter {
            head: &head,
            link_of,
            meshes: if first { &meshes } else { &[] },
            pictures: if first { &pictures } else { &[] },
            unit,
            most_degree: DEGREE,
        };
        scenes.push((name, write(&writer)?));
        Ok::<_, SceneError>(())
    };
    let own = LengthUnit::Internal;
    add(STAGE_1, &links, own, &mut |writer| {
        writer.bytes_of(&mut OverTime::new(&mut field, None, &times))
    })?;
    if let Some(path) = &files.refinement {
        let refinement = read_refinement_of(path, field.file.key())?;
        add(STAGE_2, &links, own, &mut |writer| {
            writer.bytes_of(&mut OverTime::new(&mut field, Some(&refinement), &times))
        })?;
    }
    if let Some(path) = &files.fitted {
        let mut fitted = OneTime::open(path)?;
        same_clip(&fitted.held.clip_id, &field)?;
        if fitted.file.times() != times {
            return Err(SceneError::OtherTimes);
        }
        let links = fitted.held.link.clone();
        add(FITTED, &links, own, &mut |writer| {
            writer.bytes_of(&mut OverTime::new(&mut fitted, None, &times))
        })?;
    }
    if let Some(path) = &files.polynomial {
        let (made, _) = read_record::<PolynomialField>(path)?;
        same_clip(&made.clip_id, &field)?;
        let scene = PolynomialScene::new(made.gaussians, fps, recon_from_base);
        add(FOUR_DGT, &[], LengthUnit::Metre, &mut |writer| {
            writer.bytes(|time| Ok::<_, SceneError>(scene.at(frames[time])))
        })?;
    }
    if let Some(path) = &files.motion_bases {
        let (made, _) = read_record::<MotionBasisField>(path)?;
        same_clip(&made.clip_id, &field)?;
        let scene = MotionBasisScene::new(made, recon_from_base)?;
        add(SHAPE_OF_MOTION, &[], LengthUnit::Metre, &mut |writer| {
            writer.bytes(|time| Ok::<_, SceneError>(scene.at(frames[time])?))
        })?;
    }
    Ok(scenes)
}

/// Makes the bytes of a scene by a writer of it.
type Write<'a> = &'a mut dyn FnMut(&SceneWriter<'_>) -> Result<Vec<u8>, SceneError>;

/// Refuses a file of another clip than that of the field.
fn same_clip(found: &ClipId, field: &OneTime) -> Result<(), SceneError> {
    if *found == field.held.clip_id {
        return Ok(());
    }
    Err(SceneError::OtherClip {
        found: found.to_string(),
        expected: field.held.clip_id.to_string(),
    })
}

/// A field of which one time is in memory.
struct OneTime {
    file: FieldFile,
    /// Without slices, or with one.
    held: Field,
}

impl OneTime {
    fn open(path: &Path) -> Result<Self, SceneError> {
        let file = FieldFile::open(path)?;
        let held = file.base()?;
        Ok(Self { file, held })
    }

    /// The field with the slice of a stored time, by its index.
    fn turned_to(&mut self, time: usize) -> Result<&Field, SceneError> {
        let wanted = self.file.times().get(time);
        if self.held.slices.first().map(|slice| &slice.time) != wanted {
            self.held.slices.clear();
            self.held.slices.push(self.file.slice(time)?);
        }
        Ok(&self.held)
    }
}

/// A field with its corrections, turned from time to time.
struct OverTime<'a> {
    field: &'a mut OneTime,
    refinement: Option<&'a Refinement>,
    times: &'a [f64],
    turned: Turned,
}

impl<'a> OverTime<'a> {
    fn new(field: &'a mut OneTime, refinement: Option<&'a Refinement>, times: &'a [f64]) -> Self {
        Self {
            field,
            refinement,
            times,
            turned: Turned::default(),
        }
    }
}

impl Moments for OverTime<'_> {
    type Error = SceneError;

    fn at(&mut self, time: usize) -> Result<Moment<'_>, SceneError> {
        let timed = TimedField::new(self.field.turned_to(time)?)?;
        let timed = match self.refinement {
            Some(refinement) => timed.with_refinement(refinement)?,
            None => timed,
        };
        timed.turn(self.times[time], &mut self.turned)?;
        Ok(Moment {
            gaussians: self.turned.gaussians(),
            open: Some(self.turned.open()),
        })
    }
}

/// The clip frame nearest to each stored time.
fn frames(clip: &Clip, times: &[f64]) -> Vec<FrameIndex> {
    let last = clip.frame_count().saturating_sub(1) as f64;
    let frame = |time: &f64| FrameIndex((time * last).round() as u32);
    times.iter().map(frame).collect()
}

fn head(clip: &Clip, robot: &RobotMaps, field: &Field, times: &[f64]) -> Result<SceneHead, SceneError> {
    let recon_from_base: Pose<Recon, Base> = Pose::from_rigid(&field.recon_from_base)?;
    let frames = frames(clip, times);
    let mut cameras = Vec::new();
    for (index, camera) in CameraIndex::first(clip.cameras.len()).zip(&clip.cameras) {
        let pose = |frame: &FrameIndex| {
            let posed = PosedCamera::of_clip(clip, robot, index, *frame)?.in_frame(&recon_from_base);
            Ok::<_, SceneError>(posed.world_from_camera.to_matrix4())
        };
        cameras.push(SceneCamera {
            id: camera.id.clone(),
            held_out: camera.role == CameraRole::Evaluation,
            width: clip.width,
            height: clip.height,
            fx: camera.intrinsics.fx,
            fy: camera.intrinsics.fy,
            cx: camera.intrinsics.cx,
            cy: camera.intrinsics.cy,
            recon_from_camera: frames.iter().map(pose).collect::<Result<_, _>>()?,
        });
    }
    let count = robot.link_names.len();
    let links = |frame: &FrameIndex| {
        let own = robot.base_from_link.iter().skip(frame.at() * count).take(count);
        let pose = |pose| Ok::<_, SceneError>((recon_from_base * Pose::<Base, Link>::from_rigid(pose)?).to_matrix4());
        own.map(pose).collect::<Result<Vec<_>, _>>()
    };
    Ok(SceneHead {
        title: clip.clip_id.to_string(),
        name: String::new(),
        times: times.to_vec(),
        seconds: clip.frame_count().saturating_sub(1) as f64 / clip.fps,
        recon_from_base: recon_from_base.to_matrix4(),
        cameras,
        links: robot.link_names.clone(),
        recon_from_link: frames.iter().map(links).collect::<Result<_, _>>()?,
    })
}

/// What the cameras recorded at the stored times.
fn pictures(clip: &Clip, times: &[f64]) -> Vec<ScenePicture> {
    let mut pictures = Vec::new();
    for (camera, index) in CameraIndex::first(clip.cameras.len()).enumerate() {
        for (time, &frame) in frames(clip, times).iter().enumerate() {
            let jpeg = clip
                .target(index, frame)
                .and_then(|target| photograph(clip.width, clip.height, target.rgb()));
            pictures.extend(jpeg.map(|jpeg| ScenePicture { camera, time, jpeg }));
        }
    }
    pictures
}
