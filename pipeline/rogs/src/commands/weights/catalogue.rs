//! The public weight files that this program knows where to find.

use schemars::JsonSchema;
use serde::Serialize;

/// One public file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
pub(crate) struct PublicFile {
    /// Name on the command line.
    pub(crate) name: &'static str,
    /// Where its authors publish it.
    pub(crate) url: &'static str,
    /// The first digits of its SHA-256 (all 64 where they are published), or nothing where the authors give none; the
    /// server's own statement is used then.
    pub(crate) sha256: &'static str,
    /// What it is.
    pub(crate) what: &'static str,
    /// What to do with it.
    pub(crate) next: &'static str,
    /// What its licence is, as far as known.
    pub(crate) licence: &'static str,
}

/// All of them.
pub(crate) const PUBLIC_FILES: [PublicFile; 7] = [
    PublicFile {
        name: "movies",
        url: "https://huggingface.co/chenguolin/MoVieS/resolve/main/movies_ckpt.safetensors",
        sha256: "",
        what: "MoVieS, the network that Stage 1 starts from (1.04 billion parameters)",
        next: "rogs weights import FILE --out stage1.safetensors",
        licence: "code MIT; the weights derive from VGGT-1B, whose licence applies too",
    },
    PublicFile {
        name: "vggt-1b",
        url: "https://huggingface.co/facebook/VGGT-1B/resolve/main/model.safetensors",
        sha256: "",
        what: "VGGT-1B, another start for Stage 1: encoder, aggregator and two heads",
        next: "rogs weights import FILE --drop-unexpected --out stage1.safetensors",
        licence: "see its model page; not for commercial use",
    },
    PublicFile {
        name: "resplat-re10k",
        url: "https://huggingface.co/haofeixu/resplat/resolve/main/resplat-base-re10k-256x256-view2-b90d1b53.pth",
        sha256: "b90d1b53",
        what: "ReSplat base, one Gaussian per pixel: error encoder and updater that Stage 2 starts from",
        next: "rogs weights import FILE --configuration resplat-re10k --out stage2.safetensors",
        licence: "see its repository",
    },
    PublicFile {
        name: "4dgt",
        url: "https://huggingface.co/projectaria/4DGT/resolve/main/4dgt_1st_stage.pth",
        sha256: "",
        what: "4DGT, first stage: the network of that baseline (404 million parameters; 4.9 GB with its optimiser)",
        next: "rogs weights import FILE --configuration 4dgt --out 4dgt.safetensors",
        licence: "CC BY-NC 4.0: not for commercial use",
    },
    PublicFile {
        name: "dinov2",
        url: "https://dl.fbaipublicfiles.com/dinov2/dinov2_vitb14/dinov2_vitb14_pretrain.pth",
        sha256: "",
        what: "DINOv2 ViT-B/14, the image encoder of 4DGT (87 million parameters)",
        next: "rogs weights import FILE --configuration dinov2 --out dinov2.safetensors",
        licence: "Apache-2.0",
    },
    PublicFile {
        name: "vgg16",
        url: "https://download.pytorch.org/models/vgg16-397923af.pth",
        sha256: "397923af",
        what: "torchvision's VGG16, the convolutions of LPIPS",
        next: "put it into one folder with `lpips-vgg` and name that folder as LPIPS weights",
        licence: "see torchvision",
    },
    PublicFile {
        name: "lpips-vgg",
        url: "https://raw.githubusercontent.com/richzhang/PerceptualSimilarity/master/lpips/weights/v0.1/vgg.pth",
        sha256: "a78928a0af1e5f0fcb1f3b9e8f8c3a2a5a3de244d830ad5c1feddc79b8432868",
        what: "the five heads of LPIPS-VGG, version 0.1",
        next: "put it into one folder with `vgg16` and name that folder as LPIPS weights",
        licence: "BSD-2-Clause",
    },
];

impl PublicFile {
    /// The file of a name.
    pub(crate) fn by_name(name: &str) -> Option<Self> {
        PUBLIC_FILES.into_iter().find(|file| file.name == name)
    }

    /// The last part of its address.
    pub(crate) fn file_name(&self) -> &'static str {
        self.url.rsplit('/').next().unwrap_or(self.name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_encrypted_and_hashes_hexadecimal() {
        for file in PUBLIC_FILES {
            assert!(
                file.url.starts_with("https://") && file.file_name().contains('.'),
                "{file:?}"
            );
            assert!(file.sha256.len() <= 64 && file.sha256.chars().all(|digit| digit.is_ascii_hexdigit()));
            assert!(file.sha256.is_empty() || file.sha256.len() >= 8, "{file:?}");
            assert_eq!(PublicFile::by_name(file.name), Some(file));
        }
    }
}
