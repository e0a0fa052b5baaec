//! Pictures of the report: input strips with mesh outlines, robot maps, renders beside references.

mod colours;
mod comparison;
mod frames;
mod outline;
mod picture;
mod sheets;

pub(crate) use comparison::{Comparison, comparison, rollout};
pub(crate) use picture::{Figure, photograph};
pub(crate) use sheets::{inputs, overlay, renders, robot};
