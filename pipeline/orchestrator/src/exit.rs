//! Exit codes, the same for every command.

use schemars::JsonSchema;
use serde::Serialize;

/// How a command ended, as its exit code.
///
/// | code | name | meaning |
/// |---|---|---|
/// | 0 | `Done` | everything asked for is done |
/// | 1 | `Failed` | no clip could be finished, or a check found a difference |
/// | 2 | `Usage` | the command line, the manifest or a parameter is wrong; nothing was started |
/// | 3 | `Partial` | some clips are done, others failed; the report says which and why |
/// | 4 | `Locked` | another process works in the run folder |
/// | 70 | `Environment` | the orchestrator itself could not continue (disk full, stage program missing) |
/// | 75 | `Stopped` | stopped early by a signal; the same command resumes |
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[repr(u8)]
pub enum Exit {
    /// Everything asked for is done.
    Done = 0,
    /// Nothing could be finished, or a check found a difference.
    Failed = 1,
    /// The command line, the manifest or a parameter is wrong.
    Usage = 2,
    /// Some clips are done, others failed.
    Partial = 3,
    /// Another process works in the run folder.
    Locked = 4,
    /// The orchestrator itself could not continue: the machine or the installation is in the way.
    Environment = 70,
    /// Stopped early by a signal.
    Stopped = 75,
}

impl Exit {
    /// The number that the process exits with.
    #[must_use]
    pub fn code(self) -> u8 {
        self as u8
    }
}

impl crate::Error {
    /// The exit code for this error.
    #[must_use]
    pub fn exit(&self) -> Exit {
        match self {
            Self::Manifest { .. } | Self::Usage { .. } => Exit::Usage,
            Self::Locked { .. } => Exit::Locked,
            _ => Exit::Environment,
        }
    }
}
