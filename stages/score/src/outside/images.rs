//! Rendered images of an outside method: what a method without Gaussians, or with its own renderer, hands in.

use std::collections::BTreeMap;
use std::path::Path;

use rogs_arrays::ArrayFile;
use rogs_schemas::FrameIndex;

use crate::outside::OutsideError;
use crate::outside::sampled::frames;

/// Images of all cameras at some clip frames, from `images.npz` or `images.safetensors`.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagePredictions {
    /// Clip frames. `[Q]`
    pub frames: Vec<FrameIndex>,
    /// By camera id.
    pub cameras: BTreeMap<String, CameraImages>,
}

/// What there is of one camera, each at every frame.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CameraImages {
    /// Colours in [0, 1]. `[Q, H, W, 3]`
    pub rgb: Option<Vec<f32>>,
    /// Camera-z depth, metres, 0 where undefined. `[Q, H, W]`
    pub depth_m: Option<Vec<f32>>,
    /// Rendered displacement from the tracks' anchor frame to the frame, seen at the anchor frame; base frame, metres.
    /// `[Q, H, W, 3]`
    pub displacement_m: Option<Vec<f32>>,
}

impl ImagePredictions {
    /// Cameras with colours or depths that are not finite, and how many.
    pub(crate) fn undefined(&self) -> Vec<(&str, usize)> {
        let count = |values: &Option<Vec<f32>>| {
            let values = values.iter().flatten();
            values.filter(|value| !value.is_finite()).count()
        };
        let all = self.cameras.iter();
        all.map(|(id, own)| (id.as_str(), count(&own.rgb) + count(&own.depth_m)))
            .filter(|(_, count)| *count > 0)
            .collect()
    }

    /// Cameras with colours that cannot be meant to lie in 0 to 1, and the largest.
    pub(crate) fn beyond(&self) -> Vec<(&str, f32)> {
        /// Renderers overshoot by less.
        const MOST: f32 = 2.0;
        let most = |own: &CameraImages| {
            let values = own.rgb.iter().flatten().copied().filter(|value| value.is_finite());
            values.fold(0.0, f32::max)
        };
        let all = self.cameras.iter().map(|(id, own)| (id.as_str(), most(own)));
        all.filter(|(_, most)| *most > MOST).collect()
    }

    /// Reads `frames [Q]` and per camera `rgb_ID [Q, H, W, 3]` (8 bit, or floats in 0 to 1), `depth_ID [Q, H, W]` and
    /// `displacement_ID [Q, H, W, 3]`, each of which may be missing. `None` when the folder has no such file.
    ///
    /// # Errors
    /// When an array has another size than the clip's images, or belongs to no camera of `ids`.
    pub fn read(folder: &Path, ids: &[&str], height: usize, width: usize) -> Result<Option<Self>, OutsideError> {
        let names = ["images.npz", "images.safetensors"].map(|name| folder.join(name));
        let Some(path) = names.iter().find(|path| path.is_file()) else {
            return Ok(None);
        };
        let file = ArrayFile::open(path)?;
        let frames = frames(&file)?;
        let count = frames.len();
        let known = |name: &str| {
            let kinds = ["rgb_", "depth_", "displacement_"];
            name == "frames"
                || kinds
                    .iter()
                    .any(|kind| name.strip_prefix(kind).is_some_and(|id| ids.contains(&id)))
        };
        if let Some(name) = file.names().iter().find(|name| !known(name)) {
            let what = format!(
                "array `{name}` is not understood; names are `frames` and `rgb_`, `depth_` or `displacement_` with one of: {}",
                ids.join(", ")
            );
            return Err(OutsideError::file(path, what));
        }
        let mut cameras = BTreeMap::new();
        for id in ids {
            let get = |kind: &str, shape: &[usize]| {
                let array = file.find(&[&format!("{kind}_{id}")])?;
                array.iter().try_for_each(|array| array.expect_shape(path, &[shape]))?;
                Ok::<_, OutsideError>(array)
            };
            let vectors = [count, height, width, 3];
            let images = CameraImages {
                rgb: get("rgb", &vectors)?.map(|array| array.into_colours()),
                depth_m: get("depth", &vectors[..3])?.map(|array| array.into_floats()),
                displacement_m: get("displacement", &vectors)?.map(|array| array.into_floats()),
            };
            if images != CameraImages::default() {
                cameras.insert((*id).to_owned(), images);
            }
        }
        Ok(Some(Self { frames, cameras }))
    }

    /// Place of a clip frame in the arrays.
    ///
    /// # Errors
    /// When there is nothing for the frame.
    pub fn index(&self, frame: FrameIndex) -> Result<usize, OutsideError> {
        let found = self.frames.iter().position(|&own| own == frame);
        found.ok_or_else(|| OutsideError::MissingFrame {
            frame,
            frames: self.frames.clone(),
        })
    }
}
