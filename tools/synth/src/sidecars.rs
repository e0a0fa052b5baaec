//! Procedural sidecars: what UniDepth, Depth Anything and BootsTAPIR might have said of an episode, exact or as wrong as they
//! are (`docs/sidecars.md`).

use std::path::Path;

use glam::{DVec2, DVec3};
use rayon::prelude::*;
use rogs_arrays::{NamedArray, npy_bytes, write_npz};
use rogs_files::Draft;

use crate::cameras::CAMERA_NAMES;
use crate::episode::Episode;
use crate::error::{Error, Result};
use crate::math::Draw;
use crate::render::{NEAR, View};
use crate::scene::FIRST_OBJECT_ID;

/// Source cameras of an episode.
const SOURCES: [usize; 3] = [0, 1, 2];
/// Grid of the points that are tracked, pixels.
const STRIDE: usize = 4;
/// Depth of a pixel that shows nothing, metres.
const FAR_M: f32 = 20.0;
/// A point is seen where the surface is no nearer than this before it, metres.
const SLACK_M: f64 = 0.01;
/// The largest relative disparity.
const LARGEST: f64 = 65_535.0;
/// Waves of a smooth error.
const WAVES: usize = 6;
/// Logit of what is certain.
const CERTAIN: f64 = 8.0;

/// How wrong the estimators are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimatorErrors {
    /// Standard deviation of the logarithm of the factor by which metric depth of a camera is off.
    pub scale: f64,
    /// The same from frame to frame.
    pub frame_scale: f64,
    /// Standard deviation of the smooth relative error of metric depth over an image.
    pub depth: f64,
    /// Standard deviation of the smooth error of relative disparity, as a share of its range.
    pub disparity: f64,
    /// Standard deviation of a track's place on an image 256 pixels wide, pixels.
    pub track_px: f64,
    /// Share of tracked places whose visibility is wrong.
    pub visibility: f64,
}

impl EstimatorErrors {
    /// None at all.
    pub const NONE: Self = Self {
        scale: 0.0,
        frame_scale: 0.0,
        depth: 0.0,
        disparity: 0.0,
        track_px: 0.0,
        visibility: 0.0,
    };
    /// About those that their makers report indoors: depth off by a tenth, tracks by a pixel or two, one visibility in ten
    /// wrong.
    pub const REAL: Self = Self {
        scale: 0.15,
        frame_scale: 0.03,
        depth: 0.05,
        disparity: 0.03,
        track_px: 1.0,
        visibility: 0.1,
    };
}

/// Writes the sidecars of `count` frames from episode frame `first` on: a folder for every source camera. Those that are there
/// are kept as they are. Frames beyond the episode are its last one.
///
/// # Errors
/// When a file cannot be written.
pub fn write_sidecars(
    place: &Path,
    episode: &Episode,
    first: usize,
    count: usize,
    errors: &EstimatorErrors,
) -> Result<()> {
    if place.exists() {
        return Ok(());
    }
    if let Some(folder) = place.parent() {
        std::fs::create_dir_all(folder).map_err(|source| Error::io(folder, source))?;
    }
    let last = episode.frame_count().saturating_sub(1);
    let frames: Vec<usize> = (0..count).map(|number| (first + number).min(last)).collect();
    let views: Vec<Vec<View>> = (frames.par_iter())
        .map(|&frame| episode.render_cameras(frame, &SOURCES))
        .collect();
    let draft = Draft::begin(place)?;
    for camera in SOURCES {
        let lens = &episode.cameras[camera].lens;
        let own = Camera {
            episode,
            camera,
            frames: &frames,
            views: views.iter().map(|views| &views[camera]).collect(),
            width: lens.width as usize,
            height: lens.height as usize,
            errors,
        };
        own.write(&draft)?;
    }
    Ok(draft.publish()?)
}

/// What one camera saw.
struct Camera<'a> {
    episode: &'a Episode,
    camera: usize,
    /// Episode frames.
    frames: &'a [usize],
    views: Vec<&'a View>,
    width: usize,
    height: usize,
    errors: &'a EstimatorErrors,
}

impl Camera<'_> {
    fn write(&self, draft: &Draft) -> Result<()> {
        let name = |file: &str| format!("{}/{file}", CAMERA_NAMES[self.camera]);
        let shape = [self.frames.len(), self.height, self.width];
        let mut draw = self.draw(0);
        let scale = libm::exp(self.errors.scale * draw.normal());
        let maps = (0..self.frames.len()).into_par_iter();
        let maps: Vec<(Vec<f32>, Vec<u16>)> = maps.map(|number| self.depth(number, scale)).collect();
        let metric: Vec<f32> = maps.iter().flat_map(|(metric, _)| metric).copied().collect();
        let relative: Vec<u16> = maps.iter().flat_map(|(_, relative)| relative).copied().collect();
        draft.write(name("unidepth.npy"), &npy_bytes(&shape, &metric))?;
        draft.write(name("depth-anything.npy"), &npy_bytes(&shape, &relative))?;
        let tracks: Vec<Vec<f32>> = (0..self.frames.len())
            .into_par_iter()
            .map(|query| self.tracks(query))
            .collect();
        let array = |(query, values): (usize, &Vec<f32>)| {
            let points = values.len() / (4 * self.frames.len());
            NamedArray::new(&query.to_string(), &[points, self.frames.len(), 4], values)
        };
        let arrays: Vec<NamedArray> = tracks.iter().enumerate().map(array).collect();
        Ok(write_npz(&draft.path_of(name("tracks.npz")), &arrays)?)
    }

    /// Draws of a frame; 0 is the camera's own.
    fn draw(&self, frame: usize) -> Draw {
        Draw::new(self.episode.seed, 40_000 + 1000 * self.camera as u64 + frame as u64)
    }

    /// Metric depth, and relative disparity scaled to its range.
    fn depth(&self, number: usize, scale: f64) -> (Vec<f32>, Vec<u16>) {
        let EstimatorErrors {
            frame_scale,
            depth,
            disparity,
            ..
        } = *self.errors;
        let mut draw = self.draw(1 + self.frames[number]);
        let scale = scale * libm::exp(frame_scale * draw.normal());
        let [of_depth, of_disparity] = [0, 1].map(|_| Smooth::new(&mut draw));
        let exact = |pixel: usize| {
            let depth = self.views[number].depth_m[pixel];
            f64::from(if depth > 0.0 && depth.is_finite() { depth } else { FAR_M })
        };
        let place = |pixel: usize| {
            let (row, column) = (pixel / self.width, pixel % self.width);
            [column as f64 / self.width as f64, row as f64 / self.height as f64]
        };
        let pixels = 0..self.width * self.height;
        let metric = |pixel: usize| (exact(pixel) * scale * libm::exp(depth * of_depth.at(place(pixel)))) as f32;
        let near: Vec<f64> = pixels.clone().map(|pixel| 1.0 / exact(pixel)).collect();
        let limits = |values: &[f64]| {
            let fold = |pick: fn(f64, f64) -> f64, start: f64| values.iter().copied().fold(start, pick);
            [fold(f64::min, f64::INFINITY), fold(f64::max, f64::NEG_INFINITY)]
        };
        let [low, high] = limits(&near);
        let wrong = |pixel: usize| near[pixel] + disparity * (high - low) * of_disparity.at(place(pixel));
        let shown: Vec<f64> = pixels.clone().map(wrong).collect();
        let [low, high] = limits(&shown);
        let share = |value: &f64| ((value - low) / (high - low).max(1e-12) * LARGEST).round() as u16;
        (pixels.map(metric).collect(), shown.iter().map(share).collect())
    }

    /// Tracks of the points on the robot at a query frame, over all frames. `[N, T, 4]`
    fn tracks(&self, query: usize) -> Vec<f32> {
        let mut draw = self.draw(500 + self.frames[query]);
        let on_robot = |&(row, column): &(usize, usize)| {
            let id = self.views[query].id[row * self.width + column];
            id < FIRST_OBJECT_ID
        };
        let rows = (0..self.height).step_by(STRIDE);
        let grid = rows.flat_map(|row| (0..self.width).step_by(STRIDE).map(move |column| (row, column)));
        let mut values = Vec::new();
        for (row, column) in grid.filter(on_robot) {
            let pixel = row * self.width + column;
            let id = self.views[query].id[pixel];
            let depth = f64::from(self.views[query].depth_m[pixel]);
            let lens = &self.episode.cameras[self.camera].lens;
            let centre = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
            let pose = self.episode.base_from_camera(self.camera, self.frames[query]);
            let point = pose.point(lens.unproject(centre, depth));
            for target in 0..self.frames.len() {
                let own = [column as f64, row as f64];
                let seen = if target == query {
                    Tracked {
                        place: own,
                        visible: true,
                        known: true,
                    }
                } else {
                    self.follow(id, point, query, target, own)
                };
                values.extend(self.told(seen, target == query, &mut draw));
            }
        }
        values
    }

    /// Where a point of the robot at one frame is at another.
    fn follow(&self, id: u8, point: DVec3, query: usize, target: usize, own: [f64; 2]) -> Tracked {
        let lost = Tracked {
            place: own,
            visible: false,
            known: false,
        };
        let (from, to) = (self.frames[query], self.frames[target]);
        let Some(displacement) = self.episode.displacement(id, point, from, to) else {
            return lost;
        };
        let pose = self.episode.base_from_camera(self.camera, to);
        let in_camera = pose.inverse().point(point + displacement);
        let lens = &self.episode.cameras[self.camera].lens;
        let Some((place, depth)) = lens.project(in_camera).filter(|(_, depth)| *depth > NEAR) else {
            return lost;
        };
        let inside = place.x >= 0.0 && place.y >= 0.0 && place.x < self.width as f64 && place.y < self.height as f64;
        let visible = inside && {
            let pixel = place.y as usize * self.width + place.x as usize;
            let surface = f64::from(self.views[target].depth_m[pixel]);
            self.views[target].id[pixel] == id && depth < surface + SLACK_M
        };
        Tracked {
            place: [place.x - 0.5, place.y - 0.5],
            visible,
            known: true,
        }
    }

    /// What a tracker says: place, logit of being hidden, logit of a large error.
    fn told(&self, seen: Tracked, own: bool, draw: &mut Draw) -> [f32; 4] {
        let EstimatorErrors {
            track_px, visibility, ..
        } = *self.errors;
        let exact = track_px == 0.0 && visibility == 0.0;
        let noise = track_px * self.width as f64 / 256.0;
        let [dx, dy] = [0, 1].map(|_| noise * draw.normal());
        let wrong = draw.chance(visibility);
        let [hidden, unsure] = [0, 1].map(|_| draw.normal());
        let sign = if seen.visible != (wrong && !own) { -1.0 } else { 1.0 };
        let (hidden, unsure) = if exact {
            (sign * CERTAIN, if seen.known { -CERTAIN } else { CERTAIN })
        } else {
            (
                sign * 4.0 + 1.5 * hidden,
                if seen.known { -2.5 } else { 2.5 } + 1.5 * unsure,
            )
        };
        let [x, y] = seen.place;
        let place = if own { [x, y] } else { [x + dx, y + dy] };
        [place[0] as f32, place[1] as f32, hidden as f32, unsure as f32]
    }
}

/// A point of the robot at another frame.
struct Tracked {
    /// Pixels, centres at integers.
    place: [f64; 2],
    visible: bool,
    /// Whether it has a place in the image plane at all.
    known: bool,
}

/// A smooth random function on the image, of mean 0 and variance 1, about.
struct Smooth([[f64; 4]; WAVES]);

impl Smooth {
    fn new(draw: &mut Draw) -> Self {
        Self(std::array::from_fn(|_| {
            let turn = std::f64::consts::TAU;
            [
                draw.normal() * turn,
                draw.normal() * turn,
                draw.unit() * turn,
                draw.normal(),
            ]
        }))
    }

    /// At a place, both coordinates 0 to 1.
    fn at(&self, [x, y]: [f64; 2]) -> f64 {
        let wave = |[across, down, phase, height]: &[f64; 4]| height * libm::sin(across * x + down * y + phase);
        self.0.iter().map(wave).sum::<f64>() / (WAVES as f64 / 2.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use rogs_arrays::{ArrayFile, NpyFile};

    use super::*;
    use crate::cameras::Resolution;
    use crate::config::SynthConfig;
    use crate::episode::generate_episode;

    const SIZE: [u32; 2] = [56, 98];

    fn written(errors: &EstimatorErrors) -> (tempfile::TempDir, Episode) {
        let config = SynthConfig {
            frames: 8,
            resolution: Resolution {
                wrist: SIZE,
                external: SIZE,
            },
            ..SynthConfig::default()
        };
        let episode = generate_episode(&config, 3).unwrap();
        let folder = tempfile::tempdir().unwrap();
        write_sidecars(&folder.path().join("clips/a"), &episode, 2, 5, errors).unwrap();
        (folder, episode)
    }

    fn maps(folder: &tempfile::TempDir, name: &str) -> Vec<f64> {
        let mut file = NpyFile::open(&folder.path().join("clips/a/ext1").join(name)).unwrap();
        assert_eq!(file.shape(), [5, 56, 98]);
        file.all().unwrap()
    }

    #[test]
    fn exact_sidecars_are_what_the_episode_is() {
        let (folder, episode) = written(&EstimatorErrors::NONE);
        let area = 56 * 98;
        let (metric, relative) = (maps(&folder, "unidepth.npy"), maps(&folder, "depth-anything.npy"));
        for number in 0..5 {
            let view = &episode.render_cameras(2 + number, &[1])[0];
            let own = &metric[number * area..(number + 1) * area];
            assert!(
                own.iter().zip(&view.depth_m).all(|(a, b)| *a == f64::from(*b)),
                "{number}"
            );
            // Relative disparity is a straight line of the inverse of depth.
            let own_relative = &relative[number * area..(number + 1) * area];
            let near = own.iter().map(|depth| 1.0 / depth);
            let [low, high] =
                [f64::min as fn(f64, f64) -> f64, f64::max].map(|pick| near.clone().reduce(pick).unwrap());
            for (depth, found) in own.iter().zip(own_relative) {
                let expected = (1.0 / depth - low) / (high - low) * 65_535.0;
                assert!((found - expected).abs() <= 0.5001, "{found} {expected}");
            }
        }
    }

    #[test]
    fn exact_tracks_follow_the_robot() {
        let (folder, episode) = written(&EstimatorErrors::NONE);
        let file = ArrayFile::open(&folder.path().join("clips/a/ext1/tracks.npz")).unwrap();
        assert_eq!(file.names().len(), 5);
        let (lens, mut moved, mut seen) = (&episode.cameras[1].lens, 0.0f64, 0);
        for query in 0..5 {
            let tracks = file.need(&[&query.to_string()]).unwrap();
            let [points, 5, 4] = tracks.shape[..] else {
                panic!("{:?}", tracks.shape)
            };
            assert!(points > 20, "{points}");
            for track in tracks.into_floats().chunks_exact(20) {
                let place = |frame: usize| [track[4 * frame], track[4 * frame + 1]];
                let [x, y] = place(query);
                assert!(
                    x.fract() == 0.0
                        && y.fract() == 0.0
                        && (x as usize).is_multiple_of(4)
                        && (y as usize).is_multiple_of(4)
                );
                assert_eq!([track[4 * query + 2], track[4 * query + 3]], [-8.0, -8.0]);
                for target in 0..5 {
                    if track[4 * target + 2] > 0.0 {
                        continue;
                    }
                    // The surface there is the same point of the robot.
                    let view = &episode.render_cameras(2 + target, &[1])[0];
                    let [u, v] = place(target);
                    let pixel = (v + 0.5) as usize * 98 + (u + 0.5) as usize;
                    assert!(view.id[pixel] < FIRST_OBJECT_ID);
                    moved = moved.max(f64::from((u - x).abs().max((v - y).abs())));
                    seen += usize::from(target != query);
                }
            }
        }
        assert!(moved > 1.0 && seen > 200, "{moved} {seen} {lens:?}");
    }

    #[test]
    fn real_estimators_are_wrong_by_as_much_as_is_asked() {
        let (exact, _) = written(&EstimatorErrors::NONE);
        let (real, _) = written(&EstimatorErrors::REAL);
        let (a, b) = (maps(&exact, "unidepth.npy"), maps(&real, "unidepth.npy"));
        let ratios: Vec<f64> = a.iter().zip(&b).map(|(a, b)| (b / a).ln()).collect();
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        let deviation = (ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / ratios.len() as f64).sqrt();
        assert!(
            mean != 0.0 && mean.abs() < 0.6 && (0.01..0.2).contains(&deviation),
            "{mean} {deviation}"
        );
        let tracks = |folder: &tempfile::TempDir| {
            let file = ArrayFile::open(&folder.path().join("clips/a/ext1/tracks.npz")).unwrap();
            file.need(&["1"]).unwrap().into_floats()
        };
        let (a, b) = (tracks(&exact), tracks(&real));
        let off = |k: usize| f64::from(a[k] - b[k]);
        let places: Vec<f64> = (0..a.len()).filter(|k| k % 4 == 0 && k / 4 % 5 != 1).map(off).collect();
        let deviation = (places.iter().map(|p| p * p).sum::<f64>() / places.len() as f64).sqrt();
        assert!((0.2..0.7).contains(&deviation), "{deviation}");
        let (again, _) = written(&EstimatorErrors::REAL);
        assert_eq!(tracks(&again), b, "the same every time");
    }
}
