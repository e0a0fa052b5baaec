//! What a person sees on stderr during a run: bars on a terminal, one line a unit elsewhere.

use std::io::{IsTerminal, Write as _};
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use rogs_schemas::shown;

use super::UnitFailure;

/// What is shown on stderr.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProgressMode {
    /// Bars that are redrawn.
    Bars,
    /// One line for each unit that ends.
    Lines,
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
    bars: Option<Bars>,
}

struct Bars {
    all: MultiProgress,
    total: ProgressBar,
    slots: Vec<ProgressBar>,
}

impl Display {
    pub(super) fn new(mode: ProgressMode, todo: usize, slots: usize) -> Self {
        let bars = (mode == ProgressMode::Bars && todo > 0).then(|| Bars::new(todo, slots));
        Self {
            mode,
            todo,
            ended: 0,
            bars,
        }
    }

    /// Whoever reads standard error may be gone, or its disk full: that is nothing to the run.
    fn line(&self, text: &str) {
        let text = shown::text(text);
        let print = || {
            let _ = writeln!(std::io::stderr(), "{text}");
        };
        match &self.bars {
            Some(bars) => bars.all.suspend(print),
            None => print(),
        }
    }

    /// More units are to be made than was thought.
    pub(super) fn more(&mut self, units: usize) {
        self.todo += units;
        if let Some(bars) = &self.bars {
            bars.total.set_length(self.todo as u64);
        }
    }

    pub(super) fn start(&self, slot: usize, clip: &str, node: &str) {
        if let Some(bar) = self.bars.as_ref().and_then(|bars| bars.slots.get(slot)) {
            bar.reset();
            bar.set_position(0);
            bar.set_prefix(format!("{clip} {node}"));
            bar.set_message("");
            bar.enable_steady_tick(Duration::from_millis(250));
        }
    }

    pub(super) fn progress(&self, slot: usize, fraction: f64, message: &str) {
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
        if let Some(bars) = &self.bars {
            bars.total.set_position(self.ended as u64);
        }
    }

    pub(super) fn done(&mut self, clip: &str, node: &str, seconds: f64) {
        self.step(1);
        if self.mode == ProgressMode::Lines {
            self.line(&format!("[{}/{}] {clip} {node} {seconds:.2} s", self.ended, self.todo));
        }
    }

    pub(super) fn failed(&mut self, failure: &UnitFailure, units: usize) {
        self.step(units);
        if self.mode != ProgressMode::Silent {
            self.line(&format!("[{}/{}] failed: {}", self.ended, self.todo, failure.text()));
        }
    }

    pub(super) fn warn(&self, text: &str) {
        if matches!(self.mode, ProgressMode::Bars | ProgressMode::Lines) {
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
        total.set_style(style("[{bar:40}] {pos}/{len} units, {elapsed}, about {eta} left"));
        total.enable_steady_tick(Duration::from_secs(1));
        Self { all, total, slots }
    }
}
