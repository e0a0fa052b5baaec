//! Data sets of nerfstudio: `transforms.json` and what it names.
//!
//! Poses are camera-to-world with OpenGL axes, intrinsics in pixels with centres at + 0.5, depth 16-bit PNG in millimetres (0:
//! unknown), masks 8-bit PNG (0: left out), points a PLY. nerfstudio turns, shifts and scales poses unless told otherwise.

use std::io::Write as _;
use std::path::Path;

use rogs_arrays::{grey_png_bytes, grey16_png_bytes, png_bytes};
use rogs_files::Draft;
use rogs_geometry::Pose;
use rogs_schemas::Intrinsics;
use serde_json::{Value, json};

use super::{Dataset, View};
use crate::error::{Error, Result};
use crate::nerfstudio::other_axes;

/// Writes a folder; nothing may be in its place.
///
/// # Errors
/// When something is there, or the operating system refuses.
pub fn write_nerfstudio(dataset: &Dataset<'_>, folder: &Path) -> Result<()> {
    let draft = Draft::begin(folder)?;
    for view in &dataset.views {
        let failed = |error: std::io::Error| Error::Unfit {
            what: format!("image `{}`: {error}", view.name),
        };
        draft.write(image_of(view), &png_bytes(dataset.size, view.rgb).map_err(failed)?)?;
        if let Some(depth) = view.depth_m {
            let steps: Vec<u16> = depth.iter().map(|depth| millimetres(*depth)).collect();
            draft.write(depth_of(view), &grey16_png_bytes(dataset.size, &steps).map_err(failed)?)?;
        }
        if let Some(mask) = &view.mask {
            draft.write(mask_of(view), &grey_png_bytes(dataset.size, mask).map_err(failed)?)?;
        }
    }
    draft.write("points3D.ply", &cloud(dataset))?;
    let mut text = serde_json::to_vec_pretty(&transforms(dataset)).unwrap_or_default();
    text.push(b'\n');
    draft.write("transforms.json", &text)?;
    Ok(draft.publish()?)
}

fn image_of(view: &View<'_>) -> String {
    format!("images/{}.png", view.name)
}

fn depth_of(view: &View<'_>) -> String {
    format!("depth/{}.png", view.name)
}

fn mask_of(view: &View<'_>) -> String {
    format!("masks/{}.png", view.name)
}

/// Depth in whole millimetres; 0 where it is unknown or above 65 m.
fn millimetres(depth_m: f32) -> u16 {
    let steps = libm::round(f64::from(depth_m) * 1000.0);
    if (1.0..=65_535.0).contains(&steps) {
        steps as u16
    } else {
        0
    }
}

fn transforms(dataset: &Dataset<'_>) -> Value {
    let frame = |view: &View<'_>| {
        let Intrinsics { fx, fy, cx, cy } = view.lens.intrinsics;
        let pose = &view.world_from_camera;
        let turned: Pose<crate::splats::World, rogs_geometry::Camera> =
            Pose::new(other_axes(&pose.rotation), pose.translation);
        let flat = turned.to_matrix4();
        let rows: Vec<&[f64]> = flat.chunks_exact(4).collect();
        let mut own = json!({
            "file_path": image_of(view), "transform_matrix": rows, "time": view.time,
            "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": view.lens.width, "h": view.lens.height,
            "camera": dataset.cameras[view.camera.at()], "frame": view.frame,
        });
        if view.depth_m.is_some() {
            own["depth_file_path"] = depth_of(view).into();
        }
        if view.mask.is_some() {
            own["mask_path"] = mask_of(view).into();
        }
        own
    };
    let frames: Vec<Value> = dataset.views.iter().map(frame).collect();
    let names = |held_out: bool| -> Vec<String> {
        let chosen = dataset.views.iter().filter(|view| view.held_out == held_out);
        chosen.map(image_of).collect()
    };
    let mut file = json!({
        "camera_model": "OPENCV", "orientation_override": "none", "ply_file_path": "points3D.ply", "frames": frames,
    });
    // nerfstudio wants all three lists or none.
    let (train, test) = (names(false), names(true));
    if !train.is_empty() && !test.is_empty() {
        file["train_filenames"] = train.into();
        file["val_filenames"] = test.clone().into();
        file["test_filenames"] = test.into();
    }
    file
}

/// The points as a PLY with colours.
fn cloud(dataset: &Dataset<'_>) -> Vec<u8> {
    let mut out = Vec::with_capacity(256 + 15 * dataset.points.len());
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        dataset.points.len()
    );
    // Writing to memory does not fail.
    let _ = out.write_all(header.as_bytes());
    for point in &dataset.points {
        out.extend(point.position_m.iter().flat_map(|value| (*value as f32).to_le_bytes()));
        out.extend_from_slice(&point.rgb);
    }
    out
}
