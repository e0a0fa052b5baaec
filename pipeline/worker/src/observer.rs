//! What a long computation tells while it works.

use std::time::Instant;

use rogs_schemas::interim::Figures;
use rogs_schemas::records::progress::Progress;

use crate::error::StageResult;

/// Hears how far a computation is, what its parts cost, and what a person should know.
///
/// [`Context`](crate::Context) is the observer of a job; [`Unobserved`] hears nothing. A computation takes
/// `&mut dyn Observer` and tells it what it does, so that it can be called from a stage, a test and the training alike:
///
/// ```
/// use rogs_worker::{Observer, Unobserved};
///
/// fn sum(values: &[f64], observer: &mut dyn Observer) -> f64 {
///     if values.is_empty() {
///         observer.warn("nothing to add".into());
///     }
///     observer.phase("add", 0.0, || values.iter().sum())
/// }
/// assert_eq!(sum(&[1.0, 2.0], &mut Unobserved), 3.0);
/// ```
pub trait Observer {
    /// `fraction` (0..=1) of the whole is done; `what` comes next, in a few words.
    fn progress(&mut self, _fraction: f64, _what: &str) {}

    /// A part of this name took so many seconds. Parts of the same name add up.
    fn add_seconds(&mut self, _name: &str, _seconds: f64) {}

    /// Something a person should know; the work continues.
    fn warn(&mut self, _warning: String) {}

    /// Keeps how far the work has come, in place of what was kept before: a killed job resumes from there.
    ///
    /// # Errors
    /// When it cannot be written.
    fn keep(&mut self, _progress: &Progress) -> StageResult<()> {
        Ok(())
    }

    /// Shows a person how far the work has come: figures, and a picture as the bytes of a PNG.
    fn show(&mut self, _figures: &Figures, _picture_png: &[u8]) {}
}

impl dyn Observer + '_ {
    /// Runs a phase: tells that it begins with `fraction` (0..=1) of the whole done, and then how long it took.
    pub fn phase<T>(&mut self, name: &str, fraction: f64, work: impl FnOnce() -> T) -> T {
        self.progress(fraction, name);
        let start = Instant::now();
        let result = work();
        self.add_seconds(name, start.elapsed().as_secs_f64());
        result
    }
}

/// Hears nothing.
#[derive(Debug, Clone, Copy, Default)]
pub struct Unobserved;

impl Observer for Unobserved {}

/// The observer of one part of a whole: what the part calls 0..=1 is `from..=from + share` of the whole.
pub struct Part<'a> {
    whole: &'a mut dyn Observer,
    from: f64,
    share: f64,
    name: String,
}

impl<'a> Part<'a> {
    /// The part that begins when `from` of the whole is done and is `share` of it, both 0..=1.
    pub fn new(whole: &'a mut dyn Observer, from: f64, share: f64) -> Self {
        let name = String::new();
        Self {
            whole,
            from,
            share,
            name,
        }
    }

    /// The same, telling its progress as `NAME: WHAT`.
    #[must_use]
    pub fn named(self, name: String) -> Self {
        Self { name, ..self }
    }
}

impl Observer for Part<'_> {
    fn progress(&mut self, fraction: f64, what: &str) {
        let fraction = self.from + self.share * fraction;
        if self.name.is_empty() {
            self.whole.progress(fraction, what);
        } else {
            self.whole.progress(fraction, &format!("{}: {what}", self.name));
        }
    }

    fn add_seconds(&mut self, name: &str, seconds: f64) {
        self.whole.add_seconds(name, seconds);
    }

    fn warn(&mut self, warning: String) {
        self.whole.warn(warning);
    }

    fn keep(&mut self, progress: &Progress) -> StageResult<()> {
        self.whole.keep(progress)
    }

    fn show(&mut self, figures: &Figures, picture_png: &[u8]) {
        if self.name.is_empty() {
            self.whole.show(figures, picture_png);
        } else {
            let part = Some(self.name.clone());
            let figures = Figures {
                part,
                ..figures.clone()
            };
            self.whole.show(&figures, picture_png);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Default)]
    struct Notes {
        progress: Vec<(f64, String)>,
        parts: Vec<String>,
        warnings: Vec<String>,
        shown: Vec<String>,
    }

    impl Observer for Notes {
        fn progress(&mut self, fraction: f64, what: &str) {
            self.progress.push((fraction, what.to_owned()));
        }

        fn add_seconds(&mut self, name: &str, seconds: f64) {
            assert!(seconds >= 0.0);
            self.parts.push(name.to_owned());
        }

        fn warn(&mut self, warning: String) {
            self.warnings.push(warning);
        }

        fn show(&mut self, figures: &Figures, picture_png: &[u8]) {
            self.shown.push(format!("{}, {picture_png:?}", figures.words()));
        }
    }

    #[test]
    fn phases_of_a_part_are_phases_of_the_whole() {
        let mut notes = Notes::default();
        let mut part = Part::new(&mut notes, 0.5, 0.25);
        let observer: &mut dyn Observer = &mut part;
        assert_eq!(observer.phase("one", 0.0, || 1), 1);
        assert_eq!(observer.phase("two", 1.0, || 2), 2);
        observer.warn("careful".into());
        let observer: &mut dyn Observer = &mut Part::new(&mut notes, 0.75, 0.25).named("last".into());
        observer.progress(1.0, "three");
        let figures = Figures {
            part: None,
            update: 3,
            updates: 4,
            loss: 0.5,
            source_psnr_db: None,
        };
        observer.show(&figures, &[1]);
        Part::new(&mut notes, 0.75, 0.25).show(&figures, &[2]);
        let expected = [(0.5, "one"), (0.75, "two"), (1.0, "last: three")];
        assert_eq!(
            notes.progress,
            expected.map(|(fraction, what)| (fraction, what.to_owned()))
        );
        let words = "update 3 of 4, loss 0.5000";
        assert_eq!(notes.shown, [format!("last: {words}, [1]"), format!("{words}, [2]")]);
        assert_eq!(
            (notes.parts, notes.warnings),
            (vec!["one".to_owned(), "two".to_owned()], vec!["careful".to_owned()])
        );
    }
}
