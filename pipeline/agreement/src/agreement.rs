//! One view summed up (`docs/spec/agreement.md` sections 4 and 6).

use std::fmt;

use glam::DVec2;
use rogs_schemas::records::robot::NO_LINK;

use crate::Result;
use crate::measure::{EdgeSample, Settings, measure};
use crate::shift::{ImageShift, common_shift};
use crate::view::View;

/// Fewer pixels of the robot tell nothing.
pub(crate) const FEWEST_PIXELS: usize = 120;
/// Images with a smaller standard deviation of brightness are blank, grey values.
pub(crate) const BLANK: f64 = 2.0;

/// Whether the drawn robot lies on that of the image.
#[derive(Debug, Clone, PartialEq)]
pub enum Agreement {
    /// It can be told, and by how much it is off.
    Measured(Agreeing),
    /// It cannot.
    CannotTell {
        /// The reason.
        why: Why,
    },
}

/// Why nothing can be said of a view.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Why {
    /// The camera should see no robot, or hardly any.
    HardlyVisible,
    /// The image is of one brightness.
    BlankImage,
    /// Edges near the drawn contours are too few, or all run in one direction.
    TooFewEdges,
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::HardlyVisible => "the robot is hardly in view",
            Self::BlankImage => "the image is blank",
            Self::TooFewEdges => "too few edges stand out near the drawn robot",
        })
    }
}

/// How far the robot of the image is off the drawn one.
#[derive(Debug, Clone, PartialEq)]
pub struct Agreeing {
    /// Where the image's robot lies as seen from the drawn one.
    pub shift: ImageShift,
    /// Length of the shift, pixels, with its standard deviation.
    pub offset_px: [f64; 2],
    /// The same at the robot's depth, across the line of sight, millimetres.
    pub offset_mm: [f64; 2],
    /// Median camera z of the contour points, metres.
    pub depth_m: f64,
    /// Share of the silhouette that has its edge at the predicted place, beyond chance: 1 all of it.
    pub overlay: f64,
    /// How well colours tell the drawn robot from its surroundings, 0 to 1.
    pub separation: Option<f64>,
    /// Against measured depth, where there is any on the robot.
    pub depth: Option<DepthAgreement>,
    /// The edges found.
    pub samples: Vec<EdgeSample>,
}

/// Measured depth against that of the mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthAgreement {
    /// Median of measured less mesh depth, metres.
    pub offset_m: f64,
    /// Robust standard deviation around it, metres.
    pub spread_m: f64,
    /// Pixels compared.
    pub pixels: usize,
}

/// Measures a view.
///
/// # Errors
/// When arrays and camera of the view do not fit together.
pub fn agreement(view: &View<'_>, settings: &Settings) -> Result<Agreement> {
    let measured = measure(view, settings)?;
    let cannot = |why| Ok(Agreement::CannotTell { why });
    if measured.robot_pixels < FEWEST_PIXELS || measured.contour_points < 24 {
        return cannot(Why::HardlyVisible);
    }
    if measured.contrast < BLANK {
        return cannot(Why::BlankImage);
    }
    let shift = common_shift(&measured.samples, settings.range_px);
    let (Some(shift), Some(overlay)) = (shift, measured.overlay(settings)) else {
        return cannot(Why::TooFewEdges);
    };
    let mut depths: Vec<f64> = measured.samples.iter().map(|sample| sample.depth_m).collect();
    let depth_m = median(&mut depths);
    let focal = 0.5 * (view.camera.lens.intrinsics.fx + view.camera.lens.intrinsics.fy);
    let offset_px = [shift.px.length(), shift.sigma_px()];
    Ok(Agreement::Measured(Agreeing {
        offset_px,
        offset_mm: offset_px.map(|px| px / focal * depth_m * 1000.0),
        shift,
        depth_m,
        overlay,
        separation: measured.separation,
        depth: depth_agreement(view),
        samples: measured.samples,
    }))
}

impl Agreeing {
    /// The shift as a vector, pixels.
    #[must_use]
    pub fn shift_px(&self) -> DVec2 {
        self.shift.px
    }
}

fn depth_agreement(view: &View<'_>) -> Option<DepthAgreement> {
    let sensor = view.sensor_depth_m?;
    let pairs = sensor.iter().zip(view.surface.depth_m).zip(view.surface.link);
    let mut off: Vec<f64> = pairs
        .filter(|((sensor, _), link)| **link != NO_LINK && sensor.is_finite() && **sensor > 0.0)
        .map(|((sensor, mesh), _)| f64::from(sensor - mesh))
        .collect();
    let pixels = off.len();
    if pixels < FEWEST_PIXELS {
        return None;
    }
    let offset_m = median(&mut off);
    off.iter_mut().for_each(|value| *value = (*value - offset_m).abs());
    Some(DepthAgreement {
        offset_m,
        spread_m: 1.4826 * median(&mut off),
        pixels,
    })
}

/// The upper median; 0 of nothing.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    let (_, &mut median, _) = values.select_nth_unstable_by(middle, f64::total_cmp);
    median
}
