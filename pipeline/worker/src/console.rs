//! The one place of a stage program that prints: answers to standard output, messages to standard error.
#![allow(
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "the one place that prints; everybody else calls its macros"
)]

use std::fmt::Arguments;

/// Prints a line of what was asked for. Called by [`answer!`](crate::answer).
pub fn print_answer(text: Arguments<'_>) {
    println!("{text}");
}

/// Prints a line for the person at the terminal. Called by [`message!`](crate::message).
pub fn print_message(text: Arguments<'_>) {
    eprintln!("{text}");
}

/// Prints for the person at the terminal without ending the line.
pub(crate) fn print_progress(text: Arguments<'_>) {
    eprint!("{text}");
}

/// A line of what was asked for, to standard output.
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
