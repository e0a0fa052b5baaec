//! Manifest, plan, cache keys, executors, ledger and report.
