//! Where the silhouette lies in the images, to a small part of a pixel (`docs/spec/calibration.md` section 4).

use glam::DVec2;
use rogs_agreement::{ContourKind, ContourPoint, solve};
use rogs_schemas::records::robot::NO_LINK;

/// Half the length of the part of a silhouette that is compared at once, pixels.
const ALONG_PX: f64 = 2.0;
/// Pixels beyond the search that are compared with.
const BEYOND_PX: f64 = 2.5;
/// Distance of the places tried, pixels.
const STEP_PX: f64 = 0.25;
/// Terms that colours are explained by.
const TERMS: usize = 5;
/// Penalties on their squares: the two colours are free, their slopes are known to be small, that of what lies behind above
/// all.
const PENALTIES: [f64; TERMS] = [1e-6, 1e-6, 1.0, 10.0, 1.0];
/// Neighbouring pixels and their channels have errors in common: so many count as one.
const TOGETHER: f64 = 4.0;
/// Least variance of a pixel, grey values squared: sensors and films have noise.
const NOISE: f64 = 4.0;
/// A place is as good as another within this distance, pixels.
const PEAK_PX: f64 = 0.75;

/// How the colours of two surfaces mix in a pixel that both share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Mixing {
    /// As light does: by the linear values behind the sRGB levels.
    Light,
    /// As images do that were made smaller: by their levels.
    Levels,
}

/// Values of all 256 levels, 0 to 255.
pub(crate) fn values(mixing: Mixing) -> [f32; 256] {
    std::array::from_fn(|level| match mixing {
        Mixing::Levels => level as f32,
        Mixing::Light => {
            let x = level as f32 / 255.0;
            let light = if x <= 0.040_45 {
                x / 12.92
            } else {
                libm::powf((x + 0.055) / 1.055, 2.4)
            };
            255.0 * light
        }
    })
}

/// Share of the robot in pixels anywhere in an image.
pub(crate) struct Coverage {
    factor: usize,
    columns: usize,
    rows: usize,
    // `[rows, columns]`, of the squares of a pixel's size whose first corner lies at that sample.
    share: Vec<f32>,
}

impl Coverage {
    /// From link ids at `factor` by `factor` samples a pixel, `[height, width]` samples.
    pub(crate) fn new(link: &[u8], width: usize, height: usize, factor: usize) -> Self {
        let (columns, rows) = ((width + 1).saturating_sub(factor), (height + 1).saturating_sub(factor));
        let mut sums = vec![0u16; columns * height];
        for row in 0..height {
            let line = &link[row * width..(row + 1) * width];
            let robot = |column: usize| u16::from(line[column] != NO_LINK);
            let mut sum: u16 = (0..factor.min(width)).map(robot).sum();
            for column in 0..columns {
                sums[row * columns + column] = sum;
                if column + factor < width {
                    sum = sum + robot(column + factor) - robot(column);
                }
            }
        }
        let scale = 1.0 / (factor * factor) as f32;
        let mut share = vec![0.0; columns * rows];
        for column in 0..columns {
            let mut sum: u16 = (0..factor.min(height)).map(|row| sums[row * columns + column]).sum();
            for row in 0..rows {
                share[row * columns + column] = f32::from(sum) * scale;
                if row + factor < height {
                    sum = sum + sums[(row + factor) * columns + column] - sums[row * columns + column];
                }
            }
        }
        Self {
            factor,
            columns,
            rows,
            share,
        }
    }

    /// Share of the robot in the square of a pixel's size around a point; `None` where it leaves the image.
    fn at(&self, point: DVec2) -> Option<f64> {
        let corner = self.factor as f64 * (point - 0.5);
        let (x, y) = (corner.x, corner.y);
        if !(x >= 0.0 && y >= 0.0 && x <= (self.columns - 1) as f64 && y <= (self.rows - 1) as f64) {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let (u, v) = ((x - column as f64) as f32, (y - row as f64) as f32);
        let value = |column: usize, row: usize| {
            self.share[row.min(self.rows - 1) * self.columns + column.min(self.columns - 1)]
        };
        let above = value(column, row) * (1.0 - u) + value(column + 1, row) * u;
        let below = value(column, row + 1) * (1.0 - u) + value(column + 1, row + 1) * u;
        Some(f64::from(above * (1.0 - v) + below * v))
    }
}

/// Where the edge of a silhouette lies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Place {
    /// Signed distance along the outward normal, pixels.
    pub offset_px: f64,
    /// Its standard deviation, pixels.
    pub sigma_px: f64,
    /// Confidence that no other place in reach is as good, 0 to 1.
    pub weight: f64,
    /// Share of the colours' variance that the two sides explain.
    pub explained: f64,
}

/// One silhouette after another in one image.
pub(crate) struct Outline<'a> {
    /// RGB, 8 bit. `[height, width, 3]`
    pub rgb: &'a [u8],
    pub width: usize,
    pub height: usize,
    /// Values of levels.
    pub values: &'a [f32; 256],
    pub coverage: &'a Coverage,
    /// How far edges are sought, pixels to each side.
    pub range_px: f64,
}

/// A pixel beside a silhouette: where its centre is, and its colour less the mean.
struct Near {
    at: DVec2,
    along_normal: f64,
    colour: [f64; 3],
}

impl Outline<'_> {
    /// The place of the silhouette at a contour point of the samples. Around it, pixels are of a colour inside and one
    /// outside, each with a slope along the normal, mixed by the share of the drawn robot, which is moved along the normal
    /// until they are explained best.
    pub(crate) fn place(&self, point: &ContourPoint) -> Option<Place> {
        if point.kind != ContourKind::Silhouette {
            return None;
        }
        let centre = point.pixel / self.coverage.factor as f64;
        let normal = point.normal;
        let near = self.near(centre, normal)?;
        let steps = (self.range_px / STEP_PX).round() as i32;
        let mut squares = Vec::with_capacity(2 * steps as usize + 1);
        for step in -steps..=steps {
            squares.push(self.squares(&near, normal, f64::from(step) * STEP_PX)?);
        }
        let total: f64 = near.iter().flat_map(|near| near.colour).map(|c| c * c).sum();
        found(&squares, near.len(), total)
    }

    fn near(&self, centre: DVec2, normal: DVec2) -> Option<Vec<Near>> {
        let across = self.range_px + BEYOND_PX;
        let reach = f64::hypot(across, ALONG_PX);
        let first = (centre - reach).floor();
        let last = (centre + reach).ceil();
        if first.x < 0.0 || first.y < 0.0 || last.x > self.width as f64 || last.y > self.height as f64 {
            return None;
        }
        let mut near = Vec::with_capacity(64);
        let mut mean = [0.0; 3];
        for row in first.y as usize..last.y as usize {
            for column in first.x as usize..last.x as usize {
                let at = DVec2::new(column as f64 + 0.5, row as f64 + 0.5);
                let away = at - centre;
                let along_normal = away.dot(normal);
                if along_normal.abs() > across || away.perp_dot(normal).abs() > ALONG_PX {
                    continue;
                }
                let pixel = 3 * (row * self.width + column);
                let colour: [f64; 3] =
                    std::array::from_fn(|c| f64::from(self.values[usize::from(self.rgb[pixel + c])]));
                (0..3).for_each(|c| mean[c] += colour[c]);
                near.push(Near {
                    at,
                    along_normal,
                    colour,
                });
            }
        }
        let count = near.len() as f64;
        for near in &mut near {
            (0..3).for_each(|c| near.colour[c] -= mean[c] / count);
        }
        (near.len() >= 12).then_some(near)
    }

    /// Least sum of squares of what is left of the colours when the silhouette is moved.
    fn squares(&self, near: &[Near], normal: DVec2, moved: f64) -> Option<f64> {
        let mut matrix = [[0.0; TERMS]; TERMS];
        let mut rights = [[0.0; TERMS]; 3];
        let mut sum = 0.0;
        for near in near {
            let inside = self.coverage.at(near.at - normal * moved)?;
            let away = near.along_normal - moved;
            // So light falls off towards the limb of something round.
            let round = libm::sqrt((-away).max(0.0));
            let terms = [
                inside,
                1.0 - inside,
                inside * away,
                (1.0 - inside) * away,
                inside * round,
            ];
            for i in 0..TERMS {
                for j in 0..=i {
                    matrix[i][j] += terms[i] * terms[j];
                }
                for channel in 0..3 {
                    rights[channel][i] += terms[i] * near.colour[channel];
                }
            }
            sum += near.colour.iter().map(|c| c * c).sum::<f64>();
        }
        (0..TERMS).for_each(|i| matrix[i][i] += PENALTIES[i]);
        for right in rights {
            let solved = solve(matrix, right)?;
            sum -= solved.iter().zip(right).map(|(a, b)| a * b).sum::<f64>();
        }
        Some(sum.max(0.0))
    }
}

/// The best place by the squares that are left at each.
fn found(squares: &[f64], pixels: usize, total: f64) -> Option<Place> {
    let best = (0..squares.len()).min_by(|&a, &b| squares[a].total_cmp(&squares[b]))?;
    // At an end it is the flank of something beyond.
    if best == 0 || best + 1 == squares.len() {
        return None;
    }
    let least = squares[best];
    let variance = (least / (3.0 * (pixels as f64 - 4.0).max(1.0))).max(NOISE) * TOGETHER;
    let (before, after) = (squares[best - 1] - least, squares[best + 1] - least);
    let bend = (before + after) / (STEP_PX * STEP_PX);
    if bend <= 0.0 || bend.is_nan() {
        return None;
    }
    let middle = (squares.len() / 2) as f64;
    let part = 0.5 * (before - after) / (before + after);
    let place = best as f64 - middle + part;
    let peak = (PEAK_PX / STEP_PX) as usize;
    let (mut mass, mut all) = (0.0, 0.0);
    for (at, value) in squares.iter().enumerate() {
        let likelihood = libm::exp(-0.5 * (value - least) / variance);
        all += likelihood;
        if at.abs_diff(best) <= peak {
            mass += likelihood;
        }
    }
    let width = ((2 * peak + 1) as f64 / squares.len() as f64).min(0.9);
    Some(Place {
        offset_px: place * STEP_PX,
        sigma_px: f64::sqrt(2.0 * variance / bend),
        weight: ((mass / all - width) / (1.0 - width)).clamp(0.0, 1.0),
        explained: 1.0 - least / total.max(1e-9),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rogs_agreement::{Surface, contours};

    /// A disc of half a grey on another, drawn by areas, in light; and its samples at `factor`.
    fn disc(size: usize, centre: DVec2, radius: f64, factor: usize) -> (Vec<u8>, Vec<u8>) {
        let inside = |x: f64, y: f64| DVec2::new(x, y).distance(centre) < radius;
        let fine = 16;
        let encode = |light: f64| {
            let level = if light <= 0.003_130_8 {
                12.92 * light
            } else {
                1.055 * light.powf(1.0 / 2.4) - 0.055
            };
            (255.0 * level + 0.5) as u8
        };
        let mut rgb = Vec::new();
        for pixel in 0..size * size {
            let (column, row) = ((pixel % size) as f64, (pixel / size) as f64);
            let part = |i: usize| (i as f64 + 0.5) / fine as f64;
            let count = (0..fine * fine)
                .filter(|i| inside(column + part(i % fine), row + part(i / fine)))
                .count() as f64;
            let share = count / (fine * fine) as f64;
            rgb.extend([encode(0.7 * share + 0.05 * (1.0 - share)); 3]);
        }
        let samples = size * factor;
        let link = (0..samples * samples)
            .map(|i| {
                let at = |i: usize| (i as f64 + 0.5) / factor as f64;
                if inside(at(i % samples), at(i / samples)) {
                    1
                } else {
                    NO_LINK
                }
            })
            .collect();
        (rgb, link)
    }

    #[test]
    fn a_bright_disc_is_as_large_as_it_is() {
        let (size, factor) = (40, 4);
        let (rgb, _) = disc(size, DVec2::new(20.4, 19.7), 10.0, factor);
        // Drawn 0.6 pixels to the left of where it is.
        let (_, link) = disc(size, DVec2::new(19.8, 19.7), 10.0, factor);
        let depth_m: Vec<f32> = link.iter().map(|&l| if l == 1 { 1.0 } else { 0.0 }).collect();
        let samples = size * factor;
        let surface = Surface {
            depth_m: &depth_m,
            link: &link,
        };
        let coverage = Coverage::new(&link, samples, samples, factor);
        let of = |mixing: Mixing| -> f64 {
            let outline = Outline {
                rgb: &rgb,
                width: size,
                height: size,
                values: &values(mixing),
                coverage: &coverage,
                range_px: 2.0,
            };
            let points = contours(&surface, samples, samples);
            let off: Vec<f64> = points
                .iter()
                .filter_map(|point| Some((point, outline.place(point)?)))
                .map(|(point, place)| {
                    assert!(place.weight > 0.9 && place.sigma_px < 0.2, "{place:?}");
                    place.offset_px - 0.6 * point.normal.x
                })
                .collect();
            assert!(off.len() > 150);
            off.iter().sum::<f64>() / off.len() as f64
        };
        assert!(of(Mixing::Light).abs() < 0.02, "{}", of(Mixing::Light));
        // The levels of mixed pixels are nearer to the brighter side.
        assert!(of(Mixing::Levels) > 0.03, "{}", of(Mixing::Levels));
    }

    #[test]
    fn coverage_is_that_of_a_square() {
        let (width, factor) = (8 * 4, 4);
        let link: Vec<u8> = (0..width * width)
            .map(|i| if i % width < 13 { 2 } else { NO_LINK })
            .collect();
        let coverage = Coverage::new(&link, width, width, factor);
        // The robot ends at 3.25.
        for (x, expected) in [(2.0, 1.0), (3.25, 0.5), (3.0, 0.75), (3.65, 0.1), (4.0, 0.0)] {
            let found = coverage.at(DVec2::new(x, 4.1)).unwrap();
            assert!((found - expected).abs() < 1e-6, "{x}: {found}");
        }
        assert_eq!(coverage.at(DVec2::new(0.4, 4.0)), None);
        assert_eq!(coverage.at(DVec2::new(4.0, 7.6)), None);
    }
}
