//! From where a scene is seen: `--camera`.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context as _, bail, ensure};
use glam::DVec3;
use rogs_export::nerfstudio;
use rogs_geometry::{Base, Camera, CameraPath, Pinhole, Pose, PosedCamera, Recon};
use rogs_r4c::read_record;
use rogs_schemas::ids::{check_name, did_you_mean};
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::{CameraIndex, FrameIndex, Intrinsics, WrittenPose};
use serde::Deserialize;

/// What `--camera` may be.
pub(crate) const CAMERA_HELP: &str = "From where the scene is seen:

ext1            a camera of the clip, by its name; a camera on the wrist moves with the time
orbit[:NAME][:DEGREES]
                from a camera of the clip (the first that stands still), to and fro by so many degrees in all about the \
upright axis through what it looks at; 360 goes round (default: 60; only with --video)
lookat:X,Y,Z,X,Y,Z
                from a point to a point, metres in the frame of the robot's base, whose z is up
FILE.json       one camera, a list of them, or a camera path of nerfstudio's viewer. With --video a list is a smooth path \
through its poses. One camera is, for example

{\"name\": \"view\", \"width\": 280, \"height\": 154,
 \"intrinsics\": {\"fx\": 116, \"fy\": 116, \"cx\": 140, \"cy\": 77},
 \"base_from_camera\": [[1,0,0,0.5], [0,1,0,0], [0,0,1,0.4], [0,0,0,1]]}

Pixel centres at + 0.5; camera axes OpenCV; metres. Use `recon_from_camera` for a pose in the reconstruction frame; for a \
PLY both mean its world.";

/// Full horizontal angle of view of `lookat` cameras, degrees.
const LOOKAT_DEGREES: f64 = 60.0;
/// Degrees of an orbit that names none.
const ORBIT_DEGREES: f64 = 60.0;
/// Frames of a film along a path that does not say how many.
const PATH_FRAMES: usize = 120;

/// What was asked for.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Viewpoint {
    File(PathBuf),
    Orbit { camera: Option<String>, degrees: f64 },
    LookAt { eye: DVec3, target: DVec3 },
    Named(String),
}

impl FromStr for Viewpoint {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(points) = text.strip_prefix("lookat:") {
            let values: Option<Vec<f64>> = points.split(',').map(|value| value.trim().parse().ok()).collect();
            let values = values.filter(|values| values.iter().all(|value| value.is_finite()));
            let Some(&[a, b, c, d, e, f]) = values.as_deref() else {
                return Err(format!(
                    "invalid camera `{text}`: expected six numbers, from where and to where, e.g. \
                     lookat:1,0,0.8,0.4,0,0.2"
                ));
            };
            let (eye, target) = (DVec3::new(a, b, c), DVec3::new(d, e, f));
            return Ok(Self::LookAt { eye, target });
        }
        let mut parts = text.split(':');
        if parts.next() == Some("orbit") {
            let (mut camera, mut degrees) = (None, ORBIT_DEGREES);
            for part in parts {
                match part.parse::<f64>() {
                    Ok(value) => degrees = value,
                    Err(_) => camera = Some(part.to_owned()),
                }
            }
            if !(degrees > 0.0 && degrees <= 360.0) {
                return Err(format!(
                    "invalid camera `{text}`: an orbit has above 0 and at most 360 degrees"
                ));
            }
            return Ok(Self::Orbit { camera, degrees });
        }
        let path = Path::new(text);
        let file = path
            .extension()
            .is_some_and(|ending| ending.eq_ignore_ascii_case("json"))
            || path.is_file();
        Ok(if file {
            Self::File(path.to_owned())
        } else {
            Self::Named(text.to_owned())
        })
    }
}

/// A clip and its robot maps.
pub(crate) struct Scenery {
    pub(crate) clip: Clip,
    pub(crate) robot: RobotMaps,
}

impl Scenery {
    /// Reads both and sees that they belong to the clip of the field.
    pub(crate) fn read(clip: &Path, robot: &Path, field_of: &str) -> anyhow::Result<Self> {
        let hint = "cameras of the clip, and references, are read from `clip.r4c` and `robot.r4c` beside the field, or from \
                    `--clip` and `--robot`";
        let (clip, _) = read_record::<Clip>(clip).context(hint)?;
        let (robot, _) = read_record::<RobotMaps>(robot).context(hint)?;
        for id in [&clip.clip_id, &robot.clip_id] {
            ensure!(
                id.as_str() == field_of,
                "clip or robot maps belong to clip `{id}`, the field to `{field_of}`"
            );
        }
        Ok(Self { clip, robot })
    }

    /// The camera of this name.
    pub(crate) fn camera(&self, name: &str) -> anyhow::Result<CameraIndex> {
        let names = || self.clip.cameras.iter().map(|camera| camera.id.as_str());
        if let Some(at) = names().position(|id| id == name) {
            return Ok(CameraIndex(at as u32));
        }
        let words = names().chain(["orbit"]);
        let meant = did_you_mean(name, words).map_or(String::new(), |meant| format!("; did you mean `{meant}`?"));
        let all = names().collect::<Vec<_>>().join(", ");
        bail!("the clip has no camera `{name}`{meant} (cameras: {all}; also `orbit`, `lookat:...`, or a .json file)")
    }

    /// A camera at a normalised time; between frames its pose lies between those of the frames.
    pub(crate) fn at(&self, camera: CameraIndex, time: f64) -> anyhow::Result<PosedCamera<Base>> {
        let position = time * self.clip.frame_count().saturating_sub(1) as f64;
        let at = |frame: f64| PosedCamera::of_clip(&self.clip, &self.robot, camera, FrameIndex(frame as u32));
        let near = position.round();
        if (position - near).abs() < 1e-6 {
            return Ok(at(near)?);
        }
        let between = CameraPath::new(vec![at(position.floor())?, at(position.ceil())?])?;
        Ok(between.at(position - position.floor()))
    }

    /// The camera that an orbit starts from: the named one, or the first that stands still.
    fn start(&self, name: Option<&str>) -> anyhow::Result<(String, PosedCamera<Base>)> {
        let index = match name {
            Some(name) => self.camera(name)?,
            None => {
                let still = |index: &CameraIndex| {
                    let first = self.at(*index, 0.0).ok();
                    first.is_some() && first == self.at(*index, 1.0).ok()
                };
                let mut all = CameraIndex::first(self.clip.cameras.len());
                all.find(still).unwrap_or(CameraIndex(0))
            }
        };
        Ok((self.clip.cameras[index.at()].id.clone(), self.at(index, 0.0)?))
    }
}

/// Cameras that were found, in the reconstruction frame.
pub(crate) enum Shot {
    /// Cameras that stand still, by name.
    Still(Vec<(String, PosedCamera<Recon>)>),
    /// A way, its frames, and how many a second.
    Path {
        path: CameraPath<Recon>,
        frames: usize,
        rate: Option<f64>,
    },
    /// A camera of the clip.
    OfClip(CameraIndex),
    /// About what a camera looks at.
    Orbit { start: PosedCamera<Recon>, degrees: f64 },
}

/// What cameras are found in.
pub(crate) struct Place<'a> {
    pub(crate) recon_from_base: Pose<Recon, Base>,
    pub(crate) scenery: Option<&'a Scenery>,
    /// Size of images, where it is asked for.
    pub(crate) size: Option<(u32, u32)>,
    /// Size of images of a camera that has none.
    pub(crate) usual: (u32, u32),
    /// Whether a list of cameras is a path.
    pub(crate) moving: bool,
}

impl Viewpoint {
    /// Whether clip and robot maps are needed to know where it is.
    pub(crate) fn needs_scenery(&self) -> bool {
        matches!(self, Self::Named(_) | Self::Orbit { .. })
    }

    /// Finds the cameras.
    pub(crate) fn find(&self, place: &Place<'_>) -> anyhow::Result<Shot> {
        let scenery = || {
            place
                .scenery
                .context("a PLY file has no cameras: give `lookat:...` or a .json file")
        };
        match self {
            Self::File(path) => of_file(path, place),
            Self::Named(name) => Ok(Shot::OfClip(scenery()?.camera(name)?)),
            Self::Orbit { camera, degrees } => {
                ensure!(place.moving, "an orbit moves: add `--video FILE`");
                let (_, start) = scenery()?.start(camera.as_deref())?;
                Ok(Shot::Orbit {
                    start: place.fit(start.in_frame(&place.recon_from_base)),
                    degrees: *degrees,
                })
            }
            Self::LookAt { eye, target } => {
                let (width, height) = place.size.unwrap_or(place.usual);
                let focal = f64::from(width) / 2.0 / (LOOKAT_DEGREES / 2.0).to_radians().tan();
                let lens = Pinhole::centred(focal, width, height);
                let pose: Pose<Base, Camera> = Pose::looking_at(*eye, *target, DVec3::Z)?;
                let camera = PosedCamera::new(lens, pose).in_frame(&place.recon_from_base);
                Ok(Shot::Still(vec![("lookat".to_owned(), camera)]))
            }
        }
    }
}

impl Place<'_> {
    /// The camera with images of the size asked for: as wide as before, cut or widened above and below.
    pub(crate) fn fit(&self, camera: PosedCamera<Recon>) -> PosedCamera<Recon> {
        let Some((width, height)) = self.size else {
            return camera;
        };
        let lens = camera.lens;
        let whole = (f64::from(lens.height) * f64::from(width) / f64::from(lens.width))
            .round()
            .max(1.0);
        let cut = ((whole - f64::from(height)) / 2.0).floor() as i32;
        let lens = lens.resized(width, whole as u32).cropped(0, cut, width, height);
        PosedCamera::new(lens, camera.world_from_camera)
    }
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraSpec {
    #[serde(default = "default_name")]
    name: String,
    width: u32,
    height: u32,
    intrinsics: Intrinsics,
    base_from_camera: Option<WrittenPose>,
    recon_from_camera: Option<WrittenPose>,
}

fn default_name() -> String {
    "view".to_owned()
}

/// The cameras of a file.
fn of_file(path: &Path, place: &Place<'_>) -> anyhow::Result<Shot> {
    let value = nerfstudio::read_json(path)?;
    if nerfstudio::is_viewer_path(&value) {
        ensure!(
            place.moving,
            "`{}` is a camera path: add `--video FILE`",
            path.display()
        );
        let found = nerfstudio::viewer_path(path, value)?;
        let frames = found.path.len();
        let key = |index: usize| {
            let camera = found.path.at(index as f64 / (frames - 1) as f64);
            place.fit(camera.in_frame(&place.recon_from_base))
        };
        return Ok(Shot::Path {
            path: CameraPath::new((0..frames).map(key).collect())?,
            frames,
            rate: found.rate,
        });
    }
    let many = value.is_array();
    let wrong = || format!("not a camera file: `{}`", path.display());
    let specs: Vec<CameraSpec> = if many {
        serde_json::from_value(value).with_context(wrong)?
    } else {
        vec![serde_json::from_value(value).with_context(wrong)?]
    };
    ensure!(!specs.is_empty(), "`{}` holds no camera", path.display());
    let cameras: Vec<(String, PosedCamera<Recon>)> = specs
        .iter()
        .map(|spec| Ok((spec.name.clone(), place.fit(spec.camera(&place.recon_from_base)?))))
        .collect::<anyhow::Result<_>>()?;
    if many && place.moving {
        let keys = cameras.into_iter().map(|(_, camera)| camera).collect();
        return Ok(Shot::Path {
            path: CameraPath::new(keys).with_context(|| format!("the cameras of `{}`", path.display()))?,
            frames: PATH_FRAMES,
            rate: None,
        });
    }
    Ok(Shot::Still(cameras))
}

impl CameraSpec {
    /// The camera, metres.
    fn camera(&self, recon_from_base: &Pose<Recon, Base>) -> anyhow::Result<PosedCamera<Recon>> {
        check_name(&self.name).context("the name of a camera becomes that of its files")?;
        let of_camera = || format!("the pose of camera `{}`", self.name);
        let recon_from_camera: Pose<Recon, Camera> = match (&self.recon_from_camera, &self.base_from_camera) {
            (Some(written), None) => Pose::from_written(written).with_context(of_camera)?,
            (None, Some(written)) => {
                let base_from_camera: Pose<Base, Camera> = Pose::from_written(written).with_context(of_camera)?;
                *recon_from_base * base_from_camera
            }
            _ => bail!(
                "camera `{}` needs either `base_from_camera` or `recon_from_camera`",
                self.name
            ),
        };
        let lens = Pinhole {
            intrinsics: self.intrinsics,
            width: self.width,
            height: self.height,
        };
        ensure!(
            lens.is_valid(),
            "camera `{}` cannot be rendered: its size or focal length is not above 0, or a number is not finite",
            self.name
        );
        Ok(PosedCamera::new(lens, recon_from_camera))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_camera_is_shows_in_its_words() {
        let of = |text: &str| text.parse::<Viewpoint>();
        assert_eq!(of("ext1"), Ok(Viewpoint::Named("ext1".into())));
        assert_eq!(of("a/b.JSON"), Ok(Viewpoint::File("a/b.JSON".into())));
        let orbit = |camera: Option<&str>, degrees| Viewpoint::Orbit {
            camera: camera.map(str::to_owned),
            degrees,
        };
        assert_eq!(of("orbit"), Ok(orbit(None, ORBIT_DEGREES)));
        assert_eq!(of("orbit:ext2:360"), Ok(orbit(Some("ext2"), 360.0)));
        assert!(of("orbit:0").unwrap_err().contains("above 0"));
        let at = of("lookat:1,0,0.8,0.4,0,0.2").unwrap();
        assert!(matches!(at, Viewpoint::LookAt { target, .. } if target.x == 0.4));
        assert!(of("lookat:1,2,3").unwrap_err().contains("six numbers"));
        assert!(of("lookat:1,2,3,4,5,nan").is_err());
    }
}
