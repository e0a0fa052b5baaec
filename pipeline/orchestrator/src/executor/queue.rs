//! Which units are ready, in which order they are taken, and what follows from how they end.

use std::collections::VecDeque;

use crate::plan::{Plan, WorkUnit};
use crate::stage::StageId;
use crate::state::OutputState;

/// How far a unit is in this run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Standing {
    /// Up to date before this run.
    UpToDate,
    /// Waits for other units, or for a slot.
    Waiting,
    Running,
    Made,
    Failed,
    /// Something it needs failed.
    Blocked,
}

/// The units of a run.
pub(super) struct Queue<'a> {
    plan: &'a Plan,
    /// Clip by clip, node by node.
    standings: Vec<Standing>,
    /// Ready clips by node.
    ready: Vec<VecDeque<usize>>,
    /// Units to be run while nothing else runs.
    alone: VecDeque<WorkUnit>,
    /// Nodes that read a node's output.
    downstream: Vec<Vec<usize>>,
}

impl<'a> Queue<'a> {
    pub(super) fn new(plan: &'a Plan, states: &[Vec<OutputState>], only: Option<&[usize]>) -> Self {
        let nodes = plan.nodes.len();
        let mut downstream = vec![Vec::new(); nodes];
        for node in 0..nodes {
            for upstream in plan.upstream(node) {
                downstream[upstream].push(node);
            }
        }
        let standing = |state: &OutputState| {
            if *state == OutputState::UpToDate {
                Standing::UpToDate
            } else {
                Standing::Waiting
            }
        };
        let standings = states.iter().flatten().map(standing).collect();
        let mut queue = Self {
            plan,
            standings,
            ready: vec![VecDeque::new(); nodes],
            alone: VecDeque::new(),
            downstream,
        };
        let clips: Vec<usize> = only.map_or_else(|| (0..plan.clips.len()).collect(), <[usize]>::to_vec);
        for clip in clips {
            for node in 0..nodes {
                queue.push_if_ready(WorkUnit { clip, node });
            }
        }
        queue
    }

    fn standing(&self, unit: WorkUnit) -> Standing {
        self.standings[unit.clip * self.plan.nodes.len() + unit.node]
    }

    fn set(&mut self, unit: WorkUnit, standing: Standing) {
        let index = unit.clip * self.plan.nodes.len() + unit.node;
        self.standings[index] = standing;
    }

    fn push_if_ready(&mut self, unit: WorkUnit) {
        let there = |node: usize| {
            matches!(
                self.standing(WorkUnit { node, ..unit }),
                Standing::UpToDate | Standing::Made
            )
        };
        if self.standing(unit) == Standing::Waiting && self.plan.upstream(unit.node).all(there) {
            self.ready[unit.node].push_back(unit.clip);
        }
    }

    /// True when no unit waits that could be run.
    pub(super) fn is_empty(&self) -> bool {
        self.alone.is_empty() && self.ready.iter().all(VecDeque::is_empty)
    }

    /// A unit that must run alone, when nothing runs and no other unit is ready.
    pub(super) fn take_alone(&mut self) -> Option<WorkUnit> {
        let unit = self.alone.pop_front()?;
        self.set(unit, Standing::Running);
        Some(unit)
    }

    /// The next unit for a slot: of the stage that it has loaded while `stay`, else the one deepest in the
    /// pipeline, so that whole clips come out early. `fits` says whether a stage may be started now.
    pub(super) fn take(
        &mut self,
        loaded: Option<StageId>,
        stay: bool,
        fits: impl Fn(StageId) -> bool,
    ) -> Option<WorkUnit> {
        let nodes = &self.plan.nodes;
        let candidates = (0..nodes.len()).filter(|&node| !self.ready[node].is_empty() && fits(nodes[node].stage));
        let preferred = |&node: &usize| {
            let stage = nodes[node].stage;
            (loaded == Some(stage) && stay, stage, std::cmp::Reverse(node))
        };
        let node = candidates.max_by_key(preferred)?;
        let clip = self.ready[node].pop_front()?;
        let unit = WorkUnit { clip, node };
        self.set(unit, Standing::Running);
        Some(unit)
    }

    /// A unit is made; what it makes possible becomes ready.
    pub(super) fn made(&mut self, unit: WorkUnit) {
        self.set(unit, Standing::Made);
        for node in self.downstream[unit.node].clone() {
            self.push_if_ready(WorkUnit { node, ..unit });
        }
    }

    /// A unit is to be tried again.
    pub(super) fn again(&mut self, unit: WorkUnit, alone: bool) {
        self.set(unit, Standing::Waiting);
        if alone {
            self.alone.push_back(unit)
        } else {
            self.ready[unit.node].push_back(unit.clip)
        }
    }

    /// The outputs of these nodes of a unit's clip are gone: they are made again first, then the unit and whatever else
    /// reads them and waits. Returns how many that were done are to be made again.
    pub(super) fn again_after(&mut self, unit: WorkUnit, lost: &[usize]) -> usize {
        let mut more = 0;
        self.set(unit, Standing::Waiting);
        for &node in lost {
            let here = WorkUnit { node, ..unit };
            if matches!(self.standing(here), Standing::UpToDate | Standing::Made) {
                self.set(here, Standing::Waiting);
                more += 1;
            }
        }
        // What was ready is not any more where it reads one of them; it becomes ready again when that is made.
        for (node, ready) in self.ready.iter_mut().enumerate() {
            if lost.contains(&node) || self.plan.upstream(node).any(|upstream| lost.contains(&upstream)) {
                ready.retain(|&clip| clip != unit.clip);
            }
        }
        self.alone
            .retain(|waiting| waiting.clip != unit.clip || waiting.node != unit.node);
        for &node in lost {
            self.push_if_ready(WorkUnit { node, ..unit });
        }
        more
    }

    /// A unit was stopped and stays to be done.
    pub(super) fn stopped(&mut self, unit: WorkUnit) {
        self.set(unit, Standing::Waiting);
    }

    /// A unit failed for good; returns the nodes of its clip that are blocked by it.
    pub(super) fn failed(&mut self, unit: WorkUnit) -> Vec<usize> {
        self.set(unit, Standing::Failed);
        let mut blocked = Vec::new();
        for node in unit.node + 1..self.plan.nodes.len() {
            let here = WorkUnit { node, ..unit };
            let lost = |node: usize| {
                matches!(
                    self.standing(WorkUnit { node, ..unit }),
                    Standing::Failed | Standing::Blocked
                )
            };
            let needs_this = self
                .plan
                .upstream(node)
                .any(|upstream| upstream == unit.node || blocked.contains(&upstream));
            if self.standing(here) == Standing::Waiting && needs_this && self.plan.upstream(node).any(lost) {
                self.set(here, Standing::Blocked);
                blocked.push(node);
            }
        }
        blocked
    }

    /// How far the units are: clip by clip, node by node.
    pub(super) fn standings(&self) -> &[Standing] {
        &self.standings
    }
}
