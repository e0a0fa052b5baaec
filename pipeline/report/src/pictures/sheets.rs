//! Sheets of pictures of a clip, one a camera: inputs, robot maps, renders.

use rogs_schemas::records::clip::{Clip, ClipCamera};
use rogs_schemas::records::robot::{RobotMap, RobotMaps};
use rogs_schemas::records::scores::{RenderedView, Scores};
use rogs_schemas::{CameraIndex, FrameIndex};

use super::colours::{depth_picture, depth_range, error_picture, link_picture};
use super::frames::{join, map_at, observation, spread, target};
use super::outline::draw_outline;
use super::picture::{Figure, Picture, grid};

/// One strip per source camera: its images at the source times with the mesh outline.
pub(crate) fn inputs(clip: &Clip, robot: Option<&RobotMaps>) -> Vec<Figure> {
    let strip = |camera: CameraIndex| {
        let source = clip.cameras.get(camera.at())?;
        let cells = clip.source_frames.iter().map(|&frame| {
            let mut picture = observation(clip, camera, frame)?;
            if let Some(map) = robot.and_then(|robot| map_at(robot, camera, frame)) {
                draw_outline(&mut picture, map);
            }
            Some(picture)
        });
        grid(&[cells.collect()])?.jpeg(format!("{}, frames {}", source.id, join(&clip.source_frames)))
    };
    clip.source_cameras().into_iter().filter_map(strip).collect()
}

/// Images of one source camera (by its name) with the mesh outline, at three frames from the first to the last.
pub(crate) fn overlay(clip: &Clip, robot: &RobotMaps, name: &str) -> Option<Figure> {
    let camera = clip.source_cameras().into_iter().find(|camera| {
        let own = clip.cameras.get(camera.at());
        own.is_some_and(|own| own.id == name)
    })?;
    let last = clip.frame_count().checked_sub(1)? as u32;
    let mut frames = [0, last / 2, last].map(FrameIndex).to_vec();
    frames.dedup();
    let cells = frames.iter().map(|&frame| {
        let mut picture = observation(clip, camera, frame)?;
        if let Some(map) = map_at(robot, camera, frame) {
            draw_outline(&mut picture, map);
        }
        Some(picture)
    });
    grid(&[cells.collect()])?.jpeg(format!("{name}, frames {}", join(&frames)))
}

/// One sheet per source camera: mesh depth above, link ids below.
pub(crate) fn robot(clip: &Clip, robot: &RobotMaps) -> Vec<Figure> {
    let sheet = |camera: CameraIndex| {
        let source = clip.cameras.get(camera.at())?;
        let maps: Vec<Option<&RobotMap>> = clip
            .source_frames
            .iter()
            .map(|&frame| map_at(robot, camera, frame))
            .collect();
        let (width, height) = (robot.width as usize, robot.height as usize);
        let depths = maps.iter().flatten().flat_map(|map| map.depth_m.iter().copied());
        let range = depth_range(depths)?;
        let depth = maps
            .iter()
            .map(|map| map.map(|map| depth_picture(width, height, &map.depth_m, range)));
        let links = maps.iter().map(|map| map.map(|map| link_picture(width, height, map)));
        let caption = format!(
            "{}: depth {:.2} m (dark) to {:.2} m (bright), links by colour",
            source.id, range.0, range.1
        );
        grid(&[depth.collect(), links.collect()])?.png(caption)
    };
    clip.source_cameras().into_iter().filter_map(sheet).collect()
}

/// One sheet per camera: reference, render, absolute error (times 2), rendered depth, at some query times.
pub(crate) fn renders(clip: &Clip, scores: &Scores) -> Vec<Figure> {
    let frames = spread(&clip.query_frames);
    let sheet = |(index, camera): (CameraIndex, &ClipCamera)| {
        let views: Vec<Option<&RenderedView>> = frames
            .iter()
            .map(|&frame| {
                scores
                    .renders
                    .iter()
                    .find(|view| view.camera == camera.id && view.frame == frame)
            })
            .collect();
        views.iter().flatten().next()?;
        let reference: Vec<Option<Picture>> = frames.iter().map(|&frame| target(clip, index, frame)).collect();
        let render: Vec<Option<Picture>> = views
            .iter()
            .map(|view| view.and_then(|view| Picture::from_rgb(view.width, view.height, &view.rgb)))
            .collect();
        let error = reference
            .iter()
            .zip(&render)
            .map(|(a, b)| error_picture(a.as_ref()?, b.as_ref()?));
        let range = depth_range(views.iter().flatten().flat_map(|view| view.depth_m.iter().copied()));
        let depth = views.iter().map(|view| {
            view.and_then(|view| {
                Some(depth_picture(
                    view.width as usize,
                    view.height as usize,
                    &view.depth_m,
                    range?,
                ))
            })
        });
        let (error, depth) = (error.collect(), depth.collect());
        let held_out = if camera.partner.is_some() { " (held out)" } else { "" };
        grid(&[reference, render, error, depth])?.jpeg(format!("{}{held_out}, frames {}", camera.id, join(&frames)))
    };
    CameraIndex::first(clip.cameras.len())
        .zip(&clip.cameras)
        .filter_map(sheet)
        .collect()
}
