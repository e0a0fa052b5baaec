//! How a stage program ends, the same for all its faces.

use crate::error::StageError;

/// Exit status: everything asked for is done.
pub const EXIT_OK: u8 = 0;
/// Exit status: at least one unit failed for good.
pub const EXIT_FAILED: u8 = 1;
/// Exit status: the command line, the plan or the parameters are wrong.
pub const EXIT_USAGE: u8 = 2;
/// Exit status: stopped early by a signal or a passing trouble; run again (`EX_TEMPFAIL`).
pub const EXIT_TEMPORARY: u8 = 75;

/// Prints a failure as a person should see it.
pub(crate) fn print_error(error: &StageError) {
    crate::message!("error: {error}");
    if let Some(hint) = &error.hint {
        crate::message!("hint: {hint}");
    }
}
