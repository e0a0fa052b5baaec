//! Models of COLMAP: `sparse/0/{cameras,images,points3D}.bin` beside images, masks and depth maps.
//!
//! One PINHOLE camera for each of the clip; poses world-to-camera with OpenCV axes, quaternion (w, x, y, z); pixels have
//! their centres at + 0.5. Each point was seen by one image. Masks are `masks/IMAGE.png.png` (0: left out); depth is in the
//! form of COLMAP's dense maps, `depth_maps/IMAGE.png.geometric.bin`: text `WIDTH&HEIGHT&1&`, then f32 metres, row-major, 0 where unknown.

use std::collections::BTreeMap;
use std::path::Path;

use rogs_arrays::{grey_png_bytes, png_bytes};
use rogs_files::Draft;
use rogs_schemas::{CameraIndex, Intrinsics};

use super::{Dataset, View};
use crate::error::{Error, Result};

/// COLMAP's number of the camera model with fx, fy, cx, cy.
const PINHOLE: i32 = 1;

/// Writes a folder; nothing may be in its place.
///
/// # Errors
/// When something is there, or the operating system refuses.
pub fn write_colmap(dataset: &Dataset<'_>, folder: &Path) -> Result<()> {
    let draft = Draft::begin(folder)?;
    for view in &dataset.views {
        let failed = |error: std::io::Error| Error::Unfit {
            what: format!("image `{}`: {error}", view.name),
        };
        let name = &view.name;
        let image = png_bytes(dataset.size, view.rgb).map_err(failed)?;
        draft.write(format!("images/{name}.png"), &image)?;
        if let Some(mask) = &view.mask {
            let mask = grey_png_bytes(dataset.size, mask).map_err(failed)?;
            draft.write(format!("masks/{name}.png.png"), &mask)?;
        }
        if let Some(depth) = view.depth_m {
            draft.write(
                format!("depth_maps/{name}.png.geometric.bin"),
                &depth_map(dataset.size, depth),
            )?;
        }
    }
    draft.write("sparse/0/cameras.bin", &cameras(dataset))?;
    draft.write("sparse/0/images.bin", &images(dataset))?;
    draft.write("sparse/0/points3D.bin", &points(dataset))?;
    Ok(draft.publish()?)
}

fn depth_map((width, height): (u32, u32), depth_m: &[f32]) -> Vec<u8> {
    let mut out = format!("{width}&{height}&1&").into_bytes();
    let known = |depth: &f32| if depth.is_finite() { *depth } else { 0.0 };
    out.extend(depth_m.iter().flat_map(|depth| known(depth).to_le_bytes()));
    out
}

/// Numbers of COLMAP count from 1.
fn id(index: usize) -> u32 {
    index as u32 + 1
}

fn cameras(dataset: &Dataset<'_>) -> Vec<u8> {
    let used: BTreeMap<CameraIndex, &View<'_>> = dataset.views.iter().map(|view| (view.camera, view)).collect();
    let mut out = (used.len() as u64).to_le_bytes().to_vec();
    for (camera, view) in used {
        let Intrinsics { fx, fy, cx, cy } = view.lens.intrinsics;
        out.extend(id(camera.at()).to_le_bytes());
        out.extend(PINHOLE.to_le_bytes());
        out.extend(u64::from(view.lens.width).to_le_bytes());
        out.extend(u64::from(view.lens.height).to_le_bytes());
        out.extend([fx, fy, cx, cy].iter().flat_map(|value| value.to_le_bytes()));
    }
    out
}

fn images(dataset: &Dataset<'_>) -> Vec<u8> {
    let mut seen: Vec<Vec<usize>> = vec![Vec::new(); dataset.views.len()];
    for (point, own) in dataset.points.iter().enumerate() {
        seen[own.view].push(point);
    }
    let mut out = (dataset.views.len() as u64).to_le_bytes().to_vec();
    for (index, (view, seen)) in dataset.views.iter().zip(&seen).enumerate() {
        let camera_from_world = view.world_from_camera.inverse();
        let turn = camera_from_world.quaternion();
        out.extend(id(index).to_le_bytes());
        let pose = [turn.w, turn.x, turn.y, turn.z]
            .into_iter()
            .chain(camera_from_world.translation.to_array());
        out.extend(pose.flat_map(f64::to_le_bytes));
        out.extend(id(view.camera.at()).to_le_bytes());
        out.extend_from_slice(format!("{}.png\0", view.name).as_bytes());
        out.extend((seen.len() as u64).to_le_bytes());
        for point in seen {
            out.extend(
                dataset.points[*point]
                    .pixel
                    .iter()
                    .flat_map(|value| value.to_le_bytes()),
            );
            out.extend(u64::from(id(*point)).to_le_bytes());
        }
    }
    out
}

fn points(dataset: &Dataset<'_>) -> Vec<u8> {
    let mut place = vec![0_u32; dataset.views.len()];
    let mut out = (dataset.points.len() as u64).to_le_bytes().to_vec();
    for (index, point) in dataset.points.iter().enumerate() {
        out.extend(u64::from(id(index)).to_le_bytes());
        out.extend(point.position_m.iter().flat_map(|value| value.to_le_bytes()));
        out.extend_from_slice(&point.rgb);
        // Error of the projection, pixels; then the track: one image, and the how manieth of its points this is.
        out.extend(0.0_f64.to_le_bytes());
        out.extend(1_u64.to_le_bytes());
        out.extend(id(point.view).to_le_bytes());
        out.extend(place[point.view].to_le_bytes());
        place[point.view] += 1;
    }
    out
}
