//! What to do after a failure.

use rogs_schemas::ledger::Failure;
use rogs_schemas::protocol::FailureCode;
use signal_hook::consts::{SIGKILL, SIGTERM, SIGXFSZ};

use crate::stage::StageId;

/// What to do with a unit that failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Retry {
    /// It failed for good.
    No,
    /// Try it again.
    Again,
    /// Try it again while nothing else runs.
    Alone,
}

/// The policy: passing troubles get three attempts, lack of memory or disk a second one alone, everything else none,
/// because the same input would fail the same way or take as long.
pub(super) fn retry(code: FailureCode, attempts: u8) -> Retry {
    match code {
        FailureCode::Io if attempts < 3 => Retry::Again,
        FailureCode::Resource if attempts < 2 => Retry::Alone,
        FailureCode::Io | FailureCode::Resource => Retry::No,
        FailureCode::BadInput | FailureCode::BadParams | FailureCode::Deadline | FailureCode::Internal => Retry::No,
    }
}

/// How a worker that died is to be understood.
pub(super) fn of_crash(stage: StageId, clip: &str, status: std::process::ExitStatus, stderr: &[String]) -> Failure {
    use std::os::unix::process::ExitStatusExt as _;
    let how = match status.signal() {
        Some(signal) => format!("was killed by signal {signal}"),
        None => format!("ended with exit code {}", status.code().unwrap_or(-1)),
    };
    let no_memory = stderr.iter().any(|line| line.contains("memory allocation of"));
    let (code, hint) = if status.signal() == Some(SIGKILL) || no_memory {
        (
            FailureCode::Resource,
            "probably out of memory: use fewer workers (`workers` in [executor]) or a larger machine",
        )
    } else if status.signal() == Some(SIGXFSZ) {
        (
            FailureCode::Resource,
            "the output is longer than files may be here: raise the limit (`ulimit -f`)",
        )
    } else if status.code() == Some(75) || status.signal() == Some(SIGTERM) {
        (FailureCode::Io, "someone stopped the worker; run again")
    } else {
        (
            FailureCode::Internal,
            "this is a bug in the stage; please report it with the clip's log",
        )
    };
    Failure {
        code,
        message: format!("the worker of `{stage}` {how} on clip `{clip}`"),
        hint: Some(hint.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt as _;
    use std::process::ExitStatus;

    use super::*;

    #[test]
    fn only_passing_troubles_are_tried_again() {
        assert_eq!(retry(FailureCode::BadInput, 1), Retry::No);
        assert_eq!(retry(FailureCode::Internal, 1), Retry::No);
        assert_eq!(retry(FailureCode::Deadline, 1), Retry::No);
        assert_eq!(retry(FailureCode::Io, 2), Retry::Again);
        assert_eq!(retry(FailureCode::Io, 3), Retry::No);
        assert_eq!(retry(FailureCode::Resource, 1), Retry::Alone);
        assert_eq!(retry(FailureCode::Resource, 2), Retry::No);
    }

    #[test]
    fn deaths_are_told_apart() {
        let of = |status: i32, stderr: &[&str]| {
            let stderr: Vec<String> = stderr.iter().map(|line| (*line).to_owned()).collect();
            of_crash(StageId::Lift, "a", ExitStatus::from_raw(status), &stderr).code
        };
        assert_eq!(of(9, &[]), FailureCode::Resource);
        assert_eq!(of(6, &["memory allocation of 99 bytes failed"]), FailureCode::Resource);
        assert_eq!(of(SIGXFSZ, &[]), FailureCode::Resource);
        assert_eq!(of(6, &[]), FailureCode::Internal);
        assert_eq!(of(75 << 8, &[]), FailureCode::Io);
        assert_eq!(of(1 << 8, &[]), FailureCode::Internal);
    }
}
