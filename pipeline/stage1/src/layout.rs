//! Every parameter of a configuration: name, shape and initial values, in the order of the released checkpoint.

use super::config::{CELL, HeadKind, POSE_NUMBERS, SPLAT_CHANNELS, Stage1Config};
use super::{adapter, held, stem, sweep};
use rogs_schemas::records::conditioning::KAPPA_CHANNELS;
use rogs_weights::ParameterSource;
pub use rogs_weights::{Initial, ParameterSpec};

/// The parameters of the network in this configuration: those of the released one (1,478 in `full`), and the stem's where
/// there is one.
#[must_use]
pub fn released(config: &Stage1Config) -> Vec<ParameterSpec> {
    let mut list = List::default();
    let Stage1Config {
        width,
        patch,
        registers,
        ..
    } = *config;
    list.filled(
        "backbone.plucker_embed.net",
        &[width, 6, 1, patch, patch],
        Initial::Constant(0.0),
    );
    list.filled("backbone.plucker_ln", &[width], Initial::Constant(0.0));
    let side = config.position_grid;
    list.add(
        "backbone.encoder.cls_token".into(),
        &[1, 1, width],
        Initial::Normal { std: 1e-6 },
    );
    list.add(
        "backbone.encoder.pos_embed".into(),
        &[1, 1 + side * side, width],
        Initial::Normal { std: 0.02 },
    );
    list.add(
        "backbone.encoder.register_tokens".into(),
        &[1, registers, width],
        Initial::Normal { std: 1e-6 },
    );
    list.add(
        "backbone.encoder.mask_token".into(),
        &[1, width],
        Initial::Constant(0.0),
    );
    list.layer("backbone.encoder.patch_embed.proj", &[width, 3, patch, patch]);
    for index in 0..config.encoder_blocks {
        list.block(&format!("backbone.encoder.blocks.{index}"), config, true);
    }
    list.norm("backbone.encoder.norm", width);
    list.add(
        "backbone.backbone.camera_token".into(),
        &[1, 2, 1, width],
        Initial::Normal { std: 1e-6 },
    );
    list.add(
        "backbone.backbone.register_token".into(),
        &[1, 2, registers, width],
        Initial::Normal { std: 1e-6 },
    );
    for kind in ["frame_blocks", "global_blocks"] {
        for index in 0..config.pairs {
            list.block(&format!("backbone.backbone.{kind}.{index}"), config, false);
        }
    }
    list.layer("backbone.backbone.extra_embed", &[width, POSE_NUMBERS]);
    list.layer("backbone.backbone.time_embed", &[width, config.time_numbers()]);
    for kind in HeadKind::ALL {
        list.head(kind, config);
    }
    list.0.extend(stem(config));
    list.0
}

/// The parameters that a stem adds to a network without one: its own, and where heads read it. What it says to tokens and
/// heads is zero at the start, and so is what a sweep says to it.
fn stem(config: &Stage1Config) -> Vec<ParameterSpec> {
    let mut list = List::default();
    if !config.has_stem() {
        return list.0;
    }
    let channels = config.stem_channels;
    let mut inputs = stem::INPUTS;
    for (level, &outputs) in channels.iter().enumerate() {
        let scope = format!("stem.levels.{level}");
        let cell = inputs * CELL * CELL;
        list.layer(&format!("{scope}.conv1"), &[outputs, cell, 3, 3]);
        list.layer(&format!("{scope}.conv2"), &[outputs, outputs, 3, 3]);
        inputs = outputs;
    }
    let zero = Initial::Constant(0.0);
    if config.sweep_depths > 0 {
        list.0.extend(sweep(config));
    }
    let to_tokens = stem::TOKEN_LEVELS.iter().map(|&level| channels[level]).sum();
    list.filled("stem.tokens", &[config.width, to_tokens], zero);
    let features = config.head_features;
    for kind in HeadKind::ALL.into_iter().filter(|kind| kind.reads_stem()) {
        let scope = format!("backbone.{}.stem", kind.name());
        for (level, &channels) in channels.iter().enumerate() {
            list.filled(&format!("{scope}.project.{level}"), &[features, channels, 1, 1], zero);
        }
        list.layer(&format!("{scope}.conv1"), &[features, features, 3, 3]);
        list.filled(&format!("{scope}.conv2"), &[features, features, 3, 3], zero);
    }
    list.0
}

/// The parameters of the sweep in a stem; what it says to the stem is zero at the start.
fn sweep(config: &Stage1Config) -> Vec<ParameterSpec> {
    let mut list = List::default();
    let mut two_layers = |name: &str, level: usize, inputs: usize, outputs: usize| {
        let scope = format!("stem.sweep.{name}.{level}");
        list.layer(&format!("{scope}.conv1"), &[outputs, inputs, 3, 3]);
        list.layer(&format!("{scope}.conv2"), &[outputs, outputs, 3, 3]);
    };
    let mut inputs = stem::COLOURS;
    for (level, &outputs) in sweep::ENCODER_CHANNELS.iter().enumerate() {
        two_layers("levels", level, inputs * CELL * CELL, outputs);
        inputs = outputs;
    }
    let mut inputs = sweep::input_channels(config);
    for (level, &outputs) in sweep::DECODER_CHANNELS.iter().enumerate() {
        two_layers("down", level, inputs, outputs);
        inputs = outputs;
    }
    for level in [1, 0] {
        two_layers(
            "up",
            level,
            inputs + sweep::DECODER_CHANNELS[level],
            sweep::DECODER_CHANNELS[level],
        );
        inputs = sweep::DECODER_CHANNELS[level];
    }
    for (level, &channels) in sweep::ENCODER_CHANNELS.iter().enumerate() {
        list.layer(
            &format!("stem.sweep.features.{level}"),
            &[sweep::FEATURES, channels, 3, 3],
        );
    }
    list.layer("stem.sweep.depths", &[config.sweep_depths, inputs, 1, 1]);
    if config.sweep_other_times > 0 {
        let channels = sweep::OTHER_TIMES_CHANNELS;
        let inputs = sweep::other_times_inputs(config);
        list.layer("stem.sweep.others.conv1", &[channels, inputs, 3, 3]);
        list.layer("stem.sweep.others.conv2", &[channels, channels, 3, 3]);
        let outputs = sweep::DECODER_CHANNELS[0];
        list.filled(
            "stem.sweep.others.join",
            &[outputs, channels, 1, 1],
            Initial::Constant(0.0),
        );
    }
    let own = config.stem_channels[sweep::LEVEL];
    list.filled(
        "stem.sweep.join",
        &[own, sweep::OUTPUT_CHANNELS, 3, 3],
        Initial::Constant(0.0),
    );
    list.0
}

/// The parameters of the FK-conditioning branch; its last layer is zero at the start.
#[must_use]
pub fn fk_branch(config: &Stage1Config) -> Vec<ParameterSpec> {
    let mut list = List::default();
    let hidden = config.fk_hidden;
    list.layer("fk_branch.conv1", &[hidden, KAPPA_CHANNELS, 3, 3]);
    list.layer("fk_branch.conv2", &[hidden, hidden, 3, 3]);
    list.filled("fk_branch.conv3", &[3, hidden, 3, 3], Initial::Constant(0.0));
    list.0
}

/// The parameters of what says where the gripper holds something; its last layer is zero at the start.
#[must_use]
pub fn held() -> Vec<ParameterSpec> {
    let mut list = List::default();
    let hidden = held::HIDDEN;
    list.layer("held.conv1", &[hidden, held::INPUTS, 3, 3]);
    list.layer("held.conv2", &[hidden, hidden, 3, 3]);
    list.filled("held.conv3", &[1, hidden, 3, 3], Initial::Constant(0.0));
    list.0
}

/// The parameters of a latent adapter for a network of this configuration (`docs/spec/stage1.md` section 13).
#[must_use]
pub fn adapter(config: &Stage1Config, blocks: usize) -> Vec<ParameterSpec> {
    let mut list = List::default();
    let width = config.width;
    list.layer(
        "adapter.patch_embed.proj",
        &[width, adapter::LATENT_CHANNELS, adapter::PATCH, adapter::PATCH],
    );
    for index in 0..blocks {
        let block = format!("adapter.blocks.{index}");
        list.norm(&format!("{block}.norm1"), width);
        list.linear(&format!("{block}.attn.qkv"), [3 * width, width], true);
        list.linear(&format!("{block}.attn.proj"), [width, width], true);
        list.norm(&format!("{block}.norm2"), width);
        list.linear(&format!("{block}.mlp.fc1"), [4 * width, width], true);
        list.linear(&format!("{block}.mlp.fc2"), [width, 4 * width], true);
    }
    list.norm("adapter.ln", width);
    list.0
}

/// The low-rank parameters on the QKV and output projections of frame and global blocks (`docs/spec/stage1.md`
/// section 9).
#[must_use]
pub fn lora(config: &Stage1Config, rank: usize) -> Vec<ParameterSpec> {
    let mut list = List::default();
    let width = config.width;
    for kind in ["frame_blocks", "global_blocks"] {
        for index in 0..config.pairs {
            for (layer, outputs) in [("qkv", 3 * width), ("proj", width)] {
                let name = format!("backbone.backbone.{kind}.{index}.attn.{layer}");
                list.add(
                    format!("{name}.lora_A.weight"),
                    &[rank, width],
                    Initial::Uniform { fan_in: width },
                );
                list.add(
                    format!("{name}.lora_B.weight"),
                    &[outputs, rank],
                    Initial::Constant(0.0),
                );
            }
        }
    }
    list.0
}

/// Rank of the low-rank updates in a source, `None` when it has none.
#[must_use]
pub fn lora_rank(source: &dyn ParameterSource) -> Option<usize> {
    source
        .shape("backbone.backbone.frame_blocks.0.attn.qkv.lora_A.weight")
        .and_then(|shape| shape.first().copied())
}

#[derive(Default)]
struct List(Vec<ParameterSpec>);

impl List {
    fn add(&mut self, name: String, shape: &[usize], initial: Initial) {
        self.0.push(ParameterSpec {
            name,
            shape: shape.to_vec(),
            initial,
        });
    }

    /// A weight of this shape and its bias, with equal initial values.
    fn filled(&mut self, name: &str, shape: &[usize], initial: Initial) {
        self.add(format!("{name}.weight"), shape, initial);
        self.add(format!("{name}.bias"), &shape[..1], initial);
    }

    /// A linear or convolution layer.
    fn layer(&mut self, name: &str, shape: &[usize]) {
        self.filled(
            name,
            shape,
            Initial::Uniform {
                fan_in: shape[1..].iter().product(),
            },
        );
    }

    fn norm(&mut self, name: &str, size: usize) {
        self.add(format!("{name}.weight"), &[size], Initial::Constant(1.0));
        self.add(format!("{name}.bias"), &[size], Initial::Constant(0.0));
    }

    fn linear(&mut self, name: &str, [outputs, inputs]: [usize; 2], encoder: bool) {
        if encoder {
            self.add(
                format!("{name}.weight"),
                &[outputs, inputs],
                Initial::Normal { std: 0.02 },
            );
            self.add(format!("{name}.bias"), &[outputs], Initial::Constant(0.0));
        } else {
            self.layer(name, &[outputs, inputs]);
        }
    }

    fn block(&mut self, name: &str, config: &Stage1Config, encoder: bool) {
        let width = config.width;
        let scale = Initial::Constant(if encoder { 1.0 } else { 0.01 });
        self.norm(&format!("{name}.norm1"), width);
        self.linear(&format!("{name}.attn.qkv"), [3 * width, width], encoder);
        if !encoder {
            self.norm(&format!("{name}.attn.q_norm"), config.head_size());
            self.norm(&format!("{name}.attn.k_norm"), config.head_size());
        }
        self.linear(&format!("{name}.attn.proj"), [width, width], encoder);
        self.add(format!("{name}.ls1.gamma"), &[width], scale);
        self.norm(&format!("{name}.norm2"), width);
        self.linear(&format!("{name}.mlp.fc1"), [4 * width, width], encoder);
        self.linear(&format!("{name}.mlp.fc2"), [width, 4 * width], encoder);
        self.add(format!("{name}.ls2.gamma"), &[width], scale);
    }

    fn head(&mut self, kind: HeadKind, config: &Stage1Config) {
        let head = format!("backbone.{}", kind.name());
        let Stage1Config {
            head_features: features,
            head_hidden: hidden,
            head_channels: channels,
            ..
        } = *config;
        let inputs = 2 * config.width;
        self.norm(&format!("{head}.norm"), inputs);
        for (level, &count) in channels.iter().enumerate() {
            self.layer(&format!("{head}.projects.{level}"), &[count, inputs, 1, 1]);
        }
        for (level, kernel) in [(0, 4), (1, 2)] {
            // Of a transposed convolution the second axis is the output.
            self.layer(
                &format!("{head}.resize_layers.{level}"),
                &[channels[level], channels[level], kernel, kernel],
            );
        }
        self.layer(&format!("{head}.resize_layers.3"), &[channels[3], channels[3], 3, 3]);
        for (level, &count) in channels.iter().enumerate() {
            let name = format!("{head}.scratch.layer{}_rn.weight", level + 1);
            self.add(name, &[features, count, 3, 3], Initial::Uniform { fan_in: 9 * count });
        }
        for level in 1..=4 {
            let name = format!("{head}.scratch.refinenet{level}");
            self.layer(&format!("{name}.out_conv"), &[features, features, 1, 1]);
            for unit in if level < 4 { 1..=2 } else { 2..=2 } {
                for conv in 1..=2 {
                    self.layer(
                        &format!("{name}.resConfUnit{unit}.conv{conv}"),
                        &[features, features, 3, 3],
                    );
                }
            }
        }
        self.layer(&format!("{head}.scratch.output_conv1"), &[features / 2, features, 3, 3]);
        self.layer(&format!("{head}.scratch.output_conv2.0"), &[hidden, features / 2, 3, 3]);
        self.layer(
            &format!("{head}.scratch.output_conv2.2"),
            &[kind.channels(), hidden, 1, 1],
        );
        if let Some(inputs) = kind.shortcut_channels() {
            self.layer(&format!("{head}.shortcut.0"), &[hidden, inputs, 3, 3]);
            self.layer(&format!("{head}.shortcut.2"), &[SPLAT_CHANNELS, hidden, 1, 1]);
        }
        if kind.timed() {
            self.filled(
                &format!("{head}.time_embed"),
                &[2 * inputs, config.time_numbers()],
                Initial::Constant(0.0),
            );
        }
    }
}
