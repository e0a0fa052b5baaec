//! Updates of the motion alone, against the tracks, before any image is rendered (`docs/spec/baseline-som.md` section 4).

use glam::{DVec2, DVec3};
use rayon::prelude::*;
use rogs_optimise::losses::Loss;
use rogs_optimise::losses::robust::masked_l1;
use rogs_optimise::losses::smoothness::{acceleration, bases_smoothness, ray_acceleration};
use rogs_optimise::{Adam, bases};
use rogs_worker::{Observer, StageResult};

use crate::initial::Followed;
use crate::internal;
use crate::motion::{self, At};
use crate::observed::Observed;
use crate::scene::{Scene, add};

/// Learning rates of rotations, translations, coefficients and means; all fall to a tenth.
const RATES: [f64; 4] = [1e-2, 3e-2, 1e-2, 1e-3];
const LAST_RATE: f64 = 0.1;
/// Weights of the losses.
const HIDDEN: f64 = 0.5;
const MIXTURE: f64 = 0.01;
const ALONG_RAY: f64 = 0.1;
/// Share of the hidden points whose error counts.
const HIDDEN_KEPT: f64 = 0.95;
/// Weight of smoothness: the first up to this share of the updates, then evenly to the second.
const SMOOTH: [f64; 2] = [0.01, 0.1];
const SMOOTH_FROM: f64 = 0.4;

/// Fits bases, coefficients and canonical centres of the foreground to the tracks.
///
/// # Errors
/// Never for a scene that was made from these tracks.
pub(crate) fn fit(
    scene: &mut Scene,
    followed: &Followed,
    observed: &Observed,
    updates: u32,
    observer: &mut dyn Observer,
) -> StageResult<()> {
    let targets = Targets::new(followed, observed);
    let mut moments = [
        Adam::new(scene.bases.rotations.len()),
        Adam::new(scene.bases.translations.len()),
        Adam::new(scene.coefficients.len()),
        Adam::new(scene.foreground.means.len()),
    ];
    for update in 0..updates {
        let share = f64::from(update) / f64::from(updates);
        let rising = ((share - SMOOTH_FROM) / (1.0 - SMOOTH_FROM)).max(0.0);
        let smooth = SMOOTH[0] + (SMOOTH[1] - SMOOTH[0]) * rising;
        let (value, gradient) = loss(scene, &targets, smooth)?;
        let fall = libm::pow(LAST_RATE, share);
        let arrays = [
            (&mut scene.bases.rotations, &gradient.bases.rotations),
            (&mut scene.bases.translations, &gradient.bases.translations),
            (&mut scene.coefficients, &gradient.coefficients),
            (&mut scene.foreground.means, &gradient.foreground.means),
        ];
        for (((array, gradient), moments), rate) in arrays.into_iter().zip(&mut moments).zip(RATES) {
            moments.update(rate * fall, array, gradient).map_err(internal)?;
        }
        if update % 10 == 0 {
            let what = format!("tracks alone, update {update} of {updates}, loss {value:.4}");
            observer.progress(share, &what);
        }
    }
    Ok(())
}

/// What the motion is compared with.
pub(crate) struct Targets<'a> {
    observed: &'a Observed,
    frames: usize,
    /// `[G, T, 3]`
    positions_m: Vec<f32>,
    /// Confidence where a point is seen, 0 elsewhere. `[G, T]`
    seen: Vec<f32>,
    /// Places in `[G, T]` at which a point is hidden.
    hidden: Vec<usize>,
    /// Confidence of those. `[hidden]`
    sure: Vec<f32>,
    /// Image points of those. `[hidden, 2]`
    pixels: Vec<f32>,
}

impl<'a> Targets<'a> {
    pub(crate) fn new(followed: &Followed, observed: &'a Observed) -> Self {
        let frames = followed.frames;
        let sights = &followed.sights;
        let hidden: Vec<usize> = (0..sights.len()).filter(|&at| sights[at].invisible).collect();
        let pixel = |&at: &usize| {
            let camera = observed.frames[at % frames].base_from_camera.inverse();
            let point = camera.point(followed.positions_m[at]);
            Image::of(observed, point).place.as_vec2().to_array()
        };
        Self {
            observed,
            frames,
            positions_m: followed
                .positions_m
                .iter()
                .flat_map(|place| place.as_vec3().to_array())
                .collect(),
            seen: sights
                .iter()
                .map(|sight| if sight.visible { sight.confidence } else { 0.0 })
                .collect(),
            sure: hidden.iter().map(|&at| sights[at].confidence).collect(),
            pixels: hidden.iter().flat_map(pixel).collect(),
            hidden,
        }
    }
}

/// Where a point lies in the image, and how it moves there.
pub(crate) struct Image {
    pub(crate) place: DVec2,
    point: DVec3,
    focal: [f64; 2],
}

/// Points nearer than this are projected as if they were here.
const LEAST_DEPTH: f64 = 1e-6;

impl Image {
    /// Of a point in the camera's frame.
    pub(crate) fn of(observed: &Observed, point: DVec3) -> Self {
        let k = &observed.lens.intrinsics;
        let depth = point.z.max(LEAST_DEPTH);
        Self {
            place: DVec2::new(k.fx * point.x / depth + k.cx, k.fy * point.y / depth + k.cy),
            point,
            focal: [k.fx, k.fy],
        }
    }

    /// Gradient with respect to the point, from that with respect to its place.
    pub(crate) fn gradient(&self, place: [f32; 2]) -> DVec3 {
        let depth = self.point.z.max(LEAST_DEPTH);
        let [x, y] = [0, 1].map(|axis| f64::from(place[axis]) * self.focal[axis] / depth);
        let z = if self.point.z > LEAST_DEPTH {
            -(x * self.point.x + y * self.point.y) / depth
        } else {
            0.0
        };
        DVec3::new(x, y, z)
    }
}

/// The loss of a scene's motion and its gradient.
pub(crate) fn loss(scene: &Scene, targets: &Targets<'_>, smooth: f64) -> StageResult<(f64, Scene)> {
    let (frames, observed) = (targets.frames, targets.observed);
    let count = scene.foreground.len();
    let shares = bases::shares(&scene.coefficients, scene.bases.len());
    let every: Vec<usize> = (0..frames).collect();
    let moved = motion::moved(scene, &shares, &every)?;
    // By point, then frame.
    let mut positions = vec![0.0; 3 * count * frames];
    positions.par_chunks_mut(3 * frames).enumerate().for_each(|(n, row)| {
        for (to, frame) in row.chunks_exact_mut(3).zip(&moved) {
            to.copy_from_slice(&frame.means[3 * n..3 * n + 3]);
        }
    });
    let mut total = masked_l1(&positions, &targets.positions_m, &targets.seen, 1.0).map_err(internal)?;
    total.add(1.0, &hidden(targets, &positions)?);
    total.add(0.5 * smooth, &acceleration(&positions, frames, 3).map_err(internal)?);
    // Around every frame but the first and the last.
    let middle = frames - 2;
    let around = |n: usize, step: usize, b: usize| 3 * (n * frames + b + step);
    let neighbours: Vec<f32> = (0..count * 3 * middle)
        .flat_map(|at| {
            let from = around(at / (3 * middle), at / middle % 3, at % middle);
            [positions[from], positions[from + 1], positions[from + 2]]
        })
        .collect();
    let centres: Vec<DVec3> = (1..=middle)
        .map(|frame| observed.frames[frame].base_from_camera.translation)
        .collect();
    let ray = ray_acceleration(&neighbours, &centres).map_err(internal)?;
    total.value += ALONG_RAY * ray.value;
    for (at, gradient) in ray.gradient.chunks_exact(3).enumerate() {
        let to = around(at / (3 * middle), at / middle % 3, at % middle);
        for axis in 0..3 {
            total.gradient[to + axis] += ALONG_RAY as f32 * gradient[axis];
        }
    }
    let gradients: Vec<At> = (0..frames)
        .into_par_iter()
        .map(|frame| At {
            frame,
            means: (0..count)
                .flat_map(|n| &total.gradient[3 * (n * frames + frame)..][..3])
                .copied()
                .collect(),
            quats: vec![0.0; 4 * count],
        })
        .collect();
    let mut gradient = scene.zeros();
    motion::add_gradient(scene, &shares, &moved, &gradients, &mut gradient)?;
    total.value += mixture(&shares, scene.bases.len(), &mut gradient.coefficients);
    let (rotations, translations) = bases_smoothness(&scene.bases).map_err(internal)?;
    total.value += smooth * rotations.value;
    add(&mut gradient.bases.rotations, smooth, &rotations.gradient);
    add(&mut gradient.bases.translations, smooth, &translations);
    Ok((total.value, gradient))
}

/// Image points of hidden tracks, in focal lengths.
fn hidden(targets: &Targets<'_>, positions: &[f32]) -> StageResult<Loss> {
    let observed = targets.observed;
    let cameras: Vec<_> = observed
        .frames
        .iter()
        .map(|frame| frame.base_from_camera.inverse())
        .collect();
    let image = |&at: &usize| {
        let place = &positions[3 * at..3 * at + 3];
        let point = cameras[at % targets.frames].point(DVec3::new(place[0].into(), place[1].into(), place[2].into()));
        Image::of(observed, point)
    };
    let images: Vec<Image> = targets.hidden.iter().map(image).collect();
    let places: Vec<f32> = images
        .iter()
        .flat_map(|image| image.place.as_vec2().to_array())
        .collect();
    let own = masked_l1(&places, &targets.pixels, &targets.sure, HIDDEN_KEPT).map_err(internal)?;
    let weight = HIDDEN / observed.lens.intrinsics.fx;
    let mut loss = Loss {
        value: weight * own.value,
        gradient: vec![0.0; positions.len()],
    };
    for ((&at, image), gradient) in targets.hidden.iter().zip(&images).zip(own.gradient.chunks_exact(2)) {
        let in_camera = image.gradient([gradient[0], gradient[1]]) * weight;
        let in_base = observed.frames[at % targets.frames]
            .base_from_camera
            .direction(in_camera);
        for axis in 0..3 {
            loss.gradient[3 * at + axis] += in_base[axis] as f32;
        }
    }
    Ok(loss)
}

/// How far mixtures are from one base alone, `1 - mean sum a^2`; its gradient is added to that of the logits.
fn mixture(shares: &[f32], bases: usize, gradient: &mut [f32]) -> f64 {
    let count = (shares.len() / bases.max(1)).max(1) as f64;
    let mut value = MIXTURE;
    for (row, to) in shares
        .chunks_exact(bases.max(1))
        .zip(gradient.chunks_exact_mut(bases.max(1)))
    {
        let square: f64 = row.iter().map(|&share| f64::from(share) * f64::from(share)).sum();
        value -= MIXTURE * square / count;
        for (to, &share) in to.iter_mut().zip(row) {
            let share = f64::from(share);
            *to -= (2.0 * MIXTURE / count * share * (share - square)) as f32;
        }
    }
    value
}
