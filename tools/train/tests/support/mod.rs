//! Comparison of gradients.

use rogs_tensors::optimiser::Gradients;
use rogs_train::Trainer;

/// The first moments after one update: a constant times the gradient.
pub(crate) fn first_moments(trainer: &impl Trainer) -> Gradients {
    let moments = trainer.moments().by_name.iter();
    moments
        .map(|(name, [first, _])| (name.clone(), first.clone()))
        .collect()
}

/// Norm of the difference of gradients over that of the first, which must not be zero.
pub(crate) fn difference(first: &Gradients, second: &Gradients) -> f64 {
    assert!(first.keys().eq(second.keys()));
    let (mut square, mut difference) = (0.0, 0.0);
    for (name, values) in first {
        for (a, b) in values.iter().zip(&second[name]) {
            square += f64::from(*a).powi(2);
            difference += f64::from(a - b).powi(2);
        }
    }
    assert!(square > 0.0);
    (difference / square).sqrt()
}
