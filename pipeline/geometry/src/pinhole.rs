//! Pinhole cameras. Pixel `(column, row)` has its centre at `(column + 0.5, row + 0.5)`.

use glam::{DVec2, DVec3};
use rogs_schemas::Intrinsics;
use rogs_schemas::records::clip::{Clip, ClipCamera};

/// A pinhole camera without distortion and its image size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    /// Focal lengths and principal point, pixels.
    pub intrinsics: Intrinsics,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
}

impl Pinhole {
    /// A camera of a clip, whose images all have the clip's size.
    #[must_use]
    pub fn of_clip(clip: &Clip, camera: &ClipCamera) -> Self {
        Self {
            intrinsics: camera.intrinsics,
            width: clip.width,
            height: clip.height,
        }
    }

    /// A camera whose axis goes through the middle of its images; one focal length, pixels.
    #[must_use]
    pub fn centred(focal: f64, width: u32, height: u32) -> Self {
        Self {
            intrinsics: Intrinsics {
                fx: focal,
                fy: focal,
                cx: f64::from(width) / 2.0,
                cy: f64::from(height) / 2.0,
            },
            width,
            height,
        }
    }

    /// A camera whose principal point is given for INTEGER pixel centres (ZED SDK, OpenCV): half a pixel is added.
    #[must_use]
    pub fn from_integer_centres(intrinsics: Intrinsics, width: u32, height: u32) -> Self {
        let shifted = Intrinsics {
            cx: intrinsics.cx + 0.5,
            cy: intrinsics.cy + 0.5,
            ..intrinsics
        };
        Self {
            intrinsics: shifted,
            width,
            height,
        }
    }

    /// The image point and depth of a point in the camera frame, `None` when it does not lie in front of the camera.
    #[must_use]
    pub fn project(&self, point: DVec3) -> Option<(DVec2, f64)> {
        if point.z <= 0.0 || !point.is_finite() {
            return None;
        }
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        Some((
            DVec2::new(fx * point.x / point.z + cx, fy * point.y / point.z + cy),
            point.z,
        ))
    }

    /// The point at camera-z depth `depth` (metres) seen at an image point.
    #[must_use]
    pub fn unproject(&self, image_point: DVec2, depth: f64) -> DVec3 {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        DVec3::new(
            (image_point.x - cx) / fx * depth,
            (image_point.y - cy) / fy * depth,
            depth,
        )
    }

    /// The ray through a pixel centre with unit z, so that `depth * ray` is the point at that camera-z depth.
    #[must_use]
    pub fn ray(&self, column: u32, row: u32) -> DVec3 {
        self.unproject(pixel_centre(column, row), 1.0)
    }

    /// The same camera after the image was resized (the content, not the field of view, is kept). With half-pixel
    /// centres everything scales linearly.
    #[must_use]
    pub fn resized(&self, width: u32, height: u32) -> Self {
        let (sx, sy) = (
            f64::from(width) / f64::from(self.width),
            f64::from(height) / f64::from(self.height),
        );
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        Self {
            intrinsics: Intrinsics {
                fx: fx * sx,
                fy: fy * sy,
                cx: cx * sx,
                cy: cy * sy,
            },
            width,
            height,
        }
    }

    /// The same camera after cutting out a window with its top left corner at `(left, top)`; negative values pad.
    #[must_use]
    pub fn cropped(&self, left: i32, top: i32, width: u32, height: u32) -> Self {
        let Intrinsics { cx, cy, .. } = self.intrinsics;
        let intrinsics = Intrinsics {
            cx: cx - f64::from(left),
            cy: cy - f64::from(top),
            ..self.intrinsics
        };
        Self {
            intrinsics,
            width,
            height,
        }
    }

    /// True when all numbers are finite, focal lengths positive and the image is not empty.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let Intrinsics { fx, fy, cx, cy } = self.intrinsics;
        [fx, fy, cx, cy].iter().all(|value| value.is_finite())
            && fx > 0.0
            && fy > 0.0
            && self.width > 0
            && self.height > 0
    }
}

/// The centre of a pixel in image coordinates.
#[must_use]
pub fn pixel_centre(column: u32, row: u32) -> DVec2 {
    DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole {
        intrinsics: Intrinsics {
            fx: 100.0,
            fy: 110.0,
            cx: 33.0,
            cy: 20.0,
        },
        width: 64,
        height: 40,
    };

    #[test]
    fn unproject_inverts_project() {
        let point = DVec3::new(0.1, -0.05, 0.7);
        let (pixel, depth) = CAMERA.project(point).unwrap();
        assert!((CAMERA.unproject(pixel, depth) - point).length() < 1e-15);
        assert_eq!(CAMERA.project(DVec3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(CAMERA.ray(32, 0).x, (32.5 - 33.0) / 100.0);
    }

    #[test]
    fn resizing_moves_image_points_with_the_image() {
        let point = DVec3::new(0.1, -0.05, 0.7);
        let (before, _) = CAMERA.project(point).unwrap();
        let (after, _) = CAMERA.resized(128, 60).project(point).unwrap();
        assert!((after - DVec2::new(before.x * 2.0, before.y * 1.5)).length() < 1e-12);
        let (cut, _) = CAMERA.cropped(10, -5, 20, 20).project(point).unwrap();
        assert!((cut - (before - DVec2::new(10.0, -5.0))).length() < 1e-12);
    }

    #[test]
    fn integer_centres_gain_half_a_pixel() {
        let camera = Pinhole::from_integer_centres(CAMERA.intrinsics, 64, 40);
        assert_eq!((camera.intrinsics.cx, camera.intrinsics.cy), (33.5, 20.5));
        assert!(camera.is_valid());
        assert!(!Pinhole { width: 0, ..camera }.is_valid());
    }
}
