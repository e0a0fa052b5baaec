//! The Stage-1 lifting network (`stage1-network.md`).
