//! The networks of rogs on one framework (burn): the Stage-1 lifter, the Stage-2 refiner and LPIPS.

pub mod lpips;
pub mod stage1;
pub mod stage2;
