//! Manifest, plan, cache keys, executors, ledger and report.
//!
//! [`report`] is finished: `write_report(folder, &ReportInput)` takes tables and file paths from the caller; whoever
//! assembles a run fills [`report::ReportInput`] from plan, ledger and outputs.

pub mod report;
