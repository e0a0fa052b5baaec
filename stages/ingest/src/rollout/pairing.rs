//! What else the first frame of a rollout could show than the first recorded one: the recording at another moment,
//! another camera of it, or a part of it.
//!
//! Every guess is an image `O` made of recorded ones, held against the recorded image `R` that the generated one `G`
//! should be. With `D = O - R`, the share of the way from `R` to `O` at which `G` lies is
//! `a = <G - R, D> / |D|^2 = 1/2 + (|G - R|^2 - |G - O|^2) / (2 |D|^2)`. Noise and blur of the model have little to do
//! with `D` and leave `a` near 0; a frame that is `O` has 1, however little `O` and `R` differ.

use rogs_schemas::records::clip::ClipCamera;
use rogs_worker::StageResult;

use super::Wanted;
use crate::params::Params;
use crate::resize::Mapping;
use crate::source::SourceCamera;

/// Least share of the way to another image at which a frame is taken to be that one. Where nothing moves, sensor noise in
/// both recorded images, which a model does not repeat, gives 1/2.
const SHARE: f64 = 0.75;
/// Mean square from the other image over that from the right one, at most: half a decibel closer.
const CLOSER: f64 = 0.89;
/// The same of images that were scaled: three decibels closer.
const CLOSER_SCALED: f64 = 0.5;
/// Images that differ by less say nothing, mean square in levels of 8 bits.
const ALIKE: f64 = 1.0;
/// Episode frames before the clip that are looked at; at least a step of the clip.
const BEFORE: u32 = 4;
/// Parts of the recorded image that a view may show instead of all of it: shares of its width and height.
const SCALES: [f64; 6] = [0.75, 0.8, 0.9, 1.1, 1.25, 4.0 / 3.0];
/// Least share of a view that lies in the recorded image for the two to be compared.
const INSIDE: f64 = 0.5;

/// What a first frame shows instead.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Instead {
    /// The source camera whose view it is.
    pub(super) camera: usize,
    /// In words.
    pub(super) what: String,
    /// PSNR from what it should be and from what it is, dB.
    pub(super) db: [f64; 2],
    /// What to do.
    pub(super) hint: String,
}

/// Finds a camera whose first generated image is clearly something else than its first recorded one.
///
/// # Errors
/// When recorded images cannot be read.
pub(super) fn instead(
    wanted: &Wanted<'_>,
    sources: &[&SourceCamera],
    cameras: &[ClipCamera],
    params: &Params,
) -> StageResult<Option<Instead>> {
    let size = (params.width as usize, params.height as usize);
    let area = size.0 * size.1 * 3;
    let first = |images: &Option<Vec<u8>>| {
        images
            .as_ref()
            .and_then(|images| images.get(..area))
            .map(<[u8]>::to_vec)
    };
    let recorded: Vec<Option<Vec<u8>>> = cameras.iter().map(|camera| first(&camera.recorded)).collect();
    for (index, camera) in sources.iter().enumerate() {
        let clip = &cameras[index];
        let (Some(generated), Some(own)) = (first(&clip.generated), &recorded[index]) else {
            continue;
        };
        let others = recorded[..sources.len()].iter().enumerate();
        let others = others.filter_map(|(other, image)| Some((other, image.as_ref()?)).filter(|_| other != index));
        let best = closest(&generated, own, others, CLOSER);
        if let Some((other, db)) = best {
            return Ok(Some(Instead {
                camera: index,
                what: format!("that of camera `{}`", cameras[other].id),
                db,
                hint: "give every view the place of its camera".to_owned(),
            }));
        }
        let moments = moments(wanted, camera, clip, area, params)?;
        let moments = moments.iter().map(|(frame, image)| (*frame, image));
        if let Some((frame, db)) = closest(&generated, own, moments, CLOSER) {
            return Ok(Some(at_another_moment(index, wanted, frame, db)));
        }
        if let Some((what, db)) = scaled(&generated, own, size) {
            return Ok(Some(Instead {
                camera: index,
                what,
                db,
                hint: "a view shows all that its recorded camera shows, scaled along each axis; of padded composites, set \
                       `image-size` under [rollouts]"
                    .to_owned(),
            }));
        }
    }
    Ok(None)
}

fn at_another_moment(camera: usize, wanted: &Wanted<'_>, frame: u32, db: [f64; 2]) -> Instead {
    let start = wanted.start.0;
    let hint = if frame < start {
        format!(
            "the rollout begins {} recorded frames before the clip: set `first-frame` under [rollouts] to the frame that \
             shows episode frame {start}, or `start_frame = {frame}` under [ingest]",
            start - frame
        )
    } else {
        format!(
            "the rollout begins {} recorded frames after the clip: set `start_frame = {frame}` under [ingest], or a smaller \
             `first-frame` under [rollouts]",
            frame - start
        )
    };
    Instead {
        camera,
        what: format!("that of episode frame {frame}, where the clip begins at {start}"),
        db,
        hint,
    }
}

/// Recorded images of other moments with their episode frames: those just before the clip, those between its first two
/// frames, and those of the clip.
fn moments(
    wanted: &Wanted<'_>,
    camera: &SourceCamera,
    clip: &ClipCamera,
    area: usize,
    params: &Params,
) -> StageResult<Vec<(u32, Vec<u8>)>> {
    let (start, step) = (wanted.start.0, wanted.step.max(1));
    let mut found = Vec::new();
    if let Some(images) = &camera.images {
        let from = start.saturating_sub(BEFORE.max(step));
        let until = start.saturating_add(step).min(wanted.source.frame_count);
        let size = (camera.width, camera.height);
        let mapping = Mapping::new(size, (params.width, params.height), params.fit);
        let mut frame = from;
        images.read((from, 1, until.saturating_sub(from)), size, |image| {
            if frame != start {
                found.push((frame, mapping.rgb(image)));
            }
            frame += 1;
        })?;
    }
    let recorded = clip.recorded.as_deref().unwrap_or_default();
    let later = recorded.chunks_exact(area).enumerate().skip(1);
    found.extend(later.map(|(index, image)| (start + index as u32 * step, image.to_vec())));
    Ok(found)
}

/// Mean squares between a generated image, the recorded one that it should be, and another.
#[derive(Debug, Clone, Copy)]
struct Squares {
    own: f64,
    other: f64,
    between: f64,
}

impl Squares {
    fn of(generated: &[u8], own: &[u8], other: &[u8]) -> Self {
        let mean = |a: &[u8], b: &[u8]| {
            let sum: u64 = a.iter().zip(b).map(|(&a, &b)| u64::from(a.abs_diff(b)).pow(2)).sum();
            sum as f64 / a.len().max(1) as f64
        };
        Self {
            own: mean(generated, own),
            other: mean(generated, other),
            between: mean(own, other),
        }
    }

    /// Whether the generated image is the other one.
    fn is_other(&self, closer: f64) -> bool {
        let share = 0.5 + (self.own - self.other) / (2.0 * self.between);
        self.between >= ALIKE && share >= SHARE && self.other <= closer * self.own
    }

    /// PSNR from the right image and from the other, dB.
    fn db(&self) -> [f64; 2] {
        [self.own, self.other].map(|square| 10.0 * (255.0_f64.powi(2) / square).log10())
    }
}

/// Of the images that the generated one is rather than its own, the closest.
fn closest<'a, K>(
    generated: &[u8],
    own: &[u8],
    others: impl Iterator<Item = (K, &'a Vec<u8>)>,
    closer: f64,
) -> Option<(K, [f64; 2])> {
    others
        .map(|(key, other)| (key, Squares::of(generated, own, other)))
        .filter(|(_, squares)| squares.is_other(closer))
        .min_by(|(_, a), (_, b)| a.other.total_cmp(&b.other))
        .map(|(key, squares)| (key, squares.db()))
}

/// Whether an image is a part of another, more than it, or its mirror image.
fn scaled(generated: &[u8], own: &[u8], size: (usize, usize)) -> Option<(String, [f64; 2])> {
    let shares = SCALES
        .iter()
        .flat_map(|&share| [[share, share], [share, 1.0], [1.0, share]]);
    let found = shares.chain([[-1.0, 1.0], [1.0, -1.0]]).filter_map(|shares| {
        let squares = part_squares(generated, own, size, shares)?;
        squares.is_other(CLOSER_SCALED).then_some((shares, squares))
    });
    let ([across, down], squares) = found.min_by(|(_, a), (_, b)| a.other.total_cmp(&b.other))?;
    let what = match (across, down) {
        (across, _) if across < 0.0 => "its mirror image, left for right".to_owned(),
        (_, down) if down < 0.0 => "the same upside down".to_owned(),
        _ => format!(
            "{} it, {:.0} % of its width and {:.0} % of its height",
            if across.min(down) < 1.0 {
                "a part of"
            } else {
                "more than"
            },
            100.0 * across,
            100.0 * down
        ),
    };
    Some((what, squares.db()))
}

/// The generated image against the recorded one scaled about its centre, where they overlap.
fn part_squares(
    generated: &[u8],
    own: &[u8],
    (width, height): (usize, usize),
    [across, down]: [f64; 2],
) -> Option<Squares> {
    let place = |at: usize, side: usize, share: f64| {
        let centre = side as f64 / 2.0;
        let place = (at as f64 + 0.5 - centre) * share + centre - 0.5;
        (0.0..=side as f64 - 1.0).contains(&place).then_some(place)
    };
    let (mut sums, mut count) = ([0.0; 3], 0_usize);
    for y in 0..height {
        let Some(from_y) = place(y, height, down) else { continue };
        let (top, ay) = (from_y as usize, from_y.fract());
        for x in 0..width {
            let Some(from_x) = place(x, width, across) else {
                continue;
            };
            let (left, ax) = (from_x as usize, from_x.fract());
            for channel in 0..3 {
                let value = |row: usize, column: usize| {
                    let (row, column) = (row.min(height - 1), column.min(width - 1));
                    f64::from(own[(row * width + column) * 3 + channel])
                };
                let above = value(top, left) * (1.0 - ax) + value(top, left + 1) * ax;
                let below = value(top + 1, left) * (1.0 - ax) + value(top + 1, left + 1) * ax;
                let other = above * (1.0 - ay) + below * ay;
                let at = (y * width + x) * 3 + channel;
                let (made, right) = (f64::from(generated[at]), f64::from(own[at]));
                for (sum, difference) in sums.iter_mut().zip([made - right, made - other, right - other]) {
                    *sum += difference * difference;
                }
            }
            count += 3;
        }
    }
    if (count as f64) < INSIDE * generated.len() as f64 {
        return None;
    }
    let [own, other, between] = sums.map(|sum| sum / count as f64);
    Some(Squares { own, other, between })
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (48, 32);

    /// A picture of smooth structure with a disc at some place, and noise of some strength.
    fn picture(disc: f64, noise: u32, seed: u32) -> Vec<u8> {
        let mut state = seed.wrapping_mul(2_654_435_761) | 1;
        let mut random = || {
            state ^= state << 13;
            state ^= state >> 17;
            state ^= state << 5;
            f64::from(state >> 8) / f64::from(1_u32 << 24) - 0.5
        };
        let mut image = Vec::new();
        for y in 0..SIZE.1 {
            for x in 0..SIZE.0 {
                let (px, py) = (x as f64, y as f64);
                let inside = (px - disc).hypot(py - 14.0) < 6.0;
                let ground = 110.0 + 30.0 * (px / 7.0).sin() + 25.0 * (py / 5.0 + px / 19.0).cos();
                for channel in 0..3 {
                    let value = if inside {
                        200.0 - 40.0 * f64::from(channel)
                    } else {
                        ground
                    };
                    image.push((value + f64::from(noise) * random()).round().clamp(0.0, 255.0) as u8);
                }
            }
        }
        image
    }

    fn found(generated: &[u8], own: &[u8], others: &[Vec<u8>]) -> Option<usize> {
        closest(generated, own, others.iter().enumerate(), CLOSER).map(|(index, _)| index)
    }

    /// The recording at frames -1, 0 and 1, with the noise of a camera; a pixel of motion from one to the next.
    fn recording() -> [Vec<u8>; 3] {
        [picture(20.0, 6, 1), picture(21.0, 6, 2), picture(22.0, 6, 3)]
    }

    #[test]
    fn a_frame_off_by_one_is_found_also_under_the_noise_of_a_model() {
        let [before, own, after] = recording();
        let others = [before, after];
        for noise in [0, 12] {
            assert_eq!(found(&picture(20.0, noise, 7), &own, &others), Some(0), "noise {noise}");
            assert_eq!(found(&picture(22.0, noise, 8), &own, &others), Some(1), "noise {noise}");
        }
    }

    #[test]
    fn the_right_frame_is_taken_whatever_the_model_does_to_it() {
        let [before, own, after] = recording();
        let others = [before, after];
        assert_eq!(found(&own, &own, &others), None);
        // Without the camera's noise, with more, and much darker.
        for generated in [picture(21.0, 0, 9), picture(21.0, 40, 10)] {
            assert_eq!(found(&generated, &own, &others), None);
        }
        let dark: Vec<u8> = own.iter().map(|&value| value / 2).collect();
        assert_eq!(found(&dark, &own, &others), None);
    }

    #[test]
    fn where_nothing_moves_no_frame_is_another() {
        let still = [picture(21.0, 6, 1), picture(21.0, 6, 3)];
        let own = picture(21.0, 6, 2);
        for seed in 20..40 {
            assert_eq!(found(&picture(21.0, 6, seed), &own, &still), None);
            assert_eq!(found(&picture(21.0, 0, seed), &own, &still), None);
        }
        assert_eq!(found(&own, &own, std::slice::from_ref(&own)), None);
    }

    #[test]
    fn parts_and_mirror_images_are_named() {
        let own = picture(21.0, 4, 1);
        let (width, height) = SIZE;
        let view = |across: f64, down: f64| -> Vec<u8> {
            let mut image = Vec::new();
            for y in 0..height {
                for x in 0..width {
                    let at = |at: usize, side: usize, share: f64| {
                        let centre = side as f64 / 2.0;
                        let place = (at as f64 + 0.5 - centre) * share + centre - 0.5;
                        place.round().clamp(0.0, side as f64 - 1.0) as usize
                    };
                    let from = (at(y, height, down) * width + at(x, width, across)) * 3;
                    image.extend(&own[from..from + 3]);
                }
            }
            image
        };
        let named = |across: f64, down: f64| scaled(&view(across, down), &own, SIZE).unwrap().0;
        assert!(named(0.75, 1.0).contains("a part of it, 75 % of its width and 100 % of its height"));
        assert!(named(0.8, 0.8).contains("80 % of its width and 80 %"));
        assert!(named(1.25, 1.25).contains("more than it, 125 %"));
        assert!(named(-1.0, 1.0).contains("left for right"));
        assert!(named(1.0, -1.0).contains("upside down"));
        for generated in [own.clone(), picture(21.0, 30, 5)] {
            assert_eq!(scaled(&generated, &own, SIZE), None);
        }
    }
}
