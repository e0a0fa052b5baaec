//! What a unit of a node takes: as measured in this run, or as the figures of its stage say.

use crate::error::Result;
use crate::ledger::{StageCost, read_costs};
use crate::plan::Plan;
use crate::stage::{FIGURES_OF, Figures};

/// What one unit of a node takes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NodeCost {
    /// `None` where the stage programs do not say how large a clip is, and nothing was measured.
    pub(crate) cost: Option<StageCost>,
    /// Whether it was measured in this run, or follows from figures of another machine.
    pub(crate) measured: bool,
}

/// The cost of each node of a plan, in their order.
///
/// # Errors
/// When the ledgers cannot be read.
pub(crate) fn node_costs(plan: &Plan) -> Result<Vec<NodeCost>> {
    let costs = read_costs(&plan.run)?;
    let size = size(plan);
    let of = |node: &crate::plan::Node| {
        let measured = costs.get(node.stage.name()).copied();
        NodeCost {
            measured: measured.is_some(),
            cost: measured.or_else(|| Some(expected(&node.stage.spec().figures, size?))),
        }
    };
    Ok(plan.nodes.iter().map(of).collect())
}

/// How many times the clip of the built-in figures a clip of this plan is: by pixels, by pixels of all frames. None where the
/// stage programs have no such parameters.
fn size(plan: &Plan) -> Option<f64> {
    let node = plan.nodes.iter().find(|node| node.stage.spec().interval.is_some())?;
    let names = node.stage.spec().interval.as_ref()?;
    let number = |name: &str| node.params.get(name).and_then(serde_json::Value::as_f64);
    let [height, width] = names.size;
    let [pixels, frames] = FIGURES_OF;
    Some(number(height)? * number(width)? / pixels * (number(names.frames)? / frames))
}

/// What a clip costs that is so many times that of the figures.
fn expected(figures: &Figures, times: f64) -> StageCost {
    let bytes = |mebibytes: f64| (mebibytes * times * f64::from(1 << 20)) as u64;
    StageCost {
        count: 0,
        seconds: figures.seconds * times,
        output_bytes: bytes(figures.output_mib),
        // The program itself and its threads take some memory too.
        peak_rss_bytes: bytes(figures.peak_mib) + (64 << 20),
    }
}

/// Seconds for people.
#[must_use]
pub(crate) fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..60 => format!("{seconds:.1} s"),
        60..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
    }
}
