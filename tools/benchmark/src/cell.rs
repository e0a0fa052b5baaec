//! Real robot cells: the robot without its mesh, the table, and times between those that the network saw.

use anyhow::Context as _;
use glam::DVec3;
use rogs_geometry::{PosedCamera, pixel_centre};
use rogs_schemas::records::clip::CameraRole;
use rogs_schemas::records::robot::{NO_LINK, RobotMap};
use rogs_schemas::records::scores::RenderedView;
use rogs_schemas::{CameraIndex, FrameIndex};
use rogs_score::metrics::{mean, median};

use crate::plane::Plane;
use crate::run::ScoredClip;
use crate::table::{Cell, Table};

/// Where the table is looked for, metres in the base frame: x, y, z.
const WORKSPACE_M: [[f64; 2]; 3] = [[0.2, 0.9], [-0.6, 0.6], [-0.3, 0.3]];
/// Where its height is told, metres: x, y.
const PLACE_M: [f64; 2] = [0.5, 0.0];

/// The robot, the table and the pictures, of every clip.
pub(crate) fn tables(clips: &[ScoredClip]) -> anyhow::Result<Vec<Table>> {
    let mut robot = Table::new(
        "robot depth against the mesh, external cameras, all source times",
        &["median, mm", "mean, mm", "pixels"],
    );
    let mut table = Table::new(
        "table, first source time",
        &["tilt, degrees", "height, cm", "points near it, %"],
    );
    let mut pictures = Table::new("source cameras", &["PSNR at source times, dB", "PSNR between them, dB"]);
    for clip in clips {
        for scores in &clip.scores {
            let method = &scores.summary.method;
            for (index, camera) in clip.clip.cameras.iter().enumerate() {
                // The first camera is the one on the wrist.
                if camera.role != CameraRole::Source || index == 0 {
                    continue;
                }
                let name = format!("{}, {method}, {}", clip.clip.clip_id, camera.id);
                let views: Vec<_> = (clip.renders(scores))
                    .filter(|(camera, _)| camera.at() == index)
                    .collect();
                let errors = robot_errors_m(clip, &views);
                let mm = |value: Option<f64>| Cell::of(value.map(|metres| 1000.0 * metres), 0);
                robot.row(
                    &name,
                    [
                        mm(median(errors.clone())),
                        mm(mean(&errors)),
                        Cell::of(Some(errors.len() as f64), 0),
                    ],
                );
                let Some((at, view)) = views.first() else { continue };
                let plane = Plane::through(&points(clip, *at, view)?);
                table.row(
                    &name,
                    [
                        Cell::of(plane.map(|plane| plane.tilt_deg()), 1),
                        Cell::of(plane.map(|plane| 100.0 * plane.height_m(PLACE_M[0], PLACE_M[1])), 1),
                        Cell::of(plane.map(|plane| 100.0 * plane.share), 0),
                    ],
                );
            }
            let psnr = |at_source: bool| {
                let images = scores.summary.images.iter().filter(|image| image.source_view);
                let images = images.filter(|image| clip.clip.source_frames.contains(&image.frame) == at_source);
                mean(&images.filter_map(|image| image.psnr).collect::<Vec<_>>())
            };
            let name = format!("{}, {method}", clip.clip.clip_id);
            pictures.row(&name, [Cell::of(psnr(true), 2), Cell::of(psnr(false), 2)]);
        }
    }
    Ok(vec![robot, table, pictures])
}

fn map(clip: &ScoredClip, camera: CameraIndex, frame: FrameIndex) -> Option<&RobotMap> {
    let mut maps = clip.robot.maps.iter();
    maps.find(|map| map.camera == camera && map.frame == frame)
}

/// Depth errors on the robot's pixels, its rim left out, metres. A pixel without depth is off by its whole depth.
fn robot_errors_m(clip: &ScoredClip, views: &[(CameraIndex, &RenderedView)]) -> Vec<f64> {
    let mut errors = Vec::new();
    for (camera, view) in views {
        let Some(map) = map(clip, *camera, view.frame) else {
            continue;
        };
        for ((depth, mesh), support) in view.depth_m.iter().zip(&map.depth_m).zip(&map.support) {
            if *support != 0 {
                errors.push(f64::from((depth - mesh).abs()));
            }
        }
    }
    errors
}

/// What a camera sees of the workspace beside the robot, base frame, metres.
fn points(clip: &ScoredClip, camera: CameraIndex, view: &RenderedView) -> anyhow::Result<Vec<DVec3>> {
    let posed = PosedCamera::of_clip(&clip.clip, &clip.robot, camera, view.frame)?;
    let map = map(clip, camera, view.frame)
        .with_context(|| format!("`{}` has no robot map of `{}`", clip.clip.clip_id, view.camera))?;
    let mut points = Vec::new();
    for (pixel, &depth) in view.depth_m.iter().enumerate() {
        if depth <= 0.0 || map.link[pixel] != NO_LINK {
            continue;
        }
        let (row, column) = (pixel as u32 / view.width, pixel as u32 % view.width);
        let point = posed.lens.unproject(pixel_centre(column, row), f64::from(depth));
        let point = posed.world_from_camera.point(point);
        let inside = |(value, [low, high]): (f64, [f64; 2])| (low..high).contains(&value);
        if point.to_array().into_iter().zip(WORKSPACE_M).all(inside) {
            points.push(point);
        }
    }
    Ok(points)
}
