//! Golden-file stage tests, end-to-end, crash and corruption tests over the real programs.
