//! The one place of a stage program that prints: answers to standard output, messages to standard error.
//!
//! Whoever reads messages may be gone, or the disk that they go to full: that never ends the work. An answer that cannot be
//! given is an error of the program that was asked for it.

use std::fmt::Arguments;
use std::io::{ErrorKind, Write as _};

use rogs_schemas::shown;

/// Prints a line of what was asked for. Called by [`answer!`](crate::answer).
///
/// # Errors
/// When standard output cannot be written; whoever hung up has heard enough.
pub fn print_answer(text: Arguments<'_>) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    match writeln!(out, "{text}").and_then(|()| out.flush()) {
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(()),
        other => other,
    }
}

/// Prints a line for the person at the terminal. Called by [`message!`](crate::message). Names in it are shown as
/// [`shown::line`] does.
pub fn print_message(text: Arguments<'_>) {
    let _ = writeln!(std::io::stderr(), "{}", shown::line(&text.to_string()));
}

/// Rewrites the last line of the person at the terminal; with nothing it is removed.
pub(crate) fn print_progress(text: Arguments<'_>) {
    let mut err = std::io::stderr().lock();
    let _ = write!(err, "\r\x1b[K{}", shown::line(&text.to_string())).and_then(|()| err.flush());
}

/// A line of what was asked for, to standard output. Its value is a [`std::io::Result`].
#[macro_export]
macro_rules! answer {
    ($($text:tt)*) => {
        $crate::console::print_answer(::std::format_args!($($text)*))
    };
}

/// A line for the person at the terminal, to standard error.
#[macro_export]
macro_rules! message {
    ($($text:tt)*) => {
        $crate::console::print_message(::std::format_args!($($text)*))
    };
}
