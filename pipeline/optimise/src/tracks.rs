//! 2D tracks with depth become 3D tracks (`docs/spec/baseline-som.md` section 3).

use glam::{DVec2, DVec3};
use rogs_geometry::{Base, Camera, Pinhole, Pose};

use crate::error::{Result, expect};
use crate::statistics::quantile;

/// How much of a bilinear sample of the mask must lie inside it.
const INSIDE: f32 = 1.0 - 1e-6;

/// What a tracker says of a point at a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sight {
    /// It is seen.
    pub visible: bool,
    /// It is hidden, and the tracker is sure of it.
    pub invisible: bool,
    /// How sure the tracker is, 0 where it is neither.
    pub confidence: f32,
}

impl Sight {
    /// From the logits of occlusion and of a large expected distance.
    #[must_use]
    pub fn from_logits(occlusion: f32, distance: f32) -> Self {
        let sure = |logit: f32| 1.0 / (1.0 + libm::expf(logit));
        let (seen, confidence) = (sure(occlusion), sure(distance));
        let (visible, invisible) = (seen * confidence > 0.5, (1.0 - seen) * confidence > 0.5);
        Self {
            visible,
            invisible,
            confidence: if visible || invisible { confidence } else { 0.0 },
        }
    }
}

/// One frame of a camera.
#[derive(Debug, Clone, Copy)]
pub struct TrackedFrame<'a> {
    /// Intrinsics that count pixel centres at integers.
    pub camera: &'a Pinhole,
    /// Pose.
    pub base_from_camera: &'a Pose<Base, Camera>,
    /// Depth, metres. `[H, W]`
    pub depth: &'a [f32],
    /// 1 inside the foreground, 0 outside. `[H, W]`
    pub mask: &'a [f32],
}

/// Tracks of one query frame in space.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Tracks3d {
    /// Which of the tracks that went in were kept. `[N]`
    pub kept: Vec<usize>,
    /// Positions, base frame, metres. `[N, T]`
    pub positions_m: Vec<DVec3>,
    /// `[N, T]`
    pub sights: Vec<Sight>,
    /// Colours at the query frame. `[N, 3]`
    pub colours: Vec<[f32; 3]>,
}

/// Lifts the tracks of a query frame: columns x, y (pixels), occlusion logit, distance logit. A track is kept where it lies
/// inside the mask at its own frame and is seen in enough frames: `min(floor(T / 20), 10 % quantile of the counts)`.
/// `tracks [N, T, 4]`, `frames [T]`, `query_image [H, W, 3]`
///
/// # Errors
/// When the lengths differ.
pub fn lift_tracks(
    tracks: &[f32],
    frames: &[TrackedFrame<'_>],
    query: usize,
    query_image: &[f32],
    height: usize,
    width: usize,
) -> Result<Tracks3d> {
    let t = frames.len();
    let count = tracks.len() / (4 * t).max(1);
    expect("tracks", tracks.len(), 4 * t * count)?;
    expect("pixels of the query image", query_image.len(), 3 * height * width)?;
    for frame in frames {
        expect("depths of a frame", frame.depth.len(), height * width)?;
        expect("pixels of a mask", frame.mask.len(), height * width)?;
    }
    let mut positions = Vec::with_capacity(count * t);
    let mut sights = Vec::with_capacity(count * t);
    let mut inside = Vec::with_capacity(count * t);
    for (index, track) in tracks.chunks_exact(4).enumerate() {
        let frame = &frames[index % t];
        let place = [track[0], track[1]];
        let depth = clamped_sample(frame.depth, height, width, 1, place)[0];
        let point = frame
            .camera
            .unproject(DVec2::new(place[0].into(), place[1].into()), depth.into());
        positions.push(frame.base_from_camera.point(point));
        let within = padded_sample(frame.mask, height, width, place) >= INSIDE;
        inside.push(within);
        sights.push(if within {
            Sight::from_logits(track[2], track[3])
        } else {
            Sight::default()
        });
    }
    let seen: Vec<f64> = sights
        .chunks_exact(t.max(1))
        .map(|row| row.iter().filter(|s| s.visible).count() as f64)
        .collect();
    let least = (t / 20) as f64;
    let least = quantile(&seen, 0.1).map_or(least, |quantile| least.min(quantile));
    let kept: Vec<usize> = (0..count)
        .filter(|&n| inside[n * t + query] && seen[n] >= least)
        .collect();
    let rows = |n: usize| n * t..(n + 1) * t;
    let colour = |n: &usize| {
        let at = 4 * (n * t + query);
        let rgb = clamped_sample(query_image, height, width, 3, [tracks[at], tracks[at + 1]]);
        [rgb[0], rgb[1], rgb[2]]
    };
    Ok(Tracks3d {
        positions_m: kept.iter().flat_map(|&n| positions[rows(n)].iter().copied()).collect(),
        sights: kept.iter().flat_map(|&n| sights[rows(n)].iter().copied()).collect(),
        colours: kept.iter().map(colour).collect(),
        kept,
    })
}

/// Bilinear sample with pixel centres at integers; places beyond the border count as on it. Of up to three channels; what
/// there is not is 0. `[height, width, channels]`, neither side 0
#[must_use]
pub fn clamped_sample(image: &[f32], height: usize, width: usize, channels: usize, [x, y]: [f32; 2]) -> [f32; 3] {
    let split = |place: f32, length: usize| {
        let place = place.clamp(0.0, (length - 1) as f32);
        let low = place.floor() as usize;
        (low, (low + 1).min(length - 1), place - low as f32)
    };
    let ((left, right, u), (top, bottom, v)) = (split(x, width), split(y, height));
    std::array::from_fn(|channel| {
        if channel >= channels {
            return 0.0;
        }
        let at = |row: usize, column: usize| image[(row * width + column) * channels + channel];
        let mix = |a: f32, b: f32, share: f32| a * (1.0 - share) + b * share;
        mix(
            mix(at(top, left), at(top, right), u),
            mix(at(bottom, left), at(bottom, right), u),
            v,
        )
    })
}

/// Bilinear sample of a mask; what lies beyond the border is 0.
fn padded_sample(mask: &[f32], height: usize, width: usize, [x, y]: [f32; 2]) -> f32 {
    let (left, top) = (x.floor(), y.floor());
    let (u, v) = (x - left, y - top);
    let at = |row: f32, column: f32| {
        let inside = row >= 0.0 && column >= 0.0 && row < height as f32 && column < width as f32;
        if inside {
            mask[row as usize * width + column as usize]
        } else {
            0.0
        }
    };
    let across = |row: f32| at(row, left) * (1.0 - u) + at(row, left + 1.0) * u;
    across(top) * (1.0 - v) + across(top + 1.0) * v
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_point_is_seen_hidden_or_neither() {
        let seen = Sight::from_logits(-5.0, -5.0);
        assert!(seen.visible && !seen.invisible && seen.confidence > 0.99);
        let hidden = Sight::from_logits(5.0, -5.0);
        assert!(!hidden.visible && hidden.invisible);
        assert_eq!(Sight::from_logits(0.0, 0.0), Sight::default());
    }
}
