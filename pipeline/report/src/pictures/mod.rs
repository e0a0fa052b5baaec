//! Pictures of the report: input strips with mesh outlines, robot maps, renders beside references, figures of
//! fields.

mod colours;
mod comparison;
mod fields;
mod frames;
mod merged;
mod outline;
mod picture;
mod sheets;
mod studio;

pub(crate) use comparison::{Comparison, comparison, rollout};
pub(crate) use fields::{FieldFigures, FieldFile, wanted};
pub(crate) use picture::{Figure, photograph};
pub(crate) use sheets::{inputs, overlay, renders, robot};
