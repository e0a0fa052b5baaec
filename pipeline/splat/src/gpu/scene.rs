//! A scene in the device's memory.

use crate::camera::{RasterConfig, View};
use crate::error::{Result, SplatError};
use crate::gaussians::{Colour, Gaussians};

use super::device::{Buffer, GpuDevice, cube, grid};
use super::kernels::{SHAPE, VIEW, WIDE, project};

/// Most Gaussians of a scene: the projection has a row of at most 65535 cubes.
const MOST_GAUSSIANS: usize = 65_535 * WIDE;

/// Gaussians in the memory of a device, for any number of renders.
#[derive(Clone)]
pub struct GpuScene {
    pub(crate) device: GpuDevice,
    pub(crate) count: usize,
    pub(crate) extra_channels: usize,
    /// Degree of the harmonics, `project::PLAIN` for plain colours.
    pub(crate) degree: u32,
    pub(crate) colour_words: usize,
    /// Mean, quaternion, scales, opacity. `[N, SHAPE]`
    pub(crate) shapes: Buffer,
    pub(crate) colours: Buffer,
    pub(crate) extra: Buffer,
}

impl GpuScene {
    /// Copies a scene to a device.
    ///
    /// # Errors
    /// When its arrays contradict each other or are too large for the device.
    pub fn upload(device: &GpuDevice, gaussians: &Gaussians) -> Result<Self> {
        gaussians.validate()?;
        let count = gaussians.len();
        if count > MOST_GAUSSIANS {
            return Err(SplatError::gpu(format!(
                "a scene has at most {MOST_GAUSSIANS} Gaussians there, not {count}"
            )));
        }
        device.check_words("the Gaussians", SHAPE * count)?;
        device.check_words("the colours", gaussians.colour.values().len())?;
        device.check_words("the extra channels", gaussians.extra.len())?;
        let scene = Self {
            device: device.clone(),
            count,
            extra_channels: gaussians.extra_channels,
            degree: match gaussians.colour {
                Colour::Rgb(_) => project::PLAIN,
                Colour::Sh { degree, .. } => degree as u32,
            },
            colour_words: gaussians.colour.values().len(),
            shapes: device.empty(SHAPE * count),
            colours: device.upload(gaussians.colour.values()),
            extra: device.upload(&gaussians.extra),
        };
        scene.place(&gaussians.means, 3, 0);
        scene.place(&gaussians.quats, 4, 3);
        scene.place(&gaussians.scales, 3, 7);
        scene.place(&gaussians.opacities, 1, 10);
        Ok(scene)
    }

    /// Replaces the centres, for another time of a moving scene. `[N, 3]`
    ///
    /// # Errors
    /// When there is another number of them.
    pub fn set_means(&mut self, means: &[f32]) -> Result<()> {
        SplatError::check("means", means.len(), 3 * self.count, "3 per Gaussian")?;
        // Tapes of earlier renders keep the old ones.
        let shapes = self.device.empty(SHAPE * self.count);
        project::copy::launch(
            &self.device.client,
            grid(shapes.len.div_ceil(WIDE)),
            cube(WIDE),
            self.shapes.arg(),
            shapes.arg(),
            shapes.len as u32,
        );
        self.shapes = shapes;
        self.place(means, 3, 0);
        Ok(())
    }

    /// Number of Gaussians.
    #[must_use]
    pub fn len(&self) -> usize {
        self.count
    }

    /// True when there is no Gaussian.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The device that holds it.
    #[must_use]
    pub fn device(&self) -> &GpuDevice {
        &self.device
    }

    fn place(&self, values: &[f32], width: u32, column: u32) {
        if self.count == 0 {
            return;
        }
        let values = self.device.upload(values);
        project::place::launch(
            &self.device.client,
            grid(self.count.div_ceil(WIDE)),
            cube(WIDE),
            values.arg(),
            self.shapes.arg(),
            self.count as u32,
            width,
            column,
        );
    }
}

/// A view and the settings as the kernels read them.
pub(crate) fn view_words(view: &View, config: &RasterConfig) -> [f32; VIEW] {
    let mut words = [0.0; VIEW];
    words[..6].copy_from_slice(&[
        view.fx,
        view.fy,
        view.cx,
        view.cy,
        view.width as f32,
        view.height as f32,
    ]);
    words[6..15].copy_from_slice(&view.r);
    words[15..18].copy_from_slice(&view.t);
    words[18..22].copy_from_slice(&view.limits);
    words[22..25].copy_from_slice(&view.centre);
    words[25..].copy_from_slice(&[
        config.near,
        config.far,
        config.eps2d,
        config.min_opacity,
        config.min_compensation,
    ]);
    words
}
