//! How much memory a file may take.

use std::path::Path;

use crate::error::{Error, Result};

/// Memory that the content of one file may take at a time besides ten times its length, bytes. Commands that compare two
/// files stay so within ten times their input and 256 MiB.
const BASE: u64 = 96 << 20;

/// Most memory that reading a file of this length may take, bytes. What is larger was packed by more than an ordinary
/// image or array can be, or announces what it does not hold.
#[must_use]
pub fn budget(file_bytes: u64) -> u64 {
    file_bytes.saturating_mul(10).saturating_add(BASE)
}

/// Fails when reading a file would take more than its [`budget`]; `hint` says how to save it instead.
///
/// # Errors
/// When `needed` bytes are too many.
pub fn within_budget(path: &Path, file_bytes: u64, needed: u64, hint: &str) -> Result<()> {
    if needed <= budget(file_bytes) {
        return Ok(());
    }
    let mebibytes = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    let what = format!(
        "it has {:.1} MiB and would take {:.0} MiB of memory; {hint}",
        mebibytes(file_bytes),
        mebibytes(needed)
    );
    Err(Error::wrong(path, what))
}
