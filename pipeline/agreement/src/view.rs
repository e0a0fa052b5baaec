//! What is compared: an image and the robot as it should look in it.

use rogs_geometry::{Base, Link, Pose, PosedCamera};
use rogs_robot::MeshImage;
use rogs_schemas::records::robot::{NO_LINK, RobotMap};

use crate::{Error, Result};

/// The robot's surface as a camera should see it.
#[derive(Debug, Clone, Copy)]
pub struct Surface<'a> {
    /// Camera-z depth at the pixel centre, metres; 0 where nothing is hit. `[H, W]`
    pub depth_m: &'a [f32],
    /// Link id, [`NO_LINK`] where nothing is hit. `[H, W]`
    pub link: &'a [u8],
}

impl<'a> From<&'a MeshImage> for Surface<'a> {
    fn from(image: &'a MeshImage) -> Self {
        Self {
            depth_m: &image.depth_m,
            link: &image.link,
        }
    }
}

impl<'a> From<&'a RobotMap> for Surface<'a> {
    fn from(map: &'a RobotMap) -> Self {
        Self {
            depth_m: &map.depth_m,
            link: &map.link,
        }
    }
}

/// An image, its camera, and the robot in it at one time.
#[derive(Debug, Clone, Copy)]
pub struct View<'a> {
    /// RGB, 8 bit. `[H, W, 3]`
    pub rgb: &'a [u8],
    /// The camera as the calibration says it is.
    pub camera: PosedCamera<Base>,
    /// The robot as this camera should see it.
    pub surface: Surface<'a>,
    /// Link-to-base poses with which the surface was drawn, by link id.
    pub base_from_link: &'a [Pose<Base, Link>],
    /// Depth by a sensor or by stereo: camera z, metres, NaN or 0 where unknown. `[H, W]`
    pub sensor_depth_m: Option<&'a [f32]>,
}

impl View<'_> {
    /// Width and height, pixels.
    #[must_use]
    pub fn size(&self) -> (usize, usize) {
        (self.camera.lens.width as usize, self.camera.lens.height as usize)
    }

    /// Whether arrays, camera and poses fit together.
    ///
    /// # Errors
    /// What does not fit, with both sizes.
    pub fn check(&self) -> Result<()> {
        let (width, height) = self.size();
        let area = width * height;
        let wrong = |what: String| Err(Error { what });
        if !self.camera.lens.is_valid() {
            return wrong(format!("the camera {:?} is not valid", self.camera.lens));
        }
        let depth = self.sensor_depth_m.map_or(area, <[f32]>::len);
        let lengths = [
            ("rgb", self.rgb.len(), 3 * area),
            ("mesh depth", self.surface.depth_m.len(), area),
            ("link ids", self.surface.link.len(), area),
            ("sensor depth", depth, area),
        ];
        for (name, found, expected) in lengths {
            if found != expected {
                return wrong(format!(
                    "{found} values of {name} for {width}x{height} pixels: expected {expected}"
                ));
            }
        }
        let links = self.base_from_link.len();
        match self
            .surface
            .link
            .iter()
            .find(|link| **link != NO_LINK && usize::from(**link) >= links)
        {
            Some(link) => wrong(format!("link {link} is drawn, but only {links} links have a pose")),
            None => Ok(()),
        }
    }
}
