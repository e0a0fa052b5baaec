//! Lift (Stage 1): clip, robot maps and conditioning to a time-queryable field.
