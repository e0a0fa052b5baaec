//! Cameras as they are rendered from and the settings of a render.

use rogs_geometry::{Frame, Pinhole, PosedCamera};
use rogs_schemas::Intrinsics;
use rogs_schemas::units::LengthUnit;
use serde::{Deserialize, Serialize};

use crate::error::{Result, SplatError};
use crate::simd::SimdLevel;

/// Largest image side, pixels.
pub const MAX_SIDE: u32 = 1 << 14;

/// A pinhole camera as the rasteriser takes it, in the frame and unit of the Gaussians; [`RasterCamera::new`] makes it of a
/// camera in metres. Axes are those of OpenCV (x right, y down, z forward); pixel `(column, row)` has its centre at
/// `(column + 0.5, row + 0.5)`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RasterCamera {
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Focal length along x, pixels.
    pub fx: f64,
    /// Focal length along y, pixels.
    pub fy: f64,
    /// Principal point x, pixels.
    pub cx: f64,
    /// Principal point y, pixels.
    pub cy: f64,
    /// Rotation R of `p_camera = R p_world + t`, row-major.
    pub rotation: [f64; 9],
    /// Translation t of `p_camera = R p_world + t`, in the unit of the Gaussians.
    pub translation: [f64; 3],
}

impl RasterCamera {
    /// The form of a camera in which it renders Gaussians of a unit.
    #[must_use]
    pub fn new<W: Frame>(camera: &PosedCamera<W>, unit: LengthUnit) -> Self {
        let Pinhole {
            intrinsics: Intrinsics { fx, fy, cx, cy },
            width,
            height,
        } = camera.lens;
        let camera_from_world = camera.world_from_camera.inverse().in_unit(unit).to_rigid();
        Self {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            rotation: camera_from_world.rotation,
            translation: camera_from_world.translation,
        }
    }

    /// Number of pixels.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// Checks that an image can be rendered.
    ///
    /// # Errors
    /// On empty or huge images and on numbers that are not finite.
    pub fn validate(&self) -> Result<()> {
        let sides = 1..=MAX_SIDE;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            return Err(SplatError::Setting {
                what: "image sides are 1 to 16384 pixels",
                value: format!("{} x {}", self.width, self.height),
            });
        }
        if !(self.fx > 0.0 && self.fy > 0.0 && self.fx < 1e9 && self.fy < 1e9) {
            return Err(SplatError::Setting {
                what: "focal lengths are positive pixel counts",
                value: format!("fx {} fy {}", self.fx, self.fy),
            });
        }
        let numbers = [self.cx, self.cy]
            .into_iter()
            .chain(self.rotation)
            .chain(self.translation);
        if let Some(bad) = numbers.into_iter().find(|v| !v.is_finite() || v.abs() > 1e30) {
            return Err(SplatError::Setting {
                what: "camera pose and principal point must be finite",
                value: bad.to_string(),
            });
        }
        Ok(())
    }
}

/// How the low-pass filter of the projection acts on opacity.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// The opacity is used as it is; Stage 1 and Stage 2.
    #[default]
    Classic,
    /// The opacity is scaled by the square root of the ratio of the determinants before and after the low-pass.
    Antialiased,
}

/// Settings of a render (`docs/spec/rasteriser.md` section 1).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RasterConfig {
    /// Classic or antialiased.
    pub mode: Mode,
    /// Variance added to the projected covariance, square pixels.
    pub eps2d: f32,
    /// Ceiling of the alpha of one Gaussian at one pixel.
    pub alpha_max: f32,
    /// Gaussians nearer than this (camera z of the centre) are dropped, in the unit of the Gaussians.
    pub near: f32,
    /// Gaussians farther than this are dropped.
    pub far: f32,
    /// Colour behind everything.
    pub background: [f32; 3],
    /// Gaussians of at most this opacity are dropped before rendering.
    pub min_opacity: f32,
    /// Floor of the antialiasing factor.
    pub min_compensation: f32,
    /// Side of the square tiles: 4, 8 or 16 pixels. It never changes the image.
    pub tile_size: u32,
    /// Which vector instructions to use. It never changes the image.
    pub simd: SimdLevel,
}

/// Alpha below which a Gaussian does not touch a pixel.
pub const ALPHA_CUT: f32 = 1.0 / 255.0;
/// Transmittance at which a pixel is finished.
pub const STOP: f32 = 1e-4;
/// Floor under the accumulated opacity in the division of normalised outputs.
pub const ALPHA_FLOOR: f32 = 1e-10;

impl Default for RasterConfig {
    /// The rendering of Stage 1 and Stage 2: classic, internal units.
    fn default() -> Self {
        Self {
            mode: Mode::Classic,
            eps2d: 0.3,
            alpha_max: 0.999,
            near: 0.001,
            far: 100.0,
            background: [0.0; 3],
            min_opacity: 0.001,
            min_compensation: 0.0,
            tile_size: 16,
            simd: SimdLevel::Auto,
        }
    }
}

impl RasterConfig {
    /// Checks the settings.
    ///
    /// # Errors
    /// Names the setting that makes no sense.
    pub fn validate(&self) -> Result<()> {
        let wrong = |what, value: String| Err(SplatError::Setting { what, value });
        if !(self.eps2d >= 0.0 && self.eps2d.is_finite()) {
            return wrong("eps2d must be finite and not negative", self.eps2d.to_string());
        }
        if !(self.alpha_max > ALPHA_CUT && self.alpha_max <= 0.9999) {
            return wrong(
                "alpha_max must lie between 1/255 and 0.9999",
                self.alpha_max.to_string(),
            );
        }
        if !(self.near > 0.0 && self.far > self.near) {
            return wrong(
                "near must be positive and far greater than near",
                format!("{} .. {}", self.near, self.far),
            );
        }
        if self.background.iter().any(|b| !b.is_finite()) {
            return wrong("the background must be finite", format!("{:?}", self.background));
        }
        if !(self.min_opacity >= 0.0 && self.min_opacity <= 1.0) {
            return wrong("min_opacity must lie in 0..1", self.min_opacity.to_string());
        }
        if !(self.min_compensation >= 0.0 && self.min_compensation <= 1.0) {
            return wrong("min_compensation must lie in 0..1", self.min_compensation.to_string());
        }
        if ![4, 8, 16].contains(&self.tile_size) {
            return wrong("tile_size must be 4, 8 or 16", self.tile_size.to_string());
        }
        Ok(())
    }
}

/// A camera in f32 with what the projection needs of it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) fx: f32,
    pub(crate) fy: f32,
    pub(crate) cx: f32,
    pub(crate) cy: f32,
    pub(crate) r: [f32; 9],
    pub(crate) t: [f32; 3],
    /// Limits of x/z and y/z inside the Jacobian: low x, high x, low y, high y.
    pub(crate) limits: [f32; 4],
    /// Camera centre in the world.
    pub(crate) centre: [f32; 3],
}

impl View {
    pub(crate) fn new(camera: &RasterCamera) -> Self {
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let RasterCamera {
            fx,
            fy,
            cx,
            cy,
            rotation: r,
            translation: t,
            ..
        } = *camera;
        let limits = [
            -(cx / fx + 0.15 * w / fx),
            (w - cx) / fx + 0.15 * w / fx,
            -(cy / fy + 0.15 * h / fy),
            (h - cy) / fy + 0.15 * h / fy,
        ];
        let column = |k: usize| -(r[k] * t[0] + r[3 + k] * t[1] + r[6 + k] * t[2]);
        Self {
            width: camera.width as usize,
            height: camera.height as usize,
            fx: fx as f32,
            fy: fy as f32,
            cx: cx as f32,
            cy: cy as f32,
            r: r.map(|v| v as f32),
            t: t.map(|v| v as f32),
            limits: limits.map(|v| v as f32),
            centre: [column(0) as f32, column(1) as f32, column(2) as f32],
        }
    }
}
