//! The training objective of Stage 2 (`docs/spec/stage2.md` section B.8), as tensors that gradients pass through.

use burn::tensor::Tensor;
use serde::{Deserialize, Serialize};

/// Weights of the terms; the settings of a training run hold them under these names.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectiveWeights {
    /// Absolute colour difference, source and paired-right views.
    pub rendering: f64,
    /// Squared colour difference of the same views, as Stage 1 has it: what PSNR is made of. Not in the paper's Stage 2.
    pub rendering_squared: f64,
    /// How often a paired-right view counts in these two where a source view counts once.
    pub right_views: f64,
    /// Perceptual distance of the same views.
    pub perceptual: f64,
    /// Relative metric depth.
    pub depth: f64,
    /// Absolute FK-referenced robot position.
    pub robot: f64,
    /// Rendered motion against tracks.
    pub motion: f64,
    /// Rendered motion against that of Stage 1.
    pub preservation: f64,
    /// Missing opacity, source views.
    pub coverage: f64,
    /// Missing opacity, paired-right views.
    pub coverage_right: f64,
    /// Weight ratio of an update to the next one.
    pub discount: f64,
}

impl Default for ObjectiveWeights {
    /// The paper's Stage-1 weights where a term corresponds, ReSplat's elsewhere.
    fn default() -> Self {
        Self {
            rendering: 1.0,
            rendering_squared: 0.0,
            right_views: 1.0,
            perceptual: 0.5,
            depth: 1.04,
            robot: 0.157,
            motion: 0.106,
            preservation: 0.106,
            coverage: 0.059,
            coverage_right: 0.065,
            discount: 0.9,
        }
    }
}

/// Which side of a stereo pair a view is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ViewSide {
    /// A source camera.
    Source,
    /// The right partner of one: a target of training, never an input.
    PairedRight,
}

/// One rendered view at one query time with its references. `P` pixels.
#[derive(Debug, Clone)]
pub struct RenderedView {
    /// Source or right.
    pub side: ViewSide,
    /// Rows and columns; their product is `P`.
    pub size: [usize; 2],
    /// Render. `[P, 3]`
    pub rgb: Tensor<2>,
    /// Observation. `[P, 3]`
    pub observed_rgb: Tensor<2>,
    /// Expected depth, metres. `[P]`
    pub depth_m: Tensor<1>,
    /// Stereo depth, metres; any positive number where it is not valid. `[P]`
    pub observed_depth_m: Tensor<1>,
    /// 1 where the stereo depth is valid, else 0. `[P]`
    pub depth_valid: Tensor<1>,
    /// 1 where something must be seen, else 0: where the stereo depth is valid, or everywhere in a view without stereo
    /// depth. `[P]`
    pub covered: Tensor<1>,
    /// Accumulated opacity. `[P]`
    pub alpha: Tensor<1>,
}

/// Centres of mesh-anchored Gaussians at a query time, and where kinematics puts their anchors.
#[derive(Debug, Clone)]
pub struct RobotPositions {
    /// Corrected centres, metres. `[M, 3]`
    pub centre_m: Tensor<2>,
    /// `T_l(t) T_l(s)^-1 p`, metres. `[M, 3]`
    pub reference_m: Tensor<2>,
}

/// Composited displacements at track pixels, normalised by opacity, internal units.
#[derive(Debug, Clone)]
pub struct RenderedMotion {
    /// Of the corrected field. `[K, 3]`
    pub displacement: Tensor<2>,
    /// Of the tracks. `[K, 3]`
    pub reference: Tensor<2>,
    /// Of the Stage-1 field, rendered at the same pixels. `[K, 3]`
    pub stage1: Tensor<2>,
}

/// What one update is judged by.
#[derive(Debug, Clone)]
pub struct UpdateOutcome {
    /// Views, source and right.
    pub views: Vec<RenderedView>,
    /// Robot positions, where there is a robot.
    pub robot: Option<RobotPositions>,
    /// Rendered motion, where there are tracks.
    pub motion: Option<RenderedMotion>,
}

/// The unweighted terms of one update and their weighted sum, `[1]` each or as numbers; a term without data is zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ObjectiveTerms<T = Tensor<1>> {
    /// Mean absolute colour difference, right views counted as often as the weights say.
    pub rendering: T,
    /// Mean squared colour difference, counted in the same way.
    pub rendering_squared: T,
    /// Mean perceptual distance.
    pub perceptual: T,
    /// Mean `|D - D*| / D*` over valid pixels.
    pub depth: T,
    /// Mean absolute coordinate difference of robot positions, metres.
    pub robot: T,
    /// Mean absolute coordinate difference of displacements against tracks, internal units.
    pub motion: T,
    /// The same against Stage 1.
    pub preservation: T,
    /// Mean `(1 - alpha)^2` over valid pixels of source views.
    pub coverage: T,
    /// The same for right views.
    pub coverage_right: T,
    /// Weighted sum.
    pub total: T,
}

impl<T> ObjectiveTerms<T> {
    /// The terms as something else.
    ///
    /// # Errors
    /// The first that `f` has.
    pub fn try_map<U, E>(self, mut f: impl FnMut(T) -> Result<U, E>) -> Result<ObjectiveTerms<U>, E> {
        Ok(ObjectiveTerms {
            rendering: f(self.rendering)?,
            rendering_squared: f(self.rendering_squared)?,
            perceptual: f(self.perceptual)?,
            depth: f(self.depth)?,
            robot: f(self.robot)?,
            motion: f(self.motion)?,
            preservation: f(self.preservation)?,
            coverage: f(self.coverage)?,
            coverage_right: f(self.coverage_right)?,
            total: f(self.total)?,
        })
    }
}

/// Distance of a render `[P, 3]` from its observation `[P, 3]` as a `[1]` tensor, for example LPIPS.
pub type Perceptual<'a> = &'a dyn Fn(&RenderedView) -> Tensor<1>;

/// The terms of one update. Means run over all views together. Without `perceptual` that term is zero.
///
/// # Panics
/// When `outcome` has no view.
#[must_use]
pub fn update_objective(
    outcome: &UpdateOutcome,
    weights: &ObjectiveWeights,
    perceptual: Option<Perceptual<'_>>,
) -> ObjectiveTerms {
    let views = &outcome.views;
    let device = views[0].rgb.device();
    let zero = || Tensor::<1>::zeros([1], &device);

    let rendering = mean_of_colours(views, weights.right_views, Tensor::abs);
    let rendering_squared = mean_of_colours(views, weights.right_views, |difference| difference.powi_scalar(2));
    let perceptual = match perceptual {
        Some(distance) => Tensor::cat(views.iter().map(distance).collect(), 0).mean(),
        None => zero(),
    };
    let relative = |view: &RenderedView| {
        (view.depth_m.clone() - view.observed_depth_m.clone()).abs() / view.observed_depth_m.clone()
    };
    let valid = |view: &RenderedView| view.depth_valid.clone();
    let depth = masked_mean(views.iter(), &relative, &valid).unwrap_or_else(zero);
    let missing = |view: &RenderedView| (view.alpha.clone().neg() + 1.0).powi_scalar(2);
    let of_side = |side: ViewSide| views.iter().filter(move |view| view.side == side);
    let covered = |view: &RenderedView| view.covered.clone();
    let coverage = masked_mean(of_side(ViewSide::Source), &missing, &covered).unwrap_or_else(zero);
    let coverage_right = masked_mean(of_side(ViewSide::PairedRight), &missing, &covered).unwrap_or_else(zero);
    let robot = outcome.robot.as_ref();
    let robot = robot.map_or_else(zero, |robot| {
        absolute_difference(robot.centre_m.clone(), robot.reference_m.clone())
    });
    let against = |reference: fn(&RenderedMotion) -> Tensor<2>| {
        let motion = outcome.motion.as_ref();
        motion.map_or_else(zero, |motion| {
            absolute_difference(motion.displacement.clone(), reference(motion))
        })
    };
    let motion = against(|motion| motion.reference.clone());
    let preservation = against(|motion| motion.stage1.clone());

    let total = rendering.clone() * weights.rendering
        + rendering_squared.clone() * weights.rendering_squared
        + perceptual.clone() * weights.perceptual
        + depth.clone() * weights.depth
        + robot.clone() * weights.robot
        + motion.clone() * weights.motion
        + preservation.clone() * weights.preservation
        + coverage.clone() * weights.coverage
        + coverage_right.clone() * weights.coverage_right;
    ObjectiveTerms {
        rendering,
        rendering_squared,
        perceptual,
        depth,
        robot,
        motion,
        preservation,
        coverage,
        coverage_right,
        total,
    }
}

/// The objective of a run of updates: `sum_r discount^(R-1-r) total_r`. `[1]`
///
/// # Panics
/// When there is no update, or an update without views.
#[must_use]
pub fn objective(
    updates: &[UpdateOutcome],
    weights: &ObjectiveWeights,
    perceptual: Option<Perceptual<'_>>,
) -> Tensor<1> {
    let last = updates.len() - 1;
    let weighted = |(update, outcome): (usize, &UpdateOutcome)| {
        update_objective(outcome, weights, perceptual).total * weights.discount.powi((last - update) as i32)
    };
    Tensor::cat(updates.iter().enumerate().map(weighted).collect(), 0).sum()
}

/// Mean of what `measure` makes of colour differences, over views of which a right one counts `right_views` times. `[1]`
fn mean_of_colours(views: &[RenderedView], right_views: f64, measure: impl Fn(Tensor<2>) -> Tensor<2>) -> Tensor<1> {
    let share = |view: &RenderedView| match view.side {
        ViewSide::Source => 1.0,
        ViewSide::PairedRight => right_views,
    };
    let numbers = |view: &RenderedView| 3.0 * (view.size[0] * view.size[1]) as f64;
    let count: f64 = views.iter().map(|view| share(view) * numbers(view)).sum();
    let sum = |view: &RenderedView| measure(view.rgb.clone() - view.observed_rgb.clone()).sum() * share(view);
    Tensor::cat(views.iter().map(sum).collect(), 0).sum() / count.max(1.0)
}

/// Mean absolute difference over all numbers; zero rows give zero.
fn absolute_difference(a: Tensor<2>, b: Tensor<2>) -> Tensor<1> {
    let count = a.dims().iter().product::<usize>().max(1) as f64;
    (a - b).abs().sum() / count
}

/// Mean of a per-pixel value over the pixels of some views where a mask is 1; `None` without views, zero without such
/// pixels.
fn masked_mean<'a>(
    views: impl Iterator<Item = &'a RenderedView>,
    value: &dyn Fn(&RenderedView) -> Tensor<1>,
    mask: &dyn Fn(&RenderedView) -> Tensor<1>,
) -> Option<Tensor<1>> {
    let (values, masks): (Vec<_>, Vec<_>) = views.map(|view| (value(view), mask(view))).unzip();
    if values.is_empty() {
        return None;
    }
    let mask = Tensor::cat(masks, 0);
    // Selection, not multiplication: whatever stands where the mask is 0 must not enter, not even as 0 * infinity.
    let values = Tensor::cat(values, 0).mask_fill(mask.clone().equal_elem(0.0), 0.0);
    Some(values.sum() / mask.sum().clamp_min(1.0))
}

#[cfg(test)]
mod tests {
    use burn::tensor::Device;

    use super::*;

    fn rows(values: &[[f32; 3]], device: &Device) -> Tensor<2> {
        let flat: Vec<f32> = values.concat();
        rogs_tensors::parameters::from_host(flat, [values.len(), 3], device)
    }

    fn line(values: &[f32], device: &Device) -> Tensor<1> {
        rogs_tensors::parameters::from_host(values.to_vec(), [values.len()], device)
    }

    fn number(tensor: Tensor<1>) -> f64 {
        f64::from(rogs_tensors::parameters::to_host(tensor).unwrap()[0])
    }

    /// Two pixels in a source view, one in a right view.
    fn outcome(device: &Device) -> UpdateOutcome {
        let source = RenderedView {
            side: ViewSide::Source,
            size: [1, 2],
            rgb: rows(&[[0.5, 0.25, 0.0], [1.0, 1.0, 1.0]], device),
            observed_rgb: rows(&[[0.25, 0.25, 0.5], [1.0, 0.5, 1.0]], device),
            depth_m: line(&[1.5, 9.0], device),
            observed_depth_m: line(&[2.0, 1.0], device),
            depth_valid: line(&[1.0, 0.0], device),
            covered: line(&[1.0, 0.0], device),
            alpha: line(&[0.5, 0.0], device),
        };
        let right = RenderedView {
            side: ViewSide::PairedRight,
            size: [1, 1],
            rgb: rows(&[[0.0, 0.0, 0.0]], device),
            observed_rgb: rows(&[[0.5, 0.0, 0.0]], device),
            depth_m: line(&[3.0], device),
            observed_depth_m: line(&[4.0], device),
            depth_valid: line(&[1.0], device),
            covered: line(&[1.0], device),
            alpha: line(&[0.75], device),
        };
        UpdateOutcome {
            views: vec![source, right],
            robot: Some(RobotPositions {
                centre_m: rows(&[[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]], device),
                reference_m: rows(&[[1.0, 0.03, 0.0], [0.0, 0.0, -0.06]], device),
            }),
            motion: Some(RenderedMotion {
                displacement: rows(&[[0.5, 0.0, 0.0]], device),
                reference: rows(&[[0.25, 0.5, 0.0]], device),
                stage1: rows(&[[0.5, 0.0, 0.75]], device),
            }),
        }
    }

    #[test]
    fn the_squared_difference_counts_by_its_weight() {
        let outcome = outcome(&Device::flex());
        let total = |rendering_squared: f64| {
            let weights = ObjectiveWeights {
                rendering_squared,
                ..ObjectiveWeights::default()
            };
            number(update_objective(&outcome, &weights, None).total)
        };
        assert!((total(2.0) - total(0.0) - 2.0 * 0.8125 / 9.0).abs() < 1e-6);
    }

    #[test]
    fn every_term_has_its_hand_computed_value() {
        let device = Device::flex();
        let perceptual = |view: &RenderedView| view.rgb.clone().max().reshape([1]);
        let terms = update_objective(&outcome(&device), &ObjectiveWeights::default(), Some(&perceptual));
        let close = |name: &str, term: &Tensor<1>, expected: f64| {
            let value = number(term.clone());
            assert!((value - expected).abs() < 1e-6, "{name}: {value} instead of {expected}");
        };
        // |differences|: 0.25, 0, 0.5, 0, 0.5, 0 and 0.5, 0, 0: nine numbers.
        close("rendering", &terms.rendering, 1.75 / 9.0);
        close("rendering_squared", &terms.rendering_squared, 0.8125 / 9.0);
        // The largest render values of the views are 1 and 0.
        close("perceptual", &terms.perceptual, 0.5);
        // 0.5 / 2 and 1 / 4; the second source pixel is not valid.
        close("depth", &terms.depth, 0.25);
        close("robot", &terms.robot, 0.09 / 6.0);
        close("motion", &terms.motion, 0.75 / 3.0);
        close("preservation", &terms.preservation, 0.75 / 3.0);
        close("coverage", &terms.coverage, 0.25);
        close("coverage_right", &terms.coverage_right, 0.0625);
        let total =
            1.75 / 9.0 + 0.5 * 0.5 + 1.04 * 0.25 + 0.157 * 0.015 + 2.0 * 0.106 * 0.25 + 0.059 * 0.25 + 0.065 * 0.0625;
        close("total", &terms.total, total);
    }

    #[test]
    fn right_views_count_as_often_as_asked() {
        let device = Device::flex();
        let rendering = |right_views: f64| {
            let weights = ObjectiveWeights {
                right_views,
                ..ObjectiveWeights::default()
            };
            let terms = update_objective(&outcome(&device), &weights, None);
            [number(terms.rendering), number(terms.rendering_squared)]
        };
        // Sums over six numbers of the source view and three of the right one, absolute and squared.
        for (index, source, right) in [(0, 1.25, 0.5), (1, 0.5625, 0.25)] {
            assert!((rendering(0.0)[index] - source / 6.0).abs() < 1e-6);
            assert!((rendering(3.0)[index] - (source + 3.0 * right) / (6.0 + 3.0 * 3.0)).abs() < 1e-6);
        }
    }

    #[test]
    fn later_updates_weigh_more_and_absent_references_weigh_nothing() {
        let device = Device::flex();
        let weights = ObjectiveWeights::default();
        let full = outcome(&device);
        let one = number(objective(std::slice::from_ref(&full), &weights, None));
        let bare = UpdateOutcome {
            robot: None,
            motion: None,
            ..full.clone()
        };
        let less = number(objective(std::slice::from_ref(&bare), &weights, None));
        assert!((one - less - (0.157 * 0.015 + 2.0 * 0.106 * 0.25)).abs() < 1e-6);
        let three = number(objective(&[full.clone(), bare, full], &weights, None));
        assert!((three - (0.81 * one + 0.9 * less + one)).abs() < 1e-5);
    }

    #[test]
    fn invalid_pixels_pass_no_gradient_and_no_infinity() {
        let device = Device::flex().autodiff();
        let mut outcome = outcome(&device);
        let depth = line(&[1.5, f32::INFINITY], &device).require_grad();
        outcome.views[0].depth_m = depth.clone();
        let terms = update_objective(&outcome, &ObjectiveWeights::default(), None);
        assert!((number(terms.depth.clone()) - 0.25).abs() < 1e-6);
        let gradients = terms.depth.backward();
        let gradient = rogs_tensors::parameters::to_host(depth.grad(&gradients).unwrap()).unwrap();
        // d/dD |D - 2| / 2 over two valid pixels
        assert_eq!(gradient, [-0.25, 0.0]);
    }
}
