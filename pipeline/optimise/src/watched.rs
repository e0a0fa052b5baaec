//! How well an optimisation shows its source views, told by what it renders anyway.

use crate::error::{Result, expect};

/// Most views in a picture.
const MOST_ROWS: usize = 4;

/// Source views as they were last rendered.
#[derive(Debug, Clone, PartialEq)]
pub struct Watched {
    height: usize,
    width: usize,
    /// PSNR of each view, dB; `None` where it was not rendered yet.
    psnr_db: Vec<Option<f64>>,
    /// Rows of the picture: the views that were rendered last. `[H, 2 W, 3]`
    rows: Vec<Vec<u8>>,
}

impl Watched {
    /// So many views of this size, none of them rendered.
    #[must_use]
    pub fn new(views: usize, height: usize, width: usize) -> Self {
        Self {
            height,
            width,
            psnr_db: vec![None; views],
            rows: Vec::new(),
        }
    }

    /// Views that were rendered together: the index of each, its render and its observed image, 0 to 1. `[H, W, 3]`
    ///
    /// # Errors
    /// When an image is not of the size of the views, or a view is out of range.
    pub fn see(&mut self, views: &[(usize, &[f32], &[f32])]) -> Result<()> {
        let numbers = 3 * self.height * self.width;
        self.rows.clear();
        for &(view, render, image) in views {
            expect("the render of a source view", render.len(), numbers)?;
            expect("the image of a source view", image.len(), numbers)?;
            let count = self.psnr_db.len();
            let Some(psnr_db) = self.psnr_db.get_mut(view) else {
                return expect("the list of source views", count, view + 1);
            };
            let square = |(a, b): (&f32, &f32)| (f64::from(a.clamp(0.0, 1.0)) - f64::from(*b)).powi(2);
            let mse = render.iter().zip(image).map(square).sum::<f64>() / numbers as f64;
            *psnr_db = Some(-10.0 * libm::log10(mse.max(f64::MIN_POSITIVE)));
            if self.rows.len() < MOST_ROWS {
                let lines = image
                    .chunks_exact(3 * self.width)
                    .zip(render.chunks_exact(3 * self.width));
                let bytes = lines.flat_map(|(image, render)| image.iter().chain(render).map(|&value| byte(value)));
                self.rows.push(bytes.collect());
            }
        }
        Ok(())
    }

    /// Mean PSNR of the views that were rendered, each as it was the last time, dB.
    #[must_use]
    pub fn psnr_db(&self) -> Option<f64> {
        let seen: Vec<f64> = self.psnr_db.iter().flatten().copied().collect();
        (!seen.is_empty()).then(|| seen.iter().sum::<f64>() / seen.len() as f64)
    }

    /// The views that were rendered last, four at most, below each other: observed images on the left, renders on the right.
    /// Width, height and pixels `[height, width, 3]`; `None` where nothing was rendered.
    #[must_use]
    pub fn picture(&self) -> Option<((u32, u32), Vec<u8>)> {
        let size = (2 * self.width as u32, (self.rows.len() * self.height) as u32);
        (!self.rows.is_empty()).then(|| (size, self.rows.concat()))
    }
}

fn byte(value: f32) -> u8 {
    (255.0 * value.clamp(0.0, 1.0)).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_view_counts_as_it_was_last_rendered() {
        let mut watched = Watched::new(3, 1, 2);
        assert_eq!((watched.psnr_db(), watched.picture()), (None, None));
        let image = [0.5, 0.5, 0.5, 1.0, 1.0, 1.0];
        let off = |by: f32| image.map(|value| value - by);
        watched.see(&[(0, &off(0.1), &image), (2, &off(0.01), &image)]).unwrap();
        // 20 dB and 40 dB.
        assert!((watched.psnr_db().unwrap() - 30.0).abs() < 1e-4);
        watched.see(&[(0, &off(0.01), &image)]).unwrap();
        assert!((watched.psnr_db().unwrap() - 40.0).abs() < 1e-4);
        let ((width, height), pixels) = watched.picture().unwrap();
        assert_eq!((width, height), (4, 1), "the view that was rendered last");
        assert_eq!(pixels, [128, 128, 128, 255, 255, 255, 125, 125, 125, 252, 252, 252]);
        // More light than white is white.
        watched.see(&[(1, &[7.0; 6], &[1.0; 6]), (0, &image, &image)]).unwrap();
        assert!(watched.psnr_db().unwrap() > 1000.0);
        assert_eq!(watched.picture().unwrap().0, (4, 2));
        assert!(watched.see(&[(3, &image, &image)]).is_err());
        assert!(watched.see(&[(0, &image[..3], &image)]).is_err());
    }
}
