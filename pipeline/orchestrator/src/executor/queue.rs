//! Which units are ready, in which order they are taken, and what follows from how they end.

use std::collections::VecDeque;

use crate::plan::{Plan, Unit};
use crate::state::OutputState;

/// State of a unit in this run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Cell {
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
    cells: Vec<Cell>,
    /// Ready clips by node.
    ready: Vec<VecDeque<usize>>,
    /// Units to be run while nothing else runs.
    alone: VecDeque<Unit>,
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
        let cell = |state: &OutputState| {
            if *state == OutputState::UpToDate {
                Cell::UpToDate
            } else {
                Cell::Waiting
            }
        };
        let cells = states.iter().flatten().map(cell).collect();
        let mut queue = Self {
            plan,
            cells,
            ready: vec![VecDeque::new(); nodes],
            alone: VecDeque::new(),
            downstream,
        };
        let clips: Vec<usize> = only.map_or_else(|| (0..plan.clips.len()).collect(), <[usize]>::to_vec);
        for clip in clips {
            for node in 0..nodes {
                queue.push_if_ready(Unit { clip, node });
            }
        }
        queue
    }

    pub(super) fn cell(&self, unit: Unit) -> Cell {
        self.cells[unit.clip * self.plan.nodes.len() + unit.node]
    }

    fn set(&mut self, unit: Unit, cell: Cell) {
        let index = unit.clip * self.plan.nodes.len() + unit.node;
        self.cells[index] = cell;
    }

    fn push_if_ready(&mut self, unit: Unit) {
        let there = |node: usize| matches!(self.cell(Unit { node, ..unit }), Cell::UpToDate | Cell::Made);
        if self.cell(unit) == Cell::Waiting && self.plan.upstream(unit.node).all(there) {
            self.ready[unit.node].push_back(unit.clip);
        }
    }

    /// True when no unit waits that could be run.
    pub(super) fn is_empty(&self) -> bool {
        self.alone.is_empty() && self.ready.iter().all(VecDeque::is_empty)
    }

    /// A unit that must run alone, when nothing runs and no other unit is ready.
    pub(super) fn take_alone(&mut self) -> Option<Unit> {
        let unit = self.alone.pop_front()?;
        self.set(unit, Cell::Running);
        Some(unit)
    }

    /// The next unit for a slot that has `stage` loaded: of that stage while `stay`, else the one deepest in the
    /// pipeline, so that whole clips come out early. `fits` says whether a node may be started now.
    pub(super) fn take(&mut self, stage: Option<&str>, stay: bool, fits: impl Fn(&str) -> bool) -> Option<Unit> {
        let rank = |name: &str| {
            crate::manifest::STAGES
                .iter()
                .position(|stage| *stage == name)
                .unwrap_or(0)
        };
        let nodes = &self.plan.nodes;
        let candidates = (0..nodes.len()).filter(|&node| !self.ready[node].is_empty() && fits(&nodes[node].stage));
        let preferred = |node: &usize| {
            let loaded = stage == Some(nodes[*node].stage.as_str());
            (loaded && stay, rank(&nodes[*node].stage), std::cmp::Reverse(*node))
        };
        let node = candidates.max_by_key(preferred)?;
        let clip = self.ready[node].pop_front()?;
        let unit = Unit { clip, node };
        self.set(unit, Cell::Running);
        Some(unit)
    }

    /// A unit is made; what it makes possible becomes ready.
    pub(super) fn made(&mut self, unit: Unit) {
        self.set(unit, Cell::Made);
        for node in self.downstream[unit.node].clone() {
            self.push_if_ready(Unit { node, ..unit });
        }
    }

    /// A unit is to be tried again.
    pub(super) fn again(&mut self, unit: Unit, alone: bool) {
        self.set(unit, Cell::Waiting);
        if alone {
            self.alone.push_back(unit)
        } else {
            self.ready[unit.node].push_back(unit.clip)
        }
    }

    /// A unit was stopped and stays to be done.
    pub(super) fn stopped(&mut self, unit: Unit) {
        self.set(unit, Cell::Waiting);
    }

    /// A unit failed for good; returns the nodes of its clip that are blocked by it.
    pub(super) fn failed(&mut self, unit: Unit) -> Vec<usize> {
        self.set(unit, Cell::Failed);
        let mut blocked = Vec::new();
        for node in unit.node + 1..self.plan.nodes.len() {
            let here = Unit { node, ..unit };
            let lost = |node: usize| matches!(self.cell(Unit { node, ..unit }), Cell::Failed | Cell::Blocked);
            let needs_this = self
                .plan
                .upstream(node)
                .any(|upstream| upstream == unit.node || blocked.contains(&upstream));
            if self.cell(here) == Cell::Waiting && needs_this && self.plan.upstream(node).any(lost) {
                self.set(here, Cell::Blocked);
                blocked.push(node);
            }
        }
        blocked
    }

    pub(super) fn cells(&self) -> &[Cell] {
        &self.cells
    }
}
