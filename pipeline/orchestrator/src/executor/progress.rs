//! What a person sees on stderr during a run: bars on a terminal, one line a unit elsewhere.

use std::io::{IsTerminal, Write as _};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use rogs_schemas::shown;

use super::UnitFailure;
use crate::colour;
use crate::costs::duration;

/// What is shown on stderr.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProgressMode {
    /// Bars that are redrawn.
    Bars,
    /// One line for each unit that ends.
    Lines,
    /// One line for each unit that starts or ends, with the worker and what it says on the way.
    Details,
    /// Failures and notes only.
    Quiet,
    /// Nothing.
    Silent,
}

impl ProgressMode {
    /// Bars on a terminal, lines elsewhere.
    #[must_use]
    pub fn for_stderr() -> Self {
        let dumb = std::env::var_os("TERM").is_some_and(|term| term == "dumb");
        if std::io::stderr().is_terminal() && !dumb {
            Self::Bars
        } else {
            Self::Lines
        }
    }
}

/// The display of a run.
pub(super) struct Display {
    mode: ProgressMode,
    todo: usize,
    ended: usize,
    outlook: Outlook,
    bars: Option<Bars>,
}

/// What is left to do: what the plan expects of each unit, and how far that held for those that are done.
pub(super) struct Outlook {
    /// Expected seconds of a unit of each node; none where nothing is known of one.
    expected: Vec<Option<f64>>,
    /// Units at a time.
    workers: usize,
    /// Expected seconds of all units that are left; none where nothing is known of one.
    left: Option<f64>,
    /// Of the units that are done: seconds that were expected, and those that they took.
    done: [f64; 2],
}

impl Outlook {
    /// The outlook on units that are left, by their nodes.
    pub(super) fn new(expected: Vec<Option<f64>>, workers: usize, units: impl Iterator<Item = usize>) -> Self {
        let mut outlook = Self {
            expected,
            workers: workers.max(1),
            left: Some(0.0),
            done: [0.0; 2],
        };
        outlook.more(units);
        outlook
    }

    /// More units are left, by their nodes.
    fn more(&mut self, nodes: impl Iterator<Item = usize>) {
        for node in nodes {
            let expected = self.expected.get(node).copied().flatten();
            self.left = self.left.zip(expected).map(|(left, expected)| left + expected);
        }
    }

    /// Units are left no more, by their nodes.
    fn less(&mut self, nodes: impl Iterator<Item = usize>) {
        for node in nodes {
            let expected = self.expected.get(node).copied().flatten();
            self.left = self
                .left
                .zip(expected)
                .map(|(left, expected)| (left - expected).max(0.0));
        }
    }

    /// A unit of a node took so many seconds.
    fn took(&mut self, node: usize, seconds: f64) {
        self.less(std::iter::once(node));
        if let Some(expected) = self.expected.get(node).copied().flatten() {
            self.done[0] += expected;
            self.done[1] += seconds;
        }
    }

    /// Seconds that the rest will probably take. What is done says how fast this machine is.
    fn seconds(&self) -> Option<f64> {
        let [expected, took] = self.done;
        let pace = if expected > 0.0 { took / expected } else { 1.0 };
        Some(self.left? * pace / self.workers as f64)
    }

    /// `, about 2 min 05 s left`, where that can be said.
    fn words(&self) -> String {
        let left = self.seconds().filter(|&seconds| seconds > 0.0);
        left.map_or_else(String::new, |seconds| format!(", about {} left", duration(seconds)))
    }
}

struct Bars {
    all: MultiProgress,
    total: ProgressBar,
    slots: Vec<ProgressBar>,
}

impl Display {
    pub(super) fn new(mode: ProgressMode, todo: usize, slots: usize, outlook: Outlook) -> Self {
        let bars = (mode == ProgressMode::Bars && todo > 0).then(|| Bars::new(todo, slots));
        let display = Self {
            mode,
            todo,
            ended: 0,
            outlook,
            bars,
        };
        display.tell_outlook();
        display
    }

    fn tell_outlook(&self) {
        if let Some(bars) = &self.bars {
            bars.total.set_message(self.outlook.words());
        }
    }

    /// Whoever reads standard error may be gone, or its disk full: that is nothing to the run.
    fn line(&self, text: &str) {
        let text = shown::text(text);
        let text = colour::painted(&text, &std::io::stderr());
        let print = || {
            let _ = writeln!(std::io::stderr(), "{text}");
        };
        match &self.bars {
            Some(bars) => bars.all.suspend(print),
            None => print(),
        }
    }

    /// More units are to be made than was thought: those of these nodes of a clip, and others that need them.
    pub(super) fn more(&mut self, units: usize, nodes: &[usize]) {
        self.todo += units;
        self.outlook.more(nodes.iter().copied());
        if let Some(bars) = &self.bars {
            bars.total.set_length(self.todo as u64);
        }
    }

    pub(super) fn start(&self, slot: usize, clip: &str, node: &str) {
        if self.mode == ProgressMode::Details {
            self.line(&format!("{clip} {node} starts on worker {slot}"));
        }
        if let Some(bar) = self.bars.as_ref().and_then(|bars| bars.slots.get(slot)) {
            bar.reset();
            bar.set_position(0);
            bar.set_prefix(format!("{clip} {node}"));
            bar.set_message("");
            bar.enable_steady_tick(Duration::from_millis(250));
        }
    }

    pub(super) fn progress(&self, slot: usize, fraction: f64, message: &str) {
        if self.mode == ProgressMode::Details && !message.is_empty() {
            let percent = 100.0 * fraction.clamp(0.0, 1.0);
            self.line(&format!("worker {slot}: {percent:.0} % {}", shown::line(message)));
        }
        if let Some(bar) = self.bars.as_ref().and_then(|bars| bars.slots.get(slot)) {
            bar.set_position((fraction.clamp(0.0, 1.0) * 1000.0) as u64);
            bar.set_message(shown::line(message).into_owned());
        }
    }

    pub(super) fn idle(&self, slot: usize) {
        if let Some(bar) = self.bars.as_ref().and_then(|bars| bars.slots.get(slot)) {
            bar.disable_steady_tick();
            bar.set_position(0);
            bar.set_prefix("idle");
            bar.set_message("");
        }
    }

    fn step(&mut self, units: usize) {
        self.ended += units;
        self.tell_outlook();
        if let Some(bars) = &self.bars {
            bars.total.set_position(self.ended as u64);
        }
    }

    /// A unit of a node, given with its label, is done.
    pub(super) fn done(&mut self, clip: &str, (node, label): (usize, &str), seconds: f64) {
        self.outlook.took(node, seconds);
        self.step(1);
        if matches!(self.mode, ProgressMode::Lines | ProgressMode::Details) {
            let left = self.outlook.words();
            self.line(&format!(
                "[{}/{}] {clip} {label} {seconds:.2} s{left}",
                self.ended, self.todo
            ));
        }
    }

    /// A unit failed; it and what needs it are of these nodes.
    pub(super) fn failed(&mut self, failure: &UnitFailure, nodes: &[usize]) {
        self.outlook.less(nodes.iter().copied());
        self.step(nodes.len());
        if self.mode != ProgressMode::Silent {
            self.line(&format!("[{}/{}] failed: {}", self.ended, self.todo, failure.text()));
        }
    }

    pub(super) fn warn(&self, text: &str) {
        if !matches!(self.mode, ProgressMode::Quiet | ProgressMode::Silent) {
            self.line(&format!("warning: {}", shown::line(text)));
        }
    }

    pub(super) fn note(&self, text: &str) {
        if self.mode != ProgressMode::Silent {
            self.line(text);
        }
    }

    pub(super) fn finish(&self) {
        if let Some(bars) = &self.bars {
            for bar in &bars.slots {
                bar.finish_and_clear();
            }
            bars.total.finish_and_clear();
        }
    }
}

impl Bars {
    fn new(todo: usize, slots: usize) -> Self {
        let all = MultiProgress::with_draw_target(ProgressDrawTarget::stderr_with_hz(8));
        let style = |template: &str| {
            ProgressStyle::with_template(template)
                .unwrap_or_else(|_| ProgressStyle::default_bar())
                .progress_chars("=> ")
        };
        let slot = style("  {prefix:<40!} [{bar:20}] {elapsed:>4} {msg:.dim}");
        let slots = (0..slots)
            .map(|_| {
                let bar = all.add(ProgressBar::new(1000));
                bar.set_style(slot.clone());
                bar.set_prefix("idle");
                bar
            })
            .collect();
        let total = all.add(ProgressBar::new(todo as u64));
        total.set_style(style("[{bar:40}] {pos}/{len} units, {elapsed}{msg}"));
        total.enable_steady_tick(Duration::from_secs(1));
        Self { all, total, slots }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_follows_the_plan_and_then_the_pace() {
        // Two clips of two nodes, expected to take 2 s and 8 s a unit, two at a time.
        let mut outlook = Outlook::new(vec![Some(2.0), Some(8.0)], 2, [0, 1, 0, 1].into_iter());
        assert_eq!(outlook.seconds(), Some(10.0));
        assert_eq!(outlook.words(), ", about 10.0 s left");
        // The first takes twice as long as it should: so will the rest.
        outlook.took(0, 4.0);
        assert_eq!(outlook.seconds(), Some(18.0));
        outlook.less([0, 1].into_iter());
        assert_eq!(outlook.seconds(), Some(8.0));
        outlook.took(1, 16.0);
        assert_eq!((outlook.seconds(), outlook.words()), (Some(0.0), String::new()));
        outlook.more([1].into_iter());
        assert_eq!(outlook.seconds(), Some(8.0));
    }

    #[test]
    fn nothing_is_said_where_nothing_is_known() {
        let outlook = Outlook::new(vec![Some(2.0), None], 1, [0, 1].into_iter());
        assert_eq!((outlook.seconds(), outlook.words()), (None, String::new()));
        let outlook = Outlook::new(vec![Some(2.0), None], 1, [0].into_iter());
        assert_eq!(outlook.seconds(), Some(2.0), "the other is not to be made");
    }
}
