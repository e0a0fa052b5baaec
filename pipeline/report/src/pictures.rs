//! Pictures of the report: input strips with mesh outlines, robot maps, renders beside references.

use image::{ExtendedColorType, ImageEncoder as _};
use rogs_schemas::records::clip::{Clip, ClipCamera};
use rogs_schemas::records::robot::{NO_LINK, RobotMap, RobotMaps};
use rogs_schemas::records::scores::{RenderedView, Scores};

/// An encoded picture with its caption.
pub(crate) struct Figure {
    pub(crate) caption: String,
    pub(crate) media_type: &'static str,
    pub(crate) bytes: Vec<u8>,
}

/// A table of pictures: the same views by every method.
#[derive(Default)]
pub(crate) struct Comparison {
    pub(crate) columns: Vec<String>,
    /// Label and one cell a column.
    pub(crate) rows: Vec<(String, Vec<Option<Figure>>)>,
}

/// Error, of 255, from which on error maps have their brightest colour.
pub(crate) const FULL_ERROR: u8 = 64;
/// Methods of a comparison at most; all of them have sheets of their own below it.
const MAX_METHODS: usize = 6;

/// At most this many query times are shown per camera.
const MAX_TIMES: usize = 4;
/// Width of the gap between pictures of a strip, pixels.
const GAP: usize = 4;

/// An RGB picture, row-major.
#[derive(Clone)]
struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Picture {
    fn new(width: usize, height: usize, fill: u8) -> Self {
        Self {
            width,
            height,
            rgb: vec![fill; width * height * 3],
        }
    }

    fn from_rgb(width: u32, height: u32, rgb: &[u8]) -> Option<Self> {
        let (width, height) = (width as usize, height as usize);
        (rgb.len() == width * height * 3).then(|| Self {
            width,
            height,
            rgb: rgb.to_vec(),
        })
    }

    fn blit(&mut self, source: &Self, left: usize, top: usize) {
        for row in 0..source.height {
            let to = ((top + row) * self.width + left) * 3;
            let from = row * source.width * 3;
            self.rgb[to..to + source.width * 3].copy_from_slice(&source.rgb[from..from + source.width * 3]);
        }
    }

    /// Photographs are JPEG: a report of twelve clips must stay a file that opens at once.
    fn jpeg(&self, caption: String) -> Option<Figure> {
        let mut bytes = Vec::new();
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 88)
            .write_image(
                &self.rgb,
                self.width as u32,
                self.height as u32,
                ExtendedColorType::Rgb8,
            )
            .ok()?;
        Some(Figure {
            caption,
            media_type: "image/jpeg",
            bytes,
        })
    }

    fn png(&self, caption: String) -> Option<Figure> {
        let mut bytes = Vec::new();
        image::codecs::png::PngEncoder::new(&mut bytes)
            .write_image(
                &self.rgb,
                self.width as u32,
                self.height as u32,
                ExtendedColorType::Rgb8,
            )
            .ok()?;
        Some(Figure {
            caption,
            media_type: "image/png",
            bytes,
        })
    }
}

/// Pictures in rows and columns, missing ones left grey. All cells have the size of the first picture.
fn grid(rows: &[Vec<Option<Picture>>]) -> Option<Picture> {
    let first = rows.iter().flatten().flatten().next()?;
    let (width, height) = (first.width, first.height);
    let columns = rows.iter().map(Vec::len).max()?;
    let mut sheet = Picture::new(columns * (width + GAP) - GAP, rows.len() * (height + GAP) - GAP, 128);
    for (row, cells) in rows.iter().enumerate() {
        for (column, cell) in cells.iter().enumerate() {
            if let Some(cell) = cell
                .as_ref()
                .filter(|cell| cell.width == width && cell.height == height)
            {
                sheet.blit(cell, column * (width + GAP), row * (height + GAP));
            }
        }
    }
    Some(sheet)
}

fn frame_rgb(clip: &Clip, camera: &ClipCamera, frame: u32) -> Option<Picture> {
    let area = (clip.height * clip.width * 3) as usize;
    let start = frame as usize * area;
    Picture::from_rgb(
        clip.width,
        clip.height,
        camera.rgb.as_deref()?.get(start..start + area)?,
    )
}

fn map_at(robot: &RobotMaps, camera: u32, frame: u32) -> Option<&RobotMap> {
    robot.maps.iter().find(|map| map.camera == camera && map.frame == frame)
}

/// Pixels of the robot whose right, left, upper or lower neighbour is not robot: the outline of its silhouette.
fn outline(map: &RobotMap, width: usize, height: usize) -> Vec<usize> {
    let hit = |column: isize, row: isize| {
        let inside = column >= 0 && row >= 0 && column < width as isize && row < height as isize;
        // What leaves the image has no outline there.
        !inside || map.link[row as usize * width + column as usize] != NO_LINK
    };
    let mut pixels = Vec::new();
    for row in 0..height as isize {
        for column in 0..width as isize {
            if hit(column, row)
                && [(1, 0), (-1, 0), (0, 1), (0, -1)]
                    .iter()
                    .any(|(x, y)| !hit(column + x, row + y))
            {
                pixels.push(row as usize * width + column as usize);
            }
        }
    }
    pixels
}

fn draw_outline(picture: &mut Picture, map: &RobotMap) {
    for pixel in outline(map, picture.width, picture.height) {
        picture.rgb[pixel * 3..pixel * 3 + 3].copy_from_slice(&[0, 255, 255]);
    }
}

/// One strip per source camera: its images at the source times with the mesh outline.
pub(crate) fn inputs(clip: &Clip, robot: Option<&RobotMaps>) -> Vec<Figure> {
    let strip = |camera: u32| {
        let source = clip.cameras.get(camera as usize)?;
        let cells = clip.source_frames.iter().map(|&frame| {
            let mut picture = frame_rgb(clip, source, frame)?;
            if let Some(map) = robot.and_then(|robot| map_at(robot, camera, frame)) {
                draw_outline(&mut picture, map);
            }
            Some(picture)
        });
        grid(&[cells.collect()])?.jpeg(format!("{}, frames {}", source.id, join(&clip.source_frames)))
    };
    clip.source_cameras().into_iter().filter_map(strip).collect()
}

/// One sheet per source camera: mesh depth above, link ids below.
pub(crate) fn robot(clip: &Clip, robot: &RobotMaps) -> Vec<Figure> {
    let sheet = |camera: u32| {
        let source = clip.cameras.get(camera as usize)?;
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
    let sheet = |camera: &ClipCamera| {
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
        let reference: Vec<Option<Picture>> = frames.iter().map(|&frame| frame_rgb(clip, camera, frame)).collect();
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
    clip.cameras.iter().filter_map(sheet).collect()
}

/// Reference, prediction and error map of source and held-out cameras at an input time and at another one, where the query
/// plan has both.
pub(crate) fn comparison(clip: &Clip, scores: &[(String, Scores)]) -> Comparison {
    let methods: Vec<_> = scores
        .iter()
        .filter(|(_, scores)| !scores.renders.is_empty())
        .take(MAX_METHODS)
        .collect();
    let mut comparison = Comparison {
        columns: vec!["reference".to_owned()],
        rows: Vec::new(),
    };
    if methods.is_empty() {
        return comparison;
    }
    for (method, _) in &methods {
        comparison.columns.extend([method.clone(), "error".to_owned()]);
    }
    // Times in the middle of the plan: at the ends the first input frame hides what time does.
    let middle = |input: bool| {
        let frames: Vec<u32> = (clip.query_frames.iter().copied())
            .filter(|frame| clip.source_frames.contains(frame) == input)
            .collect();
        frames.get(frames.len() / 2).copied()
    };
    let times = [(middle(true), "input time"), (middle(false), "not an input time")];
    let cameras = clip.cameras.iter().filter(|camera| camera.rgb.is_some());
    for camera in cameras {
        let group = if camera.partner.is_some() { "novel" } else { "source" };
        for (frame, kind) in times.iter().filter_map(|(frame, kind)| Some(((*frame)?, kind))) {
            let Some(reference) = frame_rgb(clip, camera, frame) else {
                continue;
            };
            let mut cells = vec![reference.jpeg(format!("{} reference", camera.id))];
            for (method, scores) in &methods {
                let mut views = scores.renders.iter();
                let view = views.find(|view| view.camera == camera.id && view.frame == frame);
                let own = view.and_then(|view| Picture::from_rgb(view.width, view.height, &view.rgb));
                let error = own.as_ref().and_then(|own| error_map(&reference, own));
                cells.push(own.and_then(|own| own.jpeg(format!("{} by {method}", camera.id))));
                cells.push(error.and_then(|error| error.jpeg(format!("{} error of {method}", camera.id))));
            }
            let label = format!("{} ({group}), frame {frame}, {kind}", camera.id);
            comparison.rows.push((label, cells));
        }
    }
    comparison
}

/// Mean absolute difference of the channels as a colour ramp.
fn error_map(reference: &Picture, render: &Picture) -> Option<Picture> {
    (reference.rgb.len() == render.rgb.len()).then(|| {
        let mut picture = Picture::new(reference.width, reference.height, 0);
        let pixels = reference.rgb.chunks_exact(3).zip(render.rgb.chunks_exact(3));
        for (out, (a, b)) in picture.rgb.chunks_exact_mut(3).zip(pixels) {
            let sum: u32 = a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum();
            let share = (sum as f32 / 3.0 / f32::from(FULL_ERROR)).min(1.0);
            out.copy_from_slice(&heat(share));
        }
        picture
    })
}

/// Black over red to yellow.
fn heat(x: f32) -> [u8; 3] {
    let channel = |value: f32| (255.0 * value.clamp(0.0, 1.0)) as u8;
    [channel(2.0 * x), channel(2.0 * x - 1.0), 0]
}

/// At most [`MAX_TIMES`] of the frames, evenly spread, first and last included.
fn spread(frames: &[u32]) -> Vec<u32> {
    if frames.len() <= MAX_TIMES {
        return frames.to_vec();
    }
    (0..MAX_TIMES)
        .map(|index| frames[index * (frames.len() - 1) / (MAX_TIMES - 1)])
        .collect()
}

fn join(frames: &[u32]) -> String {
    frames.iter().map(u32::to_string).collect::<Vec<_>>().join(", ")
}

/// 2 % and 98 % quantiles of the positive depths, metres.
fn depth_range(depths: impl Iterator<Item = f32>) -> Option<(f32, f32)> {
    let mut depths: Vec<f32> = depths.filter(|depth| depth.is_finite() && *depth > 0.0).collect();
    if depths.is_empty() {
        return None;
    }
    depths.sort_unstable_by(f32::total_cmp);
    let at = |quantile: f64| depths[((depths.len() - 1) as f64 * quantile) as usize];
    let (near, far) = (at(0.02), at(0.98));
    Some((near, far.max(near + 1e-3)))
}

fn depth_picture(width: usize, height: usize, depth_m: &[f32], (near, far): (f32, f32)) -> Picture {
    let mut picture = Picture::new(width, height, 0);
    for (pixel, &depth) in picture.rgb.chunks_exact_mut(3).zip(depth_m) {
        if depth > 0.0 {
            pixel.copy_from_slice(&ramp(((depth - near) / (far - near)).clamp(0.0, 1.0)));
        }
    }
    picture
}

/// A ramp of rising brightness from blue over red to yellow.
fn ramp(x: f32) -> [u8; 3] {
    let channel = |value: f32| (255.0 * value.clamp(0.0, 1.0)) as u8;
    [
        channel(1.8 * x),
        channel(1.9 * x - 0.75),
        channel(0.35 + 0.9 * x - 2.6 * (x - 0.35).max(0.0) + 1.6 * (x - 0.75).max(0.0)),
    ]
}

fn link_picture(width: usize, height: usize, map: &RobotMap) -> Picture {
    let mut picture = Picture::new(width, height, 0);
    for ((pixel, &link), &support) in picture.rgb.chunks_exact_mut(3).zip(&map.link).zip(&map.support) {
        if link != NO_LINK {
            // A fixed colour per link, dimmer where the pixel is no valid support.
            let hash = u32::from(link).wrapping_add(1).wrapping_mul(0x9e37_79b1);
            let scale = if support != 0 { 1.0 } else { 0.55 };
            for (channel, value) in pixel.iter_mut().enumerate() {
                let byte = 70 + (hash >> (8 * channel)) as u8 % 186;
                *value = (f32::from(byte) * scale) as u8;
            }
        }
    }
    picture
}

fn error_picture(reference: &Picture, render: &Picture) -> Option<Picture> {
    (reference.rgb.len() == render.rgb.len()).then(|| {
        let mut picture = Picture::new(reference.width, reference.height, 0);
        for ((out, a), b) in picture.rgb.iter_mut().zip(&reference.rgb).zip(&render.rgb) {
            *out = a.abs_diff(*b).saturating_mul(2);
        }
        picture
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outline_of_a_square_is_its_border() {
        let (width, height) = (7, 6);
        let mut link = vec![NO_LINK; width * height];
        for row in 1..5 {
            for column in 2..6 {
                link[row * width + column] = 3;
            }
        }
        let map = RobotMap {
            camera: 0,
            frame: 0,
            depth_m: vec![1.0; 42],
            link,
            support: vec![1; 42],
        };
        let pixels = outline(&map, width, height);
        assert_eq!(pixels.len(), 12, "a 4 x 4 square has 12 border pixels");
        assert!(!pixels.contains(&(2 * width + 3)));
    }

    #[test]
    fn error_maps_grow_with_the_error() {
        let grey = |value| Picture::new(2, 1, value);
        let colour = |error: u8| error_map(&grey(100), &grey(100 + error)).unwrap().rgb[..3].to_vec();
        assert_eq!(colour(0), [0, 0, 0]);
        assert_eq!(colour(FULL_ERROR / 2), [255, 0, 0]);
        assert_eq!(colour(FULL_ERROR), [255, 255, 0]);
        assert_eq!(colour(150), [255, 255, 0]);
        assert!(error_map(&grey(0), &Picture::new(3, 1, 0)).is_none());
    }

    #[test]
    fn times_are_spread_over_the_plan() {
        assert_eq!(spread(&[0, 3, 9]), [0, 3, 9]);
        assert_eq!(spread(&[0, 1, 2, 3, 4, 5, 16]), [0, 2, 4, 16]);
    }

    #[test]
    fn a_grid_with_a_missing_picture_keeps_its_place() {
        let cell = Picture::new(2, 2, 255);
        let sheet = grid(&[vec![Some(cell.clone()), None], vec![None, Some(cell)]]).unwrap();
        assert_eq!((sheet.width, sheet.height), (2 * 2 + GAP, 2 * 2 + GAP));
        assert_eq!(&sheet.rgb[..3], [255, 255, 255]);
        assert_eq!(&sheet.rgb[(2 + GAP) * 3..(2 + GAP) * 3 + 3], [128, 128, 128]);
    }
}
