//! The Stage-1 lifter, the Stage-2 refiner and LPIPS.
