//! Camera paths of nerfstudio's viewer (`camera_path.json`).
//!
//! `camera_path` is a list of views, one a frame: `camera_to_world` (4x4 row-major, OpenGL axes: x right, y up, z
//! backward), `fov` (vertical, degrees) and `aspect`; beside it `render_width`, `render_height`, `fps`, `seconds` and
//! `camera_type`. We take its world as the robot's base in metres, which it is where the data set that nerfstudio was given
//! had such poses and it was told to leave them as they are.

use std::path::Path;

use glam::{DMat3, DVec3};
use rogs_geometry::{Base, Camera, CameraPath, Pinhole, Pose, PosedCamera};
use serde::Deserialize;

use crate::error::{Error, Result};

/// Longest file that is read, bytes.
const LONGEST: u64 = 64 << 20;
/// Most views of a path.
const MOST_VIEWS: usize = 100_000;

/// A path as its file has it.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewerPath {
    /// Where the camera goes, in the frame of the robot's base; one key a frame.
    pub path: CameraPath<Base>,
    /// Frames per second that the file asks for.
    pub rate: Option<f64>,
}

#[derive(Deserialize)]
struct PathFile {
    #[serde(default = "perspective")]
    camera_type: String,
    render_height: f64,
    render_width: f64,
    camera_path: Vec<View>,
    fps: Option<f64>,
}

#[derive(Deserialize)]
struct View {
    camera_to_world: Matrix,
    fov: f64,
}

/// Sixteen numbers, flat or in rows.
#[derive(Deserialize)]
#[serde(untagged)]
enum Matrix {
    Flat(Vec<f64>),
    Rows(Vec<Vec<f64>>),
}

fn perspective() -> String {
    "perspective".to_owned()
}

/// OpenGL axes of a camera as OpenCV has them, and back: y and z are turned over.
#[must_use]
pub fn other_axes(rotation: &DMat3) -> DMat3 {
    *rotation * DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0))
}

/// Whether a JSON value is a path of nerfstudio's viewer.
#[must_use]
pub fn is_viewer_path(value: &serde_json::Value) -> bool {
    value.get("camera_path").is_some()
}

/// Reads the JSON of a path; `path` is its file, for messages.
///
/// # Errors
/// When it is no path, has fewer than two views, or a view that is no pinhole camera at a rigid pose.
pub fn viewer_path(path: &Path, value: serde_json::Value) -> Result<ViewerPath> {
    let wrong = |what: String| Error::Wrong {
        path: path.to_owned(),
        what,
    };
    let file: PathFile =
        serde_json::from_value(value).map_err(|error| wrong(format!("not a camera path of nerfstudio: {error}")))?;
    if file.camera_type != "perspective" {
        return Err(wrong(format!(
            "its camera is `{}`; only `perspective` ones are rendered",
            file.camera_type
        )));
    }
    if file.camera_path.len() > MOST_VIEWS {
        return Err(wrong(format!(
            "{} views are more than {MOST_VIEWS}",
            file.camera_path.len()
        )));
    }
    let side = |name: &str, value: f64| {
        let good = (1.0..=16_384.0).contains(&value);
        good.then_some(value.round() as u32)
            .ok_or_else(|| wrong(format!("invalid `{name}` {value}: expected 1 to 16384 pixels")))
    };
    let (width, height) = (
        side("render_width", file.render_width)?,
        side("render_height", file.render_height)?,
    );
    let key = |(index, view): (usize, &View)| {
        let flat: Vec<f64> = match &view.camera_to_world {
            Matrix::Flat(values) => values.clone(),
            Matrix::Rows(rows) => rows.iter().flatten().copied().collect(),
        };
        let bad = |what: String| wrong(format!("view {index} of `camera_path`: {what}"));
        let flat: [f64; 16] = flat
            .try_into()
            .map_err(|_| bad("`camera_to_world` has not 4 x 4 numbers".to_owned()))?;
        let pose: Pose<Base, Camera> = Pose::from_matrix4(&flat).map_err(|error| bad(error.to_string()))?;
        if !(view.fov > 0.0 && view.fov < 180.0) {
            return Err(bad(format!("invalid `fov` {}: expected 0 to 180 degrees", view.fov)));
        }
        let focal = f64::from(height) / 2.0 / libm::tan(view.fov.to_radians() / 2.0);
        let lens = Pinhole::centred(focal, width, height);
        Ok(PosedCamera::new(
            lens,
            Pose::new(other_axes(&pose.rotation), pose.translation),
        ))
    };
    let keys = file
        .camera_path
        .iter()
        .enumerate()
        .map(key)
        .collect::<Result<Vec<_>>>()?;
    let rate = file.fps.filter(|rate| rate.is_finite() && *rate > 0.0);
    let path = CameraPath::new(keys).map_err(|error| wrong(error.to_string()))?;
    Ok(ViewerPath { path, rate })
}

/// The JSON of a camera file, whatever kind it is.
///
/// # Errors
/// When it cannot be read, is too long, or is no JSON.
pub fn read_json(path: &Path) -> Result<serde_json::Value> {
    let io = |source| Error::Read {
        path: path.to_owned(),
        source,
    };
    let file = rogs_files::open(path).map_err(io)?;
    let length = file.metadata().map_err(io)?.len();
    let wrong = |what: String| Error::Wrong {
        path: path.to_owned(),
        what,
    };
    if length > LONGEST {
        return Err(wrong(format!("{length} bytes are more than a camera file has")));
    }
    let text = rogs_files::read_to_string(path).map_err(io)?;
    rogs_schemas::json::read(&text).map_err(|error| wrong(format!("not a camera file: {error}")))
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;

    fn file(views: Value) -> Value {
        json!({"camera_type": "perspective", "render_height": 480, "render_width": 640, "fps": 24, "seconds": 2,
               "is_cycle": false, "keyframes": [], "camera_path": views})
    }

    fn read(value: Value) -> Result<ViewerPath> {
        viewer_path(Path::new("camera_path.json"), value)
    }

    /// A camera at (1, 2, 3) that looks along -z of the world, y up: OpenGL's own axes.
    fn view(x: f64) -> Value {
        json!({"camera_to_world": [1, 0, 0, x, 0, 1, 0, 2, 0, 0, 1, 3, 0, 0, 0, 1], "fov": 90, "aspect": 1.333})
    }

    #[test]
    fn poses_change_their_axes_and_the_field_of_view_is_vertical() {
        let found = read(file(json!([view(1.0), view(2.0)]))).unwrap();
        assert_eq!((found.path.len(), found.rate), (2, Some(24.0)));
        let first = found.path.at(0.0);
        assert!((first.lens.intrinsics.fy - 240.0).abs() < 1e-9 && first.lens.width == 640);
        // A point in front of the camera and above its axis.
        let seen = first.world_from_camera.inverse().point(DVec3::new(1.0, 2.5, 1.0));
        assert!((seen - DVec3::new(0.0, -0.5, 2.0)).length() < 1e-12, "{seen}");
        let rows = json!({"camera_to_world": [[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]], "fov": 90});
        assert_eq!(read(file(json!([rows, view(2.0)]))).unwrap().path, found.path);
    }

    #[test]
    fn what_is_no_path_is_refused_with_its_place() {
        let said = |value| read(value).unwrap_err().to_string();
        assert!(said(file(json!([view(1.0)]))).contains("two poses or more, this one has 1"));
        assert!(said(file(json!([]))).contains("this one has 0"));
        let mut other = file(json!([view(1.0), view(2.0)]));
        other["camera_type"] = "equirectangular".into();
        assert!(said(other).contains("equirectangular"));
        let mut scaled = view(1.0);
        scaled["camera_to_world"][0] = 2.into();
        assert!(said(file(json!([view(0.0), scaled]))).contains("view 1"));
        let mut wide = view(1.0);
        wide["fov"] = 180.into();
        assert!(said(file(json!([wide, view(0.0)]))).contains("fov"));
        let short = json!({"camera_to_world": [1, 2], "fov": 50});
        assert!(said(file(json!([short, view(0.0)]))).contains("4 x 4"));
        assert!(said(json!({"camera_path": 3})).contains("not a camera path"));
        let mut none = file(json!([view(1.0), view(2.0)]));
        none["render_width"] = 0.into();
        assert!(said(none).contains("render_width"));
    }

    #[test]
    fn files_that_are_no_json_say_so() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("missing.json");
        assert!(read_json(&missing).unwrap_err().to_string().contains("reading"));
        let text = missing.with_file_name("a.json");
        rogs_files::write_bytes(&text, b"{").unwrap();
        assert!(read_json(&text).unwrap_err().to_string().contains("not a camera file"));
    }
}
