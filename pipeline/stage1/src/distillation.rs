//! What the latent adapter is judged by: how close its tokens, and what the frozen network makes of them, come to those of
//! the RGB path (`docs/spec/latents.md` section 5, after the paper's appendix on the latent-token interface).

use burn::tensor::Tensor;

/// Keeps the direction of a token of zeros finite.
const LEAST_LENGTH: f64 = 1e-12;

/// How far tokens are from those of the RGB path. `[1]` each
#[derive(Debug, Clone)]
pub struct TokenTerms {
    /// Mean squared difference.
    pub square: Tensor<1>,
    /// Mean absolute difference of the cosines between all pairs of tokens of a frame.
    pub pairs: Tensor<1>,
    /// One minus the mean cosine between a token and its counterpart, not below zero; mean over frames.
    pub direction: Tensor<1>,
}

/// Compares tokens with those of the RGB path. `[S, N, C]` each
#[must_use]
pub fn tokens(latent: Tensor<3>, visual: Tensor<3>) -> TokenTerms {
    let square = (latent.clone() - visual.clone()).powi_scalar(2).mean();
    let (latent, visual) = (directions(latent), directions(visual));
    let pairs = (cosines(&visual) - cosines(&latent)).abs().mean();
    let [frames, count, _] = latent.dims();
    let of_frames = (latent * visual).sum_dim(2).reshape([frames, count]).mean_dim(1);
    TokenTerms {
        square,
        pairs,
        direction: (of_frames * -1.0 + 1.0).clamp_min(0.0).mean(),
    }
}

/// Mean over taps of the mean squared difference of standardised features. `[S, N, C]` each
#[must_use]
pub fn features(latent: &[Tensor<3>], visual: &[Tensor<3>]) -> Tensor<1> {
    let of_taps = (latent.iter().zip(visual)).map(|(a, b)| (a.clone() - b.clone()).powi_scalar(2).mean());
    Tensor::cat(of_taps.collect(), 0).mean()
}

/// Mean absolute difference of the logarithms of depth. `[S, H, W]` each
#[must_use]
pub fn log_depth(latent: Tensor<3>, visual: Tensor<3>) -> Tensor<1> {
    (latent - visual).abs().mean()
}

/// Tokens scaled to length one.
fn directions(tokens: Tensor<3>) -> Tensor<3> {
    let length = tokens.clone().powi_scalar(2).sum_dim(2).sqrt().clamp_min(LEAST_LENGTH);
    tokens / length
}

/// Cosines between all pairs of directions. `[S, N, C] -> [S, N, N]`
fn cosines(directions: &Tensor<3>) -> Tensor<3> {
    directions.clone().matmul(directions.clone().swap_dims(1, 2))
}
