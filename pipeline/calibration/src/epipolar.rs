//! Points of the scene in pairs of images of a camera on the hand (`docs/spec/calibration.md` section 5).

use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use rogs_geometry::{Base, Camera, Link, Pinhole, Pose};
use rogs_robot::RenderOptions;
use rogs_robot::raster::Renderer;
use rogs_schemas::records::robot::NO_LINK;

use crate::Result;
use crate::correction::{Correction, LAG, UNKNOWNS};
use crate::edges::mount_from_camera;
use crate::scaled::{Grey, shrunk, shrunk_lens};
use crate::solve::{Kind, Row};
use crate::take::{Take, between};
use crate::tracks::{Pyramid, pixel};

/// Frames that points are followed over; each adds to the error of a place.
const LONGEST: usize = 8;
/// Most pairs of a frame.
const MOST_PAIRS: usize = 3;
/// Most frames from which points are followed, over all clips.
const MOST_STARTS: usize = 90;
/// Most points a start.
const MOST_POINTS: usize = 150;
/// The camera must have gone this far between two images of a pair, metres; and from one pair of a start to the next.
const STEP_M: f64 = 0.02;
/// Pixels around the robot that are left out, at least.
const RING: usize = 4;
/// Points that stay in their place while the camera goes are the hand's, or held by it, or tell nothing, pixels.
const LEAST_MOTION_PX: f64 = 1.0;
/// Groups of matches, one a pair, are told by this bit from those of edges.
const GROUP: u32 = 1 << 31;
/// Standard deviation of a tracked place, pixels.
const SIGMA_PX: f64 = 0.2;

/// Matches between two frames.
struct Pair {
    take: usize,
    frames: [usize; 2],
    /// `[first, second]`, pixels.
    matches: Vec<[DVec2; 2]>,
}

/// Pairs of images of a camera on the hand, with points that are seen in both.
pub(crate) struct Pairs {
    given: Pinhole,
    mount_from_given: Pose<Link, Camera>,
    pairs: Vec<Pair>,
    /// Mount-to-base by take and frame.
    mounts: Vec<Vec<Pose<Base, Link>>>,
}

impl Pairs {
    /// Follows points along all takes. Pixels at which the robot should be seen, from a camera turned by up to `off`
    /// radians, are left out.
    pub(crate) fn new(takes: &[Take<'_>], factor: u32, off: f64) -> Result<Self> {
        let filmed = takes[0].filmed();
        let lens = shrunk_lens(&filmed.lens, factor);
        let ring = RING + (off * lens.intrinsics.fx).min(f64::from(lens.width) / 16.0) as usize;
        let mount_from_given = mount_from_camera(&filmed.mount);
        let mut mounts = Vec::new();
        let mut starts = Vec::new();
        for (number, take) in takes.iter().enumerate() {
            let mut poses = Vec::new();
            for frame in 0..take.footage.frames() {
                let links = take.links(frame as f64)?.unwrap_or_default();
                poses.push(take.base_from_mount(&links));
            }
            starts.extend((0..poses.len().saturating_sub(1)).map(|frame| (number, frame)));
            mounts.push(poses);
        }
        let every = starts.len().div_ceil(MOST_STARTS).max(1);
        let starts: Vec<(usize, usize)> = starts.into_iter().step_by(every).collect();
        let pyramids: Vec<Vec<Pyramid>> = takes
            .iter()
            .map(|take| {
                let filmed = take.filmed();
                let (width, height) = (filmed.lens.width as usize, filmed.lens.height as usize);
                let grey = |image: &&[u8]| {
                    let small = shrunk(image, width, height, factor as usize);
                    Pyramid::new(Grey::of_rgb(&small, lens.width as usize, lens.height as usize))
                };
                filmed.images.par_iter().map(grey).collect()
            })
            .collect();
        let context = Context {
            takes,
            lens,
            ring,
            mount_from_given,
            mounts: &mounts,
            pyramids: &pyramids,
        };
        let found: Vec<Result<Vec<Pair>>> = starts
            .par_iter()
            .map(|&(take, frame)| context.follow(take, frame))
            .collect();
        let mut pairs = Vec::new();
        for found in found {
            pairs.extend(found?);
        }
        Ok(Self {
            given: lens,
            mount_from_given,
            pairs,
            mounts,
        })
    }

    /// Number of matches.
    pub(crate) fn len(&self) -> usize {
        self.pairs.iter().map(|pair| pair.matches.len()).sum()
    }

    /// Distances of all matches from their epipolar lines, pixels (Sampson's, signed).
    pub(crate) fn distances(&self, correction: &Correction) -> Vec<f64> {
        let of_pair = |pair: &Pair| {
            let matrix = self.fundamental(pair, correction);
            let of_match = move |points: &[DVec2; 2]| sampson(&matrix, points[0], points[1]);
            pair.matches.iter().map(of_match).collect::<Vec<f64>>()
        };
        self.pairs.iter().flat_map(of_pair).collect()
    }

    /// Residuals with derivatives by central differences.
    pub(crate) fn rows(&self, correction: &Correction, free: &[bool; UNKNOWNS]) -> Vec<Row> {
        const STEP: f64 = 1e-5;
        let unknowns: Vec<usize> = (0..UNKNOWNS).filter(|&i| free[i]).collect();
        let sides = |i: usize| {
            let size = if i == LAG { 0.02 } else { STEP };
            [-size, size].map(|size| {
                let mut step = [0.0; UNKNOWNS];
                step[i] = size;
                (correction.stepped(&step), size)
            })
        };
        let around: Vec<[(Correction, f64); 2]> = unknowns.iter().map(|&i| sides(i)).collect();
        let of_pair = |(number, pair): (usize, &Pair)| {
            let here = self.fundamental(pair, correction);
            let sides: Vec<[DMat3; 2]> = around
                .iter()
                .map(|sides| sides.each_ref().map(|(side, _)| self.fundamental(pair, side)))
                .collect();
            let row = |points: &[DVec2; 2]| {
                let mut gradient = [0.0; UNKNOWNS];
                for (place, &i) in unknowns.iter().enumerate() {
                    let [before, after] = sides[place].each_ref().map(|side| sampson(side, points[0], points[1]));
                    gradient[i] = (after - before) / (around[place][1].1 - around[place][0].1);
                }
                Row {
                    kind: Kind::Epipolar,
                    residual: sampson(&here, points[0], points[1]),
                    gradient,
                    sigma: SIGMA_PX,
                    weight: 1.0,
                    group: GROUP | number as u32,
                }
            };
            pair.matches.iter().map(row).collect::<Vec<Row>>()
        };
        let rows: Vec<Vec<Row>> = self.pairs.par_iter().enumerate().map(of_pair).collect();
        rows.into_iter().flatten().collect()
    }

    /// F of a pair: `x_second^T F x_first = 0` for image points.
    fn fundamental(&self, pair: &Pair, correction: &Correction) -> DMat3 {
        let mount_from_camera = self.mount_from_given * correction.moved;
        let poses = &self.mounts[pair.take];
        let at = |frame: usize| between(poses, frame as f64 + correction.lag_frames);
        let first: Pose<Base, Camera> = at(pair.frames[0]) * mount_from_camera;
        let second: Pose<Base, Camera> = at(pair.frames[1]) * mount_from_camera;
        fundamental(&correction.lens(&self.given), &first, &second)
    }
}

/// F between two images of one lens, scaled to a baseline of 1.
fn fundamental(lens: &Pinhole, first: &Pose<Base, Camera>, second: &Pose<Base, Camera>) -> DMat3 {
    let second_from_first: Pose<Camera, Camera> = second.inverse() * *first;
    let t = second_from_first.translation.normalize_or_zero();
    let cross = DMat3::from_cols(
        DVec3::new(0.0, t.z, -t.y),
        DVec3::new(-t.z, 0.0, t.x),
        DVec3::new(t.y, -t.x, 0.0),
    );
    let (i, zero) = (lens.intrinsics, 0.0);
    let inverse = DMat3::from_cols(
        DVec3::new(1.0 / i.fx, zero, zero),
        DVec3::new(zero, 1.0 / i.fy, zero),
        DVec3::new(-i.cx / i.fx, -i.cy / i.fy, 1.0),
    );
    inverse.transpose() * cross * second_from_first.rotation * inverse
}

/// Sampson's distance of a match from the epipolar geometry, to first order the least change of both points, pixels.
fn sampson(matrix: &DMat3, first: DVec2, second: DVec2) -> f64 {
    let (a, b) = (first.extend(1.0), second.extend(1.0));
    let (line_b, line_a) = (*matrix * a, matrix.transpose() * b);
    let size = line_b.truncate().length_squared() + line_a.truncate().length_squared();
    b.dot(line_b) / size.max(1e-300).sqrt()
}

struct Context<'a> {
    takes: &'a [Take<'a>],
    lens: Pinhole,
    /// Pixels around the robot that are left out.
    ring: usize,
    mount_from_given: Pose<Link, Camera>,
    mounts: &'a [Vec<Pose<Base, Link>>],
    pyramids: &'a [Vec<Pyramid>],
}

impl Context<'_> {
    /// Pairs of a frame with later ones.
    fn follow(&self, take: usize, first: usize) -> Result<Vec<Pair>> {
        let pyramids = &self.pyramids[take];
        let masked = self.masked(take, first)?;
        let points = pyramids[first].corners(&masked, MOST_POINTS);
        let mut now: Vec<Option<[f32; 2]>> = points.iter().copied().map(Some).collect();
        let camera = |frame: usize| (self.mounts[take][frame] * self.mount_from_given).translation;
        let mut paired = camera(first);
        let mut pairs = Vec::new();
        for frame in first + 1..(first + LONGEST + 1).min(pyramids.len()) {
            let masked = self.masked(take, frame)?;
            for place in &mut now {
                *place = place.and_then(|at| pyramids[frame - 1].follow(at, &pyramids[frame]));
                *place = place.filter(|at| {
                    let index = (at[1] + 0.5) as usize * self.lens.width as usize + (at[0] + 0.5) as usize;
                    masked.get(index) == Some(&false)
                });
            }
            let gone = (camera(frame) - camera(first)).length();
            if gone < STEP_M || (camera(frame) - paired).length() < STEP_M {
                continue;
            }
            let matches: Vec<[DVec2; 2]> = points
                .iter()
                .zip(&now)
                .filter_map(|(&from, to)| Some([pixel(from), pixel((*to)?)]))
                .filter(|[from, to]| (*to - *from).length() >= LEAST_MOTION_PX)
                .collect();
            if matches.len() < 8 {
                break;
            }
            paired = camera(frame);
            pairs.push(Pair {
                take,
                frames: [first, frame],
                matches,
            });
            if pairs.len() == MOST_PAIRS {
                break;
            }
        }
        Ok(pairs)
    }

    /// Where the robot should be seen, and around it.
    fn masked(&self, number: usize, frame: usize) -> Result<Vec<bool>> {
        let take = &self.takes[number];
        let (width, height) = (self.lens.width as usize, self.lens.height as usize);
        let links = take.links(frame as f64)?.unwrap_or_default();
        let camera_from_base = (take.base_from_mount(&links) * self.mount_from_given).inverse();
        let camera_from_link: Vec<Pose<Camera, Link>> = links.iter().map(|&link| camera_from_base * link).collect();
        let drawn =
            Renderer::new(take.footage.scene).render(&self.lens, &camera_from_link, &RenderOptions::default(), 1)?;
        let mut masked = vec![false; width * height];
        for (at, _) in drawn.link.iter().enumerate().filter(|(_, link)| **link != NO_LINK) {
            let (column, row) = (at % width, at / width);
            for y in row.saturating_sub(self.ring)..(row + self.ring + 1).min(height) {
                let line = y * width;
                masked[line + column.saturating_sub(self.ring)..line + (column + self.ring + 1).min(width)].fill(true);
            }
        }
        Ok(masked)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::correction::Prior;
    use crate::solve::minimise;

    #[test]
    fn projections_of_one_point_keep_to_the_epipolar_line() {
        let lens = Pinhole::centred(150.0, 320, 192);
        let first: Pose<Base, Camera> = Pose::from_xyz_euler([0.1, 0.0, 0.0], [0.05, 0.1, 0.0]);
        let second: Pose<Base, Camera> = Pose::from_xyz_euler([0.2, 0.1, 0.05], [0.0, 0.15, 0.2]);
        let matrix = fundamental(&lens, &first, &second);
        for i in 0..20 {
            let point = DVec3::new(
                f64::from(i % 5) * 0.1 - 0.2,
                f64::from(i / 5) * 0.1 - 0.2,
                0.8 + 0.05 * f64::from(i),
            );
            let seen = |pose: &Pose<Base, Camera>| lens.project(pose.inverse().point(point)).unwrap().0;
            let (a, b) = (seen(&first), seen(&second));
            assert!(sampson(&matrix, a, b).abs() < 1e-9);
            // A pixel across the line is at most a pixel of distance, shared by the two points.
            let line = (matrix * a.extend(1.0)).truncate().normalize();
            let off = sampson(&matrix, a, b + line).abs();
            assert!((0.5..1.0).contains(&off), "{off}");
        }
    }

    /// Numbers of 0 to 1 without period.
    fn random(seed: &mut u64) -> f64 {
        *seed = seed
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (*seed >> 33) as f64 / (1u64 << 31) as f64
    }

    /// A wrist that goes and turns, filmed by a camera with another pose, focal length and clock than was said; of the
    /// matches, one in five moves with the hand, one in four was followed to anywhere.
    fn filmed(truth: &Correction) -> Pairs {
        let seed = &mut 7;
        let given = Pinhole::centred(193.0, 320, 180);
        let mount_from_given: Pose<Link, Camera> = Pose::from_xyz_euler([-0.07, 0.03, 0.02], [0.1, 0.3, -1.5]);
        let mounts = (0..28).map(|frame| {
            let wave = |amount: f64, slow: f64, at: f64| amount * libm::sin(f64::from(frame) / slow + at);
            Pose::from_xyz_euler(
                [wave(0.16, 5.0, 0.0), wave(0.14, 4.0, 1.0), 0.5 + wave(0.12, 6.0, 2.0)],
                [3.1 + wave(0.25, 3.5, 0.0), wave(0.3, 4.5, 1.5), wave(0.5, 5.5, 2.5)],
            )
        });
        let mut pairs = Pairs {
            given,
            mount_from_given,
            pairs: Vec::new(),
            mounts: vec![mounts.collect()],
        };
        let lens = truth.lens(&given);
        for first in 0..24 {
            for second in [first + 2, first + 4] {
                let [from, to] = [first, second].map(|frame| {
                    let base_from_mount = between(&pairs.mounts[0], frame as f64 + truth.lag_frames);
                    base_from_mount * mount_from_given * truth.moved
                });
                let mut matches = Vec::new();
                while matches.len() < 40 {
                    let place = DVec2::new(320.0 * random(seed), 180.0 * random(seed));
                    let point = from.point(lens.unproject(place, 0.25 + 0.6 * random(seed)));
                    let Some((seen, _)) = lens.project(to.inverse().point(point)) else {
                        continue;
                    };
                    let noise = |seed: &mut u64| 0.5 * DVec2::new(random(seed) - 0.5, random(seed) - 0.5);
                    let second = match matches.len() % 20 {
                        0..4 => place + DVec2::new(3.0, 2.0) * (0.5 + random(seed)),
                        4..9 => place + 30.0 * DVec2::new(random(seed) - 0.5, random(seed) - 0.5),
                        _ => seen + noise(seed),
                    };
                    matches.push([place + noise(seed), second]);
                }
                let frames = [first, second];
                pairs.pairs.push(Pair {
                    take: 0,
                    frames,
                    matches,
                });
            }
        }
        pairs
    }

    fn solved(pairs: &Pairs, prior: &Prior) -> Correction {
        let free = prior.sigmas().map(|sigma| sigma.is_some());
        let widest = [5.0, 4.0, 2.7, 2.0, 1.3, 1.0, 0.7, 0.5, 0.3];
        widest.into_iter().fold(Correction::NONE, |start, widest| {
            let rows = |correction: &Correction| Some(pairs.rows(correction, &free));
            minimise(start, prior, widest, 12, rows).unwrap().correction
        })
    }

    #[test]
    fn pose_focal_length_and_delay_are_found_among_points_that_move() {
        let truth = Correction::NONE.stepped(&[0.03, -0.025, 0.03, 0.006, -0.008, 0.004, -0.05, 0.0, 0.0, -0.12]);
        let pairs = filmed(&truth);
        let off = |found: &Correction| {
            let off = truth.moved.inverse() * found.moved;
            let degrees = off.quaternion().to_scaled_axis().length().to_degrees();
            [degrees, 1000.0 * off.translation.length()]
        };
        let found = solved(
            &pairs,
            &Prior {
                focal: Some(0.05),
                ..Prior::HAND_EYE
            },
        );
        let [degrees, mm] = off(&found);
        println!("{degrees:.3} deg, {mm:.2} mm, {found:?}");
        assert!(degrees < 0.15 && mm < 2.0, "{degrees} deg, {mm} mm");
        assert!((found.focal - truth.focal).abs() < 0.005, "{found:?}");
        assert!((found.lag_frames - truth.lag_frames).abs() < 0.02, "{found:?}");
        // As the lens and the clock were said to be, the pose makes up for what they are not.
        let fixed = solved(
            &pairs,
            &Prior {
                lag_frames: None,
                ..Prior::HAND_EYE
            },
        );
        let [worse, more] = off(&fixed);
        println!("as given: {worse:.3} deg, {more:.2} mm");
        assert!(worse > 2.0 * degrees && more > 2.0 * mm, "{worse} deg, {more} mm");
    }
}
