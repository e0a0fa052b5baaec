//! Score: render the field at the query plan, measure, write scores.

pub mod metrics;
