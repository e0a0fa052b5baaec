//! Golden files of the rasteriser: float64 results of an independent implementation, stored as f32.

#![allow(dead_code, unreachable_pub, missing_docs)]

#[path = "../../../../tests/support/tensors.rs"]
mod tensors;

use std::path::{Path, PathBuf};

use rogs_needs::shared;
use rogs_splat::{Colour, Gaussians, Mode, RasterCamera, RasterConfig};
use tensors::Tensors;

/// A golden file in memory.
pub struct Golden {
    pub name: &'static str,
    pub stress: bool,
    tensors: Tensors,
}

/// The golden files that lie beside the tests.
pub fn goldens() -> Vec<Golden> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let read = |(name, stress)| Golden::read(name, stress, &folder.join(format!("{name}.safetensors")));
    [("n200_sh3_bg", false), ("stress_aa", true)].map(read).into()
}

/// The others, among the reference data.
pub fn more_goldens() -> Vec<Golden> {
    let folder = shared!("golden/rasterizer");
    let read = |(name, stress)| Golden::read(name, stress, &folder.join(format!("{name}.safetensors")));
    [
        ("n200_sh0", false),
        ("n200_rgb_amax099", false),
        ("n5000_sh0_bg", false),
        ("n5000_sh3_aa_bg", false),
        ("stress_classic", true),
    ]
    .map(read)
    .into()
}

impl Golden {
    fn read(name: &'static str, stress: bool, path: &Path) -> Self {
        let tensors = Tensors::read(path);
        Self { name, stress, tensors }
    }

    pub fn has(&self, key: &str) -> bool {
        self.tensors.has(key)
    }

    pub fn get(&self, key: &str) -> &[f32] {
        self.tensors.values(key)
    }

    fn number(&self, key: &str) -> f32 {
        self.tensors.metadata[key].parse().unwrap()
    }

    pub fn width(&self) -> usize {
        self.number("width") as usize
    }

    pub fn height(&self) -> usize {
        self.number("height") as usize
    }

    pub fn pixels(&self) -> usize {
        self.width() * self.height()
    }

    pub fn cameras(&self) -> usize {
        self.get("in.Ks").len() / 9
    }

    /// One camera's part of a per-camera tensor.
    pub fn view(&self, key: &str, camera: usize) -> &[f32] {
        let all = self.get(key);
        let per = all.len() / self.cameras();
        &all[camera * per..(camera + 1) * per]
    }

    pub fn scene(&self) -> Gaussians {
        let colour = if self.has("in.sh") {
            let degree = self.number("sh_degree") as usize;
            Colour::Sh {
                degree,
                coefficients: self.get("in.sh").to_vec(),
            }
        } else {
            Colour::Rgb(self.get("in.rgb").to_vec())
        };
        Gaussians {
            means: self.get("in.means").to_vec(),
            quats: self.get("in.quats_wxyz").to_vec(),
            scales: self.get("in.scales").to_vec(),
            opacities: self.get("in.opacities").to_vec(),
            colour,
            extra: self.get("in.features").to_vec(),
            extra_channels: 3,
        }
    }

    pub fn camera(&self, index: usize) -> RasterCamera {
        let k = self
            .view("in.Ks", index)
            .iter()
            .map(|&v| f64::from(v))
            .collect::<Vec<_>>();
        let v = self
            .view("in.viewmats", index)
            .iter()
            .map(|&v| f64::from(v))
            .collect::<Vec<_>>();
        RasterCamera {
            width: self.width() as u32,
            height: self.height() as u32,
            fx: k[0],
            fy: k[4],
            cx: k[2],
            cy: k[5],
            rotation: [v[0], v[1], v[2], v[4], v[5], v[6], v[8], v[9], v[10]],
            translation: [v[3], v[7], v[11]],
        }
    }

    pub fn config(&self, camera: usize) -> RasterConfig {
        let background = if self.has("in.backgrounds") {
            self.view("in.backgrounds", camera).try_into().unwrap()
        } else {
            [0.0; 3]
        };
        RasterConfig {
            mode: if self.tensors.metadata["antialiased"] == "true" {
                Mode::Antialiased
            } else {
                Mode::Classic
            },
            eps2d: self.number("eps2d"),
            alpha_max: self.number("alpha_max"),
            near: self.number("near"),
            far: self.number("far"),
            background,
            min_opacity: 0.0,
            min_compensation: self.number("min_compensation"),
            ..RasterConfig::default()
        }
    }
}

/// Largest absolute difference where `keep` says so (per pixel, `channels` values each).
pub fn worst(a: &[f32], b: &[f32], channels: usize, keep: impl Fn(usize) -> bool) -> f32 {
    assert_eq!(a.len(), b.len());
    let mut worst = 0.0_f32;
    for (index, (x, y)) in a.iter().zip(b).enumerate() {
        if keep(index / channels) {
            let d = (x - y).abs();
            assert!(!d.is_nan(), "not a number at {index}");
            worst = worst.max(d);
        }
    }
    worst
}
