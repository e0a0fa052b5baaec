//! Every tensor of a configuration: name, shape and seeded values.

use rogs_vit::EncoderSizes;
use rogs_weights::{Initial, ParameterSpec};

use crate::config::{FourDgtConfig, HEADS, PATCH};

/// The tensors of the network, by the names of the released file without `image_coder.`.
#[must_use]
pub fn network(config: &FourDgtConfig) -> Vec<ParameterSpec> {
    let mut list = List::default();
    let width = config.width;
    list.add("cls_token", &[1, 1, width], Initial::Normal { std: 0.02 });
    list.weight("input_linear", &[width, config.patch_numbers()]);
    list.ones("concat_norm.weight", width);
    for index in 0..config.blocks {
        let block = format!("blocks.{index}");
        list.ones(&format!("{block}.norm1.weight"), width);
        list.weight(&format!("{block}.attn.qkv"), &[3 * width, width]);
        list.ones(&format!("{block}.attn.q_norm.weight"), width / config.heads);
        list.ones(&format!("{block}.attn.k_norm.weight"), width / config.heads);
        list.weight(&format!("{block}.attn.proj"), &[width, width]);
        list.ones(&format!("{block}.norm2.weight"), width);
        list.weight(&format!("{block}.mlp.fc1"), &[4 * width, width]);
        list.weight(&format!("{block}.mlp.fc2"), &[width, 4 * width]);
    }
    list.ones("norm.weight", width);
    list.add("norm.bias", &[width], Initial::Constant(0.0));
    for (name, channels) in HEADS {
        let (head, hidden) = (format!("linear_heads.{name}"), channels * config.head_hidden);
        list.weight(&format!("{head}.0"), &[hidden, width]);
        list.weight(&format!("{head}.2"), &[hidden, hidden]);
        list.weight(&format!("{head}.4"), &[channels * PATCH * PATCH, hidden]);
    }
    list.0
}

/// The tensors of an image encoder, by the names of the released file. One that only training reads (`mask_token`) is not
/// among them.
#[must_use]
pub fn encoder(sizes: &EncoderSizes) -> Vec<ParameterSpec> {
    let mut list = List::default();
    let (width, side) = (sizes.width, sizes.position_grid);
    let small = Initial::Normal { std: 0.02 };
    list.add("cls_token", &[1, 1, width], small);
    list.add("pos_embed", &[1, 1 + side * side, width], small);
    if sizes.registers > 0 {
        list.add("register_tokens", &[1, sizes.registers, width], small);
    }
    list.layer("patch_embed.proj", &[width, 3, sizes.patch, sizes.patch]);
    for index in 0..sizes.blocks {
        let block = format!("blocks.{index}");
        for norm in ["norm1", "norm2"] {
            list.norm(&format!("{block}.{norm}"), width);
        }
        list.layer(&format!("{block}.attn.qkv"), &[3 * width, width]);
        list.layer(&format!("{block}.attn.proj"), &[width, width]);
        list.layer(&format!("{block}.mlp.fc1"), &[4 * width, width]);
        list.layer(&format!("{block}.mlp.fc2"), &[width, 4 * width]);
        for scale in ["ls1.gamma", "ls2.gamma"] {
            list.ones(&format!("{block}.{scale}"), width);
        }
    }
    list.norm("norm", width);
    list.0
}

#[derive(Default)]
struct List(Vec<ParameterSpec>);

impl List {
    fn add(&mut self, name: &str, shape: &[usize], initial: Initial) {
        let (name, shape) = (name.to_owned(), shape.to_vec());
        self.0.push(ParameterSpec { name, shape, initial });
    }

    fn ones(&mut self, name: &str, size: usize) {
        self.add(name, &[size], Initial::Constant(1.0));
    }

    /// The weight of a linear or convolution layer.
    fn weight(&mut self, name: &str, shape: &[usize]) {
        let fan_in = shape[1..].iter().product();
        self.add(&format!("{name}.weight"), shape, Initial::Uniform { fan_in });
    }

    /// A layer with a bias.
    fn layer(&mut self, name: &str, shape: &[usize]) {
        self.weight(name, shape);
        self.add(&format!("{name}.bias"), &shape[..1], Initial::Constant(0.0));
    }

    fn norm(&mut self, name: &str, size: usize) {
        self.ones(&format!("{name}.weight"), size);
        self.add(&format!("{name}.bias"), &[size], Initial::Constant(0.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_released_sizes_have_their_published_numbers_of_parameters() {
        let count = |list: Vec<ParameterSpec>| list.iter().map(ParameterSpec::len).sum::<usize>();
        assert_eq!(count(network(&FourDgtConfig::full())), 404_459_776);
        // dinov2_vitb14 has 86,580,480 with its mask token.
        assert_eq!(count(encoder(&EncoderSizes::vit_b(0))), 86_580_480 - 768);
    }
}
