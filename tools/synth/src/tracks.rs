//! 3D tracks: points of robot and objects that are seen in an anchor frame, followed through the episode.

use glam::DVec3;
use rayon::prelude::*;

use crate::episode::Episode;
use crate::math::Draw;
use crate::raycast::first_hit;
use crate::render::View;
use crate::scene::{FIRST_OBJECT_ID, FIRST_SCENERY_ID};

/// Slack of the visibility test along the line of sight, metres.
const SLACK: f64 = 1e-4;

/// Points with their positions at all frames.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EpisodeTracks {
    /// Frame of the anchor pixels.
    pub anchor_frame: usize,
    /// Camera of each anchor pixel. `[K]`
    pub camera: Vec<u32>,
    /// Column and row of each anchor pixel. `[K]`
    pub pixel: Vec<[u32; 2]>,
    /// Id of the link or object each point belongs to. `[K]`
    pub id: Vec<u8>,
    /// Positions in the base frame, metres. `[K, F, 3]`
    pub position_m: Vec<f32>,
    /// 1 where the anchor camera sees the point. `[K, F]`
    pub visible: Vec<u8>,
}

impl Episode {
    /// Tracks anchored in the three source cameras, whose pictures at the anchor frame are `views`.
    #[must_use]
    pub fn tracks(&self, views: &[View]) -> EpisodeTracks {
        let anchor = self.config.anchor() as usize;
        let mut draw = Draw::new(self.seed, 7);
        let mut tracks = EpisodeTracks {
            anchor_frame: anchor,
            ..EpisodeTracks::default()
        };
        for (camera, view) in views.iter().enumerate().take(3) {
            let links = |id: u8| id < FIRST_OBJECT_ID;
            let objects = |id: u8| (FIRST_OBJECT_ID..FIRST_SCENERY_ID).contains(&id);
            let [most_links, most_objects] = self.config.tracks_per_camera;
            let mut pixels = choose(&mut draw, &view.id, links, most_links);
            pixels.extend(choose(&mut draw, &view.id, objects, most_objects));
            let width = self.cameras[camera].lens.width as usize;
            for pixel in pixels {
                tracks.camera.push(camera as u32);
                tracks.pixel.push([(pixel % width) as u32, (pixel / width) as u32]);
                tracks.id.push(view.id[pixel]);
            }
        }
        let follow = |track: usize| self.follow(&tracks, track, &views[tracks.camera[track] as usize]);
        let followed: Vec<_> = (0..tracks.camera.len()).into_par_iter().map(follow).collect();
        for (positions, visible) in followed {
            tracks.position_m.extend(positions);
            tracks.visible.extend(visible);
        }
        tracks
    }

    fn follow(&self, tracks: &EpisodeTracks, track: usize, view: &View) -> (Vec<f32>, Vec<u8>) {
        let camera = tracks.camera[track] as usize;
        let lens = &self.cameras[camera].lens;
        let k = &lens.intrinsics;
        let [column, row] = tracks.pixel[track];
        let depth = f64::from(view.depth_m[(row * lens.width + column) as usize]);
        let ray = DVec3::new(
            (f64::from(column) + 0.5 - k.cx) / k.fx,
            (f64::from(row) + 0.5 - k.cy) / k.fy,
            1.0,
        );
        let anchor = tracks.anchor_frame;
        let point = self.base_from_camera(camera, anchor).point(ray * depth);
        let Some(body) = self.bodies.iter().position(|body| body.id == tracks.id[track]) else {
            return (Vec::new(), Vec::new());
        };
        let in_body = self.poses[anchor][body].inverse().point(point);
        let mut positions = Vec::with_capacity(3 * self.frame_count());
        let mut visible = Vec::with_capacity(self.frame_count());
        for frame in 0..self.frame_count() {
            let position = self.poses[frame][body].point(in_body);
            positions.extend(position.as_vec3().to_array());
            visible.push(u8::from(frame == anchor || self.sees(camera, frame, position)));
        }
        (positions, visible)
    }

    /// Whether a point of a surface is in the picture of a camera and nothing is in front of it.
    fn sees(&self, camera: usize, frame: usize, point: DVec3) -> bool {
        let pose = self.base_from_camera(camera, frame);
        let p = pose.inverse().point(point);
        let lens = &self.cameras[camera].lens;
        let k = &lens.intrinsics;
        if p.z < crate::render::NEAR {
            return false;
        }
        let (u, v) = (p.x / p.z * k.fx + k.cx, p.y / p.z * k.fy + k.cy);
        if !(0.0..f64::from(lens.width)).contains(&u) || !(0.0..f64::from(lens.height)).contains(&v) {
            return false;
        }
        // In lengths of the direction, one is the point itself; a point whose face looks away is behind its own body.
        let direction = point - pose.translation;
        let slack = SLACK / direction.length();
        let nearest = first_hit(
            &self.bodies,
            &self.poses[frame],
            pose.translation,
            direction,
            crate::render::NEAR / p.z,
        );
        nearest.is_some_and(|(t, _)| t > 1.0 - slack && t < 1.0 + 20.0 * slack)
    }
}

/// At most `most` pixels whose id passes, drawn without repetition.
fn choose(draw: &mut Draw, ids: &[u8], wanted: impl Fn(u8) -> bool, most: u32) -> Vec<usize> {
    let mut pixels: Vec<usize> = (0..ids.len()).filter(|&pixel| wanted(ids[pixel])).collect();
    let count = (most as usize).min(pixels.len());
    for k in 0..count {
        let other = k + draw.index(pixels.len() - k);
        pixels.swap(k, other);
    }
    pixels.truncate(count);
    pixels
}
