//! Edges of the image along the normals of the drawn contours (`docs/spec/agreement.md` sections 2 and 3).

use glam::{DVec2, DVec3};

use crate::Result;
use crate::colour::ColourModel;
use crate::contour::{ContourKind, ContourPoint, contours};
use crate::view::View;

/// Pixels to each side of a place that the colour term adds up.
const SIDE_PX: f64 = 6.0;
/// Weight of the colour term in the logarithm of the likelihood.
const COLOUR_WEIGHT: f64 = 2.0;
/// Weight of the edge term.
const EDGE_WEIGHT: f64 = 2.0;
/// Steps of colour below this are noise, share of full brightness.
const NOISE: f64 = 0.03;
/// A peak of the likelihood reaches this far, pixels.
const PEAK_PX: f64 = 2.5;
/// Least standard deviation of a place: contours of a map sampled at pixel centres are not better, pixels.
const FLOOR_PX: f64 = 0.35;
/// Half the width of the band around the predicted place that [`EdgeSample::here`] counts, pixels.
const HERE_PX: f64 = 1.5;

/// How edges are searched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    /// How far from the drawn contour, pixels to each side.
    pub range_px: f64,
    /// Distance of the places tried, pixels.
    pub step_px: f64,
    /// Most contour points that are searched; evenly chosen among all.
    pub most_samples: usize,
    /// How far from the robot colours count as its surroundings, pixels.
    pub ring_px: usize,
    /// Whether edges inside the silhouette are searched too.
    pub inner: bool,
}

impl Settings {
    /// A search over `range_px` pixels to each side: e.g. 40 for a first look, 12 to judge, 4 to refine.
    #[must_use]
    pub fn of_range(range_px: f64) -> Self {
        Self {
            range_px,
            step_px: if range_px > 16.0 { 1.0 } else { 0.5 },
            most_samples: 400,
            ring_px: (range_px as usize).clamp(8, 32),
            inner: true,
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self::of_range(12.0)
    }
}

/// A contour point and where the image has its edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeSample {
    /// Predicted contour point, pixels.
    pub pixel: DVec2,
    /// Unit normal of the contour in the image, outward.
    pub normal: DVec2,
    /// The surface point in the base frame, metres.
    pub base_point: DVec3,
    /// The same in the frame of its link, metres.
    pub link_point: DVec3,
    /// Its link.
    pub link: u8,
    /// Its camera z, metres.
    pub depth_m: f64,
    /// What the contour separates.
    pub kind: ContourKind,
    /// Signed distance along the normal at which the image's own edge lies, pixels.
    pub offset_px: f64,
    /// Standard deviation of the offset, given that this edge is the right one, pixels.
    pub sigma_px: f64,
    /// Confidence that the edge stands out among all in reach: 0 not at all, 1 alone.
    pub weight: f64,
    /// Share of the likelihood within 1.5 pixels of the predicted place: 1 when the image has its edge exactly there.
    pub here: f64,
}

/// What the search found in a view.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Measurement {
    /// One a contour point searched whose normal stays inside the image.
    pub samples: Vec<EdgeSample>,
    /// Contour points before some were chosen.
    pub contour_points: usize,
    /// Pixels of the drawn robot.
    pub robot_pixels: usize,
    /// How well colours tell the drawn robot and its surroundings apart, 0 to 1; `None` when one of them is too small.
    pub separation: Option<f64>,
    /// Standard deviation of the image's brightness, grey values.
    pub contrast: f64,
}

impl Measurement {
    /// Mean of [`EdgeSample::here`] over the silhouette less what a flat likelihood gives, as a share of what is
    /// possible: about 0 by chance, 1 for a perfect overlay. `None` without samples.
    #[must_use]
    pub fn overlay(&self, settings: &Settings) -> Option<f64> {
        let outline = self
            .samples
            .iter()
            .filter(|sample| sample.kind == ContourKind::Silhouette);
        let (sum, count) = outline.fold((0.0, 0.0), |(sum, count), sample| (sum + sample.here, count + 1.0));
        let chance = (HERE_PX / settings.range_px).min(1.0);
        (count > 0.0 && chance < 1.0).then(|| (sum / count - chance) / (1.0 - chance))
    }
}

/// Searches the edges of a view. An empty result means that no contour is drawn.
///
/// # Errors
/// When arrays and camera of the view do not fit together.
pub fn measure(view: &View<'_>, settings: &Settings) -> Result<Measurement> {
    view.check()?;
    let (width, height) = view.size();
    let all = contours(&view.surface, width, height);
    let chosen: Vec<&ContourPoint> = all
        .iter()
        .filter(|point| settings.inner || point.kind == ContourKind::Silhouette)
        .collect();
    let colours = ColourModel::new(view.rgb, view.surface.link, width, height, settings.ring_px);
    let image = Image {
        rgb: view.rgb,
        width,
        height,
    };
    let mut search = Search::new(&image, colours.as_ref(), settings);
    let count = chosen.len().min(settings.most_samples);
    let samples = (0..count)
        .filter_map(|number| search.sample(view, chosen[number * chosen.len() / count]))
        .collect();
    Ok(Measurement {
        samples,
        contour_points: all.len(),
        robot_pixels: view
            .surface
            .link
            .iter()
            .filter(|&&link| link != rogs_schemas::records::robot::NO_LINK)
            .count(),
        separation: colours.map(|colours| colours.separation),
        contrast: image.contrast(),
    })
}

struct Image<'a> {
    rgb: &'a [u8],
    width: usize,
    height: usize,
}

impl Image<'_> {
    /// Bilinear colour at an image point, grey values; `None` outside of the outermost pixel centres.
    fn at(&self, point: DVec2) -> Option<[f32; 3]> {
        let (x, y) = (point.x - 0.5, point.y - 0.5);
        if !(x >= 0.0 && y >= 0.0 && x <= (self.width - 1) as f64 && y <= (self.height - 1) as f64) {
            return None;
        }
        let (column, row) = (
            (x as usize).min(self.width.max(2) - 2),
            (y as usize).min(self.height.max(2) - 2),
        );
        let (fx, fy) = ((x - column as f64) as f32, (y - row as f64) as f32);
        let texel = |column: usize, row: usize, channel: usize| {
            let (column, row) = (column.min(self.width - 1), row.min(self.height - 1));
            f32::from(self.rgb[3 * (row * self.width + column) + channel])
        };
        Some(std::array::from_fn(|channel| {
            let top = texel(column, row, channel) * (1.0 - fx) + texel(column + 1, row, channel) * fx;
            let bottom = texel(column, row + 1, channel) * (1.0 - fx) + texel(column + 1, row + 1, channel) * fx;
            top * (1.0 - fy) + bottom * fy
        }))
    }

    fn contrast(&self) -> f64 {
        let grey = self
            .rgb
            .chunks_exact(3)
            .map(|p| p.iter().map(|&c| f64::from(c)).sum::<f64>() / 3.0);
        let (sum, squares) = grey.fold((0.0, 0.0), |(sum, squares), g| (sum + g, squares + g * g));
        let count = (self.width * self.height) as f64;
        let mean = sum / count;
        f64::sqrt((squares / count - mean * mean).max(0.0))
    }
}

/// One search after another, with the buffers in between.
struct Search<'a> {
    image: &'a Image<'a>,
    colours: Option<&'a ColourModel>,
    settings: &'a Settings,
    /// Places tried on each side.
    reach: usize,
    /// Places of `SIDE_PX`.
    side: usize,
    // Sums over the colours and over their ratios from the first place of the profile to each.
    colour_sums: Vec<[f64; 3]>,
    ratio_sums: Vec<f64>,
    likelihood: Vec<f64>,
}

impl<'a> Search<'a> {
    fn new(image: &'a Image<'a>, colours: Option<&'a ColourModel>, settings: &'a Settings) -> Self {
        let step = settings.step_px;
        Self {
            image,
            colours,
            settings,
            reach: (settings.range_px / step).round().max(1.0) as usize,
            side: (SIDE_PX / step).round().max(1.0) as usize,
            colour_sums: Vec::new(),
            ratio_sums: Vec::new(),
            likelihood: Vec::new(),
        }
    }

    fn sample(&mut self, view: &View<'_>, point: &ContourPoint) -> Option<EdgeSample> {
        self.read(point)?;
        self.rate(point.kind);
        let found = self.peak();
        let depth_m = f64::from(view.surface.depth_m[point.index]);
        let link = view.surface.link[point.index];
        let base_point = view
            .camera
            .world_from_camera
            .point(view.camera.lens.unproject(point.pixel, depth_m));
        let link_point = view.base_from_link[usize::from(link)].inverse().point(base_point);
        Some(EdgeSample {
            pixel: point.pixel,
            normal: point.normal,
            base_point,
            link_point,
            link,
            depth_m,
            kind: point.kind,
            offset_px: found.offset_px,
            sigma_px: found.sigma_px,
            weight: found.weight,
            here: found.here,
        })
    }

    /// Reads the colours along the normal. Where the profile leaves the image, the last colour inside goes on; `None`
    /// when the middle of it does.
    fn read(&mut self, point: &ContourPoint) -> Option<()> {
        let half = self.reach + self.side;
        let step = self.settings.step_px;
        let at = |place: usize| {
            let t = (place as f64 - half as f64) * step;
            self.image.at(point.pixel + point.normal * t)
        };
        at(half)?;
        let inside = |place: usize| at(place).is_some();
        let first = (0..half)
            .rev()
            .take_while(|&place| inside(place))
            .last()
            .unwrap_or(half);
        let last = (half + 1..=2 * half)
            .take_while(|&place| inside(place))
            .last()
            .unwrap_or(half);
        if half - first < self.side || last - half < self.side {
            return None;
        }
        let (mut colour_sum, mut ratio_sum) = ([0.0; 3], 0.0);
        self.colour_sums.clear();
        self.ratio_sums.clear();
        self.colour_sums.push(colour_sum);
        self.ratio_sums.push(ratio_sum);
        for place in 0..=2 * half {
            let colour = at(place.clamp(first, last))?;
            for channel in 0..3 {
                colour_sum[channel] += f64::from(colour[channel]);
            }
            // Beyond the image nothing is known.
            let known = (first..=last).contains(&place);
            ratio_sum += self
                .colours
                .filter(|_| known)
                .map_or(0.0, |colours| f64::from(colours.ratio(colour)));
            self.colour_sums.push(colour_sum);
            self.ratio_sums.push(ratio_sum);
        }
        Some(())
    }

    /// Likelihood of an edge at every place in reach, summing to 1.
    fn rate(&mut self, kind: ContourKind) {
        let step = self.settings.step_px;
        // Colours right beside an edge are mixed: the step is measured between the means of 2 pixels on either side.
        let near = (2.0 / step).round() as usize;
        let colour_weight = if kind == ContourKind::Silhouette {
            COLOUR_WEIGHT
        } else {
            0.0
        };
        self.likelihood.clear();
        let mut most = f64::NEG_INFINITY;
        for place in self.side..=self.side + 2 * self.reach {
            let sum = |sums: &[[f64; 3]], from: usize, to: usize| -> [f64; 3] {
                std::array::from_fn(|channel| sums[to][channel] - sums[from][channel])
            };
            let inner = sum(&self.colour_sums, place - near, place);
            let outer = sum(&self.colour_sums, place + 1, place + 1 + near);
            let difference: f64 = (0..3).map(|c| (inner[c] - outer[c]) * (inner[c] - outer[c])).sum();
            let edge = f64::sqrt(difference / 3.0) / (near as f64 * 255.0);
            let ratios = &self.ratio_sums;
            let agreement =
                (ratios[place] - ratios[place - self.side]) - (ratios[place + 1 + self.side] - ratios[place + 1]);
            let value = EDGE_WEIGHT * f64::ln(edge + NOISE) + colour_weight * agreement / (2.0 * self.side as f64);
            most = most.max(value);
            self.likelihood.push(value);
        }
        let mut total = 0.0;
        for value in &mut self.likelihood {
            *value = libm::exp(*value - most);
            total += *value;
        }
        self.likelihood.iter_mut().for_each(|value| *value /= total);
    }

    fn peak(&self) -> Found {
        let step = self.settings.step_px;
        let t = |place: usize| (place as f64 - self.reach as f64) * step;
        let count = self.likelihood.len();
        // A wide search takes the nearer of two equal edges.
        let prior = |place: usize| {
            let away = t(place) / self.settings.range_px;
            1.0 - 0.5 * away * away
        };
        let rated = |place: usize| self.likelihood[place] * prior(place);
        let best = (0..count)
            .max_by(|&a, &b| rated(a).total_cmp(&rated(b)).then(b.cmp(&a)))
            .unwrap_or(self.reach);
        let peak = (PEAK_PX / step) as usize;
        let around = best.saturating_sub(peak)..(best + peak + 1).min(count);
        let width = around.len() as f64 / count as f64;
        let mass: f64 = around.clone().map(|place| self.likelihood[place]).sum();
        let mean = around
            .clone()
            .map(|place| self.likelihood[place] * t(place))
            .sum::<f64>()
            / mass;
        let spread = |place: usize| self.likelihood[place] * (t(place) - mean) * (t(place) - mean);
        let variance = around.map(spread).sum::<f64>() / mass;
        let band = (HERE_PX / step) as usize;
        let here = (self.reach.saturating_sub(band)..(self.reach + band + 1).min(count))
            .map(|p| self.likelihood[p])
            .sum();
        // A peak at the end of the search is the flank of an edge beyond it.
        let at_end = best == 0 || best + 1 == count;
        Found {
            offset_px: mean,
            sigma_px: f64::sqrt(variance + FLOOR_PX * FLOOR_PX),
            weight: if at_end {
                0.0
            } else {
                ((mass - width) / (1.0 - width)).clamp(0.0, 1.0)
            },
            here,
        }
    }
}

struct Found {
    offset_px: f64,
    sigma_px: f64,
    weight: f64,
    here: f64,
}
