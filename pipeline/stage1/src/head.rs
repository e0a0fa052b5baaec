//! The dense heads: four tapped token maps to one map at image size (`docs/spec/stage1.md` section 6).

use burn::tensor::Tensor;

use super::config::{HeadKind, Stage1Config};
use super::encoded::Encoded;
use super::geometry::encode_time;
use super::positions::head_positions;
use super::pyramid::Pyramid;
use crate::Result;
use rogs_tensors::ops::{self, Conv, DenseTail, Linear};
use rogs_tensors::parameters::{Scope, from_host};

/// Weight of the position maps inside a head.
const POSITION_WEIGHT: f32 = 0.1;
/// Epsilon of the norm of the taps.
pub(crate) const TAP_EPSILON: f64 = 1e-5;

/// Sees the stages of a head by name; tests compare them with reference values.
pub type Observer<'o> = &'o mut dyn FnMut(&str, &Tensor<4>);
/// An observer, if there is one.
type Watch<'w, 'o> = &'w mut Option<Observer<'o>>;

fn show(watch: Watch<'_, '_>, name: impl FnOnce() -> String, map: &Tensor<4>) {
    if let Some(observe) = watch {
        observe(&name(), map);
    }
}

/// conv2(relu(conv1(relu(x)))) + relu(x).
#[derive(Debug, Clone)]
struct ResidualUnit {
    conv1: Conv,
    conv2: Conv,
}

impl ResidualUnit {
    fn load(scope: &Scope<'_>, features: usize) -> Result<Self> {
        let conv = |name: &str| Conv::load(&scope.child(name), [features; 2], 3, 1);
        Ok(Self {
            conv1: conv("conv1")?,
            conv2: conv("conv2")?,
        })
    }

    /// The skip adds relu(x), not x: the released network was trained with an in-place activation.
    fn forward(&self, input: Tensor<4>) -> Tensor<4> {
        let inner = self.conv1.forward_of_relu(input.clone());
        self.conv2.forward_of_relu_onto(inner, input)
    }
}

/// One fusion step from a coarse to a finer level.
#[derive(Debug, Clone)]
struct Fusion {
    lateral: Option<ResidualUnit>,
    residual: ResidualUnit,
    out: Conv,
}

impl Fusion {
    fn load(scope: &Scope<'_>, features: usize, has_lateral: bool) -> Result<Self> {
        let unit = |name: &str| ResidualUnit::load(&scope.child(name), features);
        Ok(Self {
            lateral: if has_lateral { Some(unit("resConfUnit1")?) } else { None },
            residual: unit("resConfUnit2")?,
            out: Conv::load(&scope.child("out_conv"), [features; 2], 1, 1)?,
        })
    }

    /// The 1x1 convolution commutes with the resampling (its weights sum to one), so it runs on the smaller map.
    fn forward(&self, coarse: Option<Tensor<4>>, level: Tensor<4>, size: [usize; 2]) -> Tensor<4> {
        let merged = match (coarse, &self.lateral) {
            (Some(coarse), Some(lateral)) => coarse + lateral.forward(level),
            _ => level,
        };
        ops::resize(self.out.forward(self.residual.forward(merged)), size)
    }
}

/// Joins the features of the stem with the maps of a head: the coarser three levels are added before fusion; with the
/// finest one y = map + project(features), the result is y + conv2(relu(conv1(relu(y)))).
#[derive(Debug, Clone)]
struct StemJoin {
    projections: [Conv; 4],
    conv1: Conv,
    conv2: Conv,
}

impl StemJoin {
    fn load(scope: &Scope<'_>, features: usize, channels: [usize; 4]) -> Result<Self> {
        let conv = |name: &str| Conv::load(&scope.child(name), [features; 2], 3, 1);
        let project = |level: usize| {
            let scope = scope.child(format_args!("project.{level}"));
            Conv::load(&scope, [features, channels[level]], 1, 1)
        };
        Ok(Self {
            projections: [project(0)?, project(1)?, project(2)?, project(3)?],
            conv1: conv("conv1")?,
            conv2: conv("conv2")?,
        })
    }

    fn add(&self, level: usize, map: Tensor<4>, local: &Pyramid) -> Tensor<4> {
        let size = [map.dims()[2], map.dims()[3]];
        map + ops::resize(self.projections[level].forward(local[level].clone()), size)
    }

    fn refine(&self, map: Tensor<4>, local: &Pyramid) -> Tensor<4> {
        let joined = self.add(0, map, local);
        joined.clone() + self.conv2.forward_of_relu(self.conv1.forward_of_relu(joined))
    }
}

/// The weights of one dense head.
#[derive(Debug, Clone)]
pub struct DenseHead {
    kind: HeadKind,
    features: usize,
    time_frequencies: usize,
    norm_weight: Tensor<1>,
    norm_bias: Tensor<1>,
    time: Option<Linear>,
    projections: [Linear; 4],
    enlarge: [(Tensor<4>, Tensor<1>); 2],
    shrink: Conv,
    reduce: [Conv; 4],
    fuse: [Fusion; 4],
    stem: Option<StemJoin>,
    narrow: Conv,
    tail: DenseTail,
    /// The shortcut has the form of the last step.
    shortcut: Option<DenseTail>,
}

/// The four 1x1 projections of a head with the tap norm and the modulation of one query time folded in.
#[derive(Debug, Clone)]
pub struct Projections([Linear; 4]);

impl DenseHead {
    /// Reads a head of the network whose parameters begin with `backbone.`.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load(backbone: &Scope<'_>, kind: HeadKind, config: &Stage1Config) -> Result<Self> {
        let scope = backbone.child(kind.name());
        let Stage1Config {
            head_features: features,
            head_hidden: hidden,
            head_channels: channels,
            ..
        } = *config;
        let inputs = 2 * config.width;
        let norm = scope.child("norm");
        let projection = |level: usize| -> Result<Linear> {
            let scope = scope.child(format_args!("projects.{level}"));
            let weight = scope
                .get("weight", [channels[level], inputs, 1, 1])?
                .reshape([channels[level], inputs]);
            let bias = scope.get("bias", [channels[level]])?;
            Ok(Linear::new(weight, Some(bias)).with_products(scope.products()))
        };
        let enlarge = |level: usize, kernel: usize| -> Result<(Tensor<4>, Tensor<1>)> {
            let scope = scope.child(format_args!("resize_layers.{level}"));
            let weight = scope.get("weight", [channels[level], channels[level], kernel, kernel])?;
            Ok((weight, scope.get("bias", [channels[level]])?))
        };
        let scratch = scope.child("scratch");
        let reduce = |level: usize| {
            let scope = scratch.child(format_args!("layer{}_rn", level + 1));
            Conv::load_unbiased(&scope, [features, channels[level]], 3, 1)
        };
        let fuse = |level: usize| {
            Fusion::load(
                &scratch.child(format_args!("refinenet{}", level + 1)),
                features,
                level < 3,
            )
        };
        let time_numbers = config.time_numbers();
        let shortcut = |inputs| DenseTail::load(&scope.child("shortcut"), [inputs, hidden, kind.channels()]);
        Ok(Self {
            kind,
            features,
            time_frequencies: config.time_frequencies,
            norm_weight: norm.get("weight", [inputs])?,
            norm_bias: norm.get("bias", [inputs])?,
            time: if kind.timed() {
                Some(Linear::load(&scope.child("time_embed"), 2 * inputs, time_numbers)?)
            } else {
                None
            },
            projections: [projection(0)?, projection(1)?, projection(2)?, projection(3)?],
            enlarge: [enlarge(0, 4)?, enlarge(1, 2)?],
            shrink: Conv::load(&scope.child("resize_layers.3"), [channels[3]; 2], 3, 2)?,
            reduce: [reduce(0)?, reduce(1)?, reduce(2)?, reduce(3)?],
            fuse: [fuse(0)?, fuse(1)?, fuse(2)?, fuse(3)?],
            stem: if kind.reads_stem() && config.has_stem() {
                Some(StemJoin::load(&scope.child("stem"), features, config.stem_channels)?)
            } else {
                None
            },
            narrow: Conv::load(&scratch.child("output_conv1"), [features / 2, features], 3, 1)?,
            tail: DenseTail::load(&scratch.child("output_conv2"), [features / 2, hidden, kind.channels()])?,
            shortcut: kind.shortcut_channels().map(shortcut).transpose()?,
        })
    }

    /// Folds the tap norm and, for a timed head, the modulation of a query time into the projections.
    #[must_use]
    pub fn projections(&self, time: Option<f32>) -> Projections {
        let (mut scale, mut offset) = (self.norm_weight.clone(), self.norm_bias.clone());
        if let Some(modulation) = self.modulation(time) {
            let inputs = scale.dims()[0];
            let gain = modulation.clone().narrow(0, 0, inputs) + 1.0;
            scale = scale * gain.clone();
            offset = offset * gain + modulation.narrow(0, inputs, inputs);
        }
        Projections(self.projections.clone().map(|layer| {
            let Linear {
                weight, bias, products, ..
            } = layer;
            let outputs = weight.dims()[0];
            let shift = ops::product(weight.clone(), offset.clone().unsqueeze_dim(1)).reshape([outputs]);
            Linear::new(weight * scale.clone().unsqueeze(), bias.map(|bias| bias + shift)).with_products(products)
        }))
    }

    /// Scale and offset of the taps at a query time, `None` for a head without time. `[2 * 2C]`
    #[must_use]
    pub fn modulation(&self, time: Option<f32>) -> Option<Tensor<1>> {
        let (layer, time) = (self.time.as_ref()?, time?);
        let encoding = encode_time(time, self.time_frequencies);
        let count = encoding.len();
        let encoding = from_host(encoding, [1, count], &self.norm_weight.device());
        Some(layer.forward(encoding).squeeze_dim(0))
    }

    /// The head on some frames, without the shortcut, before activation. `[S, channels, H, W]`
    #[must_use]
    pub fn forward(&self, projections: &Projections, encoded: &Encoded) -> Tensor<4> {
        self.run(projections, encoded, &mut None)
    }

    /// The same, showing every stage to an observer.
    #[must_use]
    pub fn forward_observed(&self, projections: &Projections, encoded: &Encoded, observe: Observer<'_>) -> Tensor<4> {
        self.run(projections, encoded, &mut Some(observe))
    }

    fn run(&self, projections: &Projections, encoded: &Encoded, watch: Watch<'_, '_>) -> Tensor<4> {
        let Encoded {
            taps,
            local,
            grid,
            size,
        } = encoded;
        let (grid, size) = (*grid, *size);
        let levels: [Tensor<4>; 4] = std::array::from_fn(|level| {
            let map = self.level(
                level,
                projections.0[level].forward(taps[level].clone()),
                grid,
                size,
                watch,
            );
            let mut map = self.reduce[level].forward(map);
            if let (Some(stem), Some(local), true) = (&self.stem, local, level < 3) {
                map = stem.add(level + 1, map, &local.levels);
            }
            show(watch, || format!("layer{}_rn", level + 1), &map);
            map
        });
        let sizes = levels.each_ref().map(|map| [map.dims()[2], map.dims()[3]]);
        let targets = [[2 * sizes[0][0], 2 * sizes[0][1]], sizes[0], sizes[1], sizes[2]];
        let [finest, fine, middle, coarse] = levels;
        let mut fused = self.fuse[3].forward(None, coarse, targets[3]);
        show(watch, || "refinenet4".into(), &fused);
        for (level, map) in [(2, middle), (1, fine), (0, finest)] {
            fused = self.fuse[level].forward(Some(fused), map, targets[level]);
            show(watch, || format!("refinenet{}", level + 1), &fused);
        }
        if let (Some(stem), Some(local)) = (&self.stem, local) {
            fused = stem.refine(fused, &local.levels);
            show(watch, || "stem".into(), &fused);
        }
        let narrowed = self.narrow.forward(fused);
        show(watch, || "output_conv1".into(), &narrowed);
        let positions = || self.positions(self.features / 2, size, size);
        if watch.is_none() {
            return self.tail.forward_resized(narrowed, size, Some(&positions));
        }
        let enlarged = ops::resize(narrowed, size) + positions();
        show(watch, || "fused_upsampled_posembed".into(), &enlarged);
        let output = self.tail.forward(enlarged);
        show(watch, || "output_conv2".into(), &output);
        output
    }

    /// The shortcut on its full-resolution input; `None` for a head without one. `[S, c, H, W] -> [S, channels, H, W]`
    #[must_use]
    pub fn shortcut(&self, input: Tensor<4>) -> Option<Tensor<4>> {
        let size = [input.dims()[2], input.dims()[3]];
        Some(self.shortcut.as_ref()?.forward_resized(input, size, None))
    }

    /// Which head this is.
    #[must_use]
    pub fn kind(&self) -> HeadKind {
        self.kind
    }

    /// A projected tap as a map with position embedding, resized for its level. `[S, N, c] -> [S, c, h', w']`
    fn level(
        &self,
        level: usize,
        tokens: Tensor<3>,
        [rows, columns]: [usize; 2],
        size: [usize; 2],
        watch: Watch<'_, '_>,
    ) -> Tensor<4> {
        let [frames, count, channels] = tokens.dims();
        let map = tokens.swap_dims(1, 2).reshape([frames, channels, rows, columns]);
        show(watch, || format!("project{level}"), &map);
        let map = map + self.positions(channels, [rows, columns], size);
        let resized = match level {
            0 | 1 => {
                let (weight, bias) = &self.enlarge[level];
                let kernel = weight.dims()[2];
                let tokens = map.reshape([frames, channels, count]).swap_dims(1, 2);
                // A transposed convolution whose stride is its kernel size writes each output once.
                let weight = weight.clone().reshape([channels, channels * kernel * kernel]);
                let cells = ops::product(tokens.reshape([frames * count, channels]), weight);
                let cells = cells
                    .reshape([frames, rows, columns, channels, kernel, kernel])
                    .permute([0, 3, 1, 4, 2, 5]);
                cells.reshape([frames, channels, rows * kernel, columns * kernel])
                    + bias.clone().reshape([1, channels, 1, 1])
            }
            3 => self.shrink.forward(map),
            _ => map,
        };
        show(watch, || format!("resize{level}"), &resized);
        resized
    }

    /// The weighted position map of a level. `[1, channels, rows, columns]`
    fn positions(&self, channels: usize, [rows, columns]: [usize; 2], [height, width]: [usize; 2]) -> Tensor<4> {
        let map = head_positions(channels, [rows, columns], width as f64 / height as f64);
        let map = map.into_iter().map(|value| POSITION_WEIGHT * value).collect();
        from_host(map, [1, channels, rows, columns], &self.norm_weight.device())
    }
}

/// The FK-conditioning residual branch (`docs/spec/stage1.md` section 11): three 3x3 convolutions, the last zero at first.
#[derive(Debug, Clone)]
pub struct FkBranch {
    layers: [Conv; 3],
}

impl FkBranch {
    /// Reads `fk_branch`.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn load(scope: &Scope<'_>, hidden: usize) -> Result<Self> {
        let inputs = rogs_schemas::records::conditioning::KAPPA_CHANNELS;
        let conv = |name: &str, channels| Conv::load(&scope.child(name), channels, 3, 1);
        Ok(Self {
            layers: [
                conv("conv1", [hidden, inputs])?,
                conv("conv2", [hidden, hidden])?,
                conv("conv3", [3, hidden])?,
            ],
        })
    }

    /// The displacement residual of conditioning maps. `[S, 7, H, W] -> [S, 3, H, W]`
    #[must_use]
    pub fn forward(&self, kappa: Tensor<4>) -> Tensor<4> {
        let [first, second, third] = &self.layers;
        third.forward_of_relu(second.forward_of_relu(first.forward(kappa)))
    }
}
