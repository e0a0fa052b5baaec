//! The Stage-2 refiner (`stage2-network.md`).
