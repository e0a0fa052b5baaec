//! Silhouette outlines of link maps, image edges, and how well the two lie on each other.
//!
//! The measure behind the overlay test: the share of outline pixels that have an image edge within a few pixels, beside
//! the same share for the shifted outline, which tells how much of it is chance.

use rogs_schemas::records::robot::NO_LINK;

/// Pixels of the robot that touch a pixel without robot (4-neighbourhood), ascending. The image border is not outline.
#[must_use]
pub fn silhouette(link: &[u8], width: u32, height: u32) -> Vec<u32> {
    boundary(link, width, height, |here, there| here != NO_LINK && there == NO_LINK)
}

/// Pixels of the robot that touch another link or no robot (4-neighbourhood), ascending.
#[must_use]
pub fn link_outlines(link: &[u8], width: u32, height: u32) -> Vec<u32> {
    boundary(link, width, height, |here, there| here != NO_LINK && there != here)
}

fn boundary(link: &[u8], width: u32, height: u32, differs: impl Fn(u8, u8) -> bool) -> Vec<u32> {
    let (w, h) = (width as usize, height as usize);
    let on_boundary = |pixel: usize| {
        let (column, row, here) = (pixel % w, pixel / w, link[pixel]);
        (column > 0 && differs(here, link[pixel - 1]))
            || (column + 1 < w && differs(here, link[pixel + 1]))
            || (row > 0 && differs(here, link[pixel - w]))
            || (row + 1 < h && differs(here, link[pixel + w]))
    };
    (0..w * h)
        .filter(|&pixel| on_boundary(pixel))
        .map(|pixel| pixel as u32)
        .collect()
}

/// How image edges are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeOptions {
    /// Standard deviation of the smoothing, pixels.
    pub sigma_px: f32,
    /// Gradients below this are not edges, grey values (0..255) per pixel.
    pub low: f32,
    /// Edges need one pixel with at least this gradient.
    pub high: f32,
}

impl Default for EdgeOptions {
    fn default() -> Self {
        Self {
            sigma_px: 1.0,
            low: 4.0,
            high: 10.0,
        }
    }
}

/// Edge pixels of an RGB image (`[H, W, 3]`, 8 bit): local maxima of the smoothed gradient along its direction, linked
/// with two thresholds (the Canny detector). 1 on edges. `[H, W]`
#[must_use]
pub fn image_edges(rgb: &[u8], width: u32, height: u32, options: &EdgeOptions) -> Vec<u8> {
    let (w, h) = (width as usize, height as usize);
    let grey: Vec<f32> = rgb
        .chunks_exact(3)
        .map(|p| 0.299 * f32::from(p[0]) + 0.587 * f32::from(p[1]) + 0.114 * f32::from(p[2]))
        .collect();
    let smooth = smoothed(&grey, w, h, options.sigma_px);
    let at = |column: usize, row: usize| smooth[row * w + column];
    let mut gradient = vec![[0.0f32; 2]; w * h];
    for row in 1..h.saturating_sub(1) {
        for column in 1..w.saturating_sub(1) {
            let dx = (at(column + 1, row) - at(column - 1, row)) * 0.5;
            let dy = (at(column, row + 1) - at(column, row - 1)) * 0.5;
            gradient[row * w + column] = [dx, dy];
        }
    }
    let strength: Vec<f32> = gradient.iter().map(|[dx, dy]| libm::hypotf(*dx, *dy)).collect();
    let mut edges = vec![0u8; w * h];
    let mut open = Vec::new();
    for row in 1..h.saturating_sub(1) {
        for column in 1..w.saturating_sub(1) {
            let pixel = row * w + column;
            if strength[pixel] >= options.high && is_ridge(&strength, &gradient, w, pixel) {
                edges[pixel] = 1;
                open.push(pixel);
            }
        }
    }
    // Weaker maxima join when they touch an edge.
    while let Some(pixel) = open.pop() {
        for row in pixel / w - 1..=pixel / w + 1 {
            for column in pixel % w - 1..=pixel % w + 1 {
                let inner = row > 0 && row + 1 < h && column > 0 && column + 1 < w;
                let next = row * w + column;
                if inner && edges[next] == 0 && strength[next] >= options.low && is_ridge(&strength, &gradient, w, next)
                {
                    edges[next] = 1;
                    open.push(next);
                }
            }
        }
    }
    edges
}

/// True when the gradient is a maximum along its own direction, rounded to the eight neighbours.
fn is_ridge(strength: &[f32], gradient: &[[f32; 2]], width: usize, pixel: usize) -> bool {
    let [dx, dy] = gradient[pixel];
    // tan(22.5 degrees) separates the eight directions.
    let step = if dy.abs() <= 0.414_213_56 * dx.abs() {
        1
    } else if dx.abs() <= 0.414_213_56 * dy.abs() {
        width
    } else if (dx > 0.0) == (dy > 0.0) {
        width + 1
    } else {
        width - 1
    };
    strength[pixel] > 0.0 && strength[pixel] >= strength[pixel - step] && strength[pixel] > strength[pixel + step]
}

fn smoothed(grey: &[f32], width: usize, height: usize, sigma: f32) -> Vec<f32> {
    let radius = (3.0 * sigma).ceil() as i64;
    let weights: Vec<f32> = (-radius..=radius)
        .map(|k| libm::expf(-0.5 * (k * k) as f32 / (sigma * sigma).max(1e-6)))
        .collect();
    let total: f32 = weights.iter().sum();
    let along = |input: &[f32], count: usize, stride: usize, start: usize, output: &mut [f32]| {
        for i in 0..count as i64 {
            let clamped = |k: i64| (i + k).clamp(0, count as i64 - 1) as usize;
            let sum: f32 = (-radius..=radius)
                .zip(&weights)
                .map(|(k, weight)| weight * input[start + clamped(k) * stride])
                .sum();
            output[start + i as usize * stride] = sum / total;
        }
    };
    let mut rows = vec![0.0; grey.len()];
    for row in 0..height {
        along(grey, width, 1, row * width, &mut rows);
    }
    let mut both = vec![0.0; grey.len()];
    for column in 0..width {
        along(&rows, height, width, column, &mut both);
    }
    both
}

/// Share of the outline pixels, moved by `shift` pixels, that have an edge pixel within `radius` pixels (Euclidean).
/// Pixels that leave the image are not counted; `None` when none is left.
#[must_use]
pub fn share_near_edges(
    outline: &[u32],
    edges: &[u8],
    width: u32,
    height: u32,
    radius: i32,
    shift: (i32, i32),
) -> Option<f64> {
    let (w, h) = (width as i32, height as i32);
    let near = |column: i32, row: i32| {
        (-radius..=radius).any(|dy| {
            (-radius..=radius).any(|dx| {
                let (x, y) = (column + dx, row + dy);
                dx * dx + dy * dy <= radius * radius
                    && (0..w).contains(&x)
                    && (0..h).contains(&y)
                    && edges[(y * w + x) as usize] != 0
            })
        })
    };
    let (mut hits, mut count) = (0usize, 0usize);
    for &pixel in outline {
        let (column, row) = (pixel as i32 % w + shift.0, pixel as i32 / w + shift.1);
        if (0..w).contains(&column) && (0..h).contains(&row) {
            count += 1;
            hits += usize::from(near(column, row));
        }
    }
    (count > 0).then(|| hits as f64 / count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outline_of_a_square_is_its_rim() {
        let mut link = vec![NO_LINK; 8 * 8];
        for row in 2..6 {
            for column in 2..6 {
                link[row * 8 + column] = u8::from(column > 3);
            }
        }
        assert_eq!(silhouette(&link, 8, 8).len(), 12);
        assert_eq!(link_outlines(&link, 8, 8).len(), 16);
        assert!(silhouette(&[3; 64], 8, 8).is_empty());
    }

    #[test]
    fn a_step_has_one_edge_and_the_shifted_outline_misses_it() {
        let (w, h) = (32u32, 24u32);
        let value = |pixel: u32| if pixel % w < 16 { 40u8 } else { 200 };
        let rgb: Vec<u8> = (0..w * h).flat_map(|pixel| [value(pixel); 3]).collect();
        let edges = image_edges(&rgb, w, h, &EdgeOptions::default());
        let found: Vec<u32> = (0..w * h).filter(|&pixel| edges[pixel as usize] != 0).collect();
        assert!(
            found.len() as u32 >= h - 2 && found.iter().all(|pixel| [15, 16].contains(&(pixel % w))),
            "{found:?}"
        );
        let link: Vec<u8> = (0..w * h)
            .map(|pixel| if pixel % w < 16 { NO_LINK } else { 0 })
            .collect();
        let outline = silhouette(&link, w, h);
        assert_eq!(share_near_edges(&outline, &edges, w, h, 2, (0, 0)), Some(1.0));
        assert_eq!(share_near_edges(&outline, &edges, w, h, 2, (6, 0)), Some(0.0));
        assert_eq!(share_near_edges(&[], &edges, w, h, 2, (0, 0)), None);
    }

    #[test]
    fn a_flat_picture_has_no_edges() {
        assert!(
            image_edges(&[90; 3 * 20 * 20], 20, 20, &EdgeOptions::default())
                .iter()
                .all(|&edge| edge == 0)
        );
    }
}
