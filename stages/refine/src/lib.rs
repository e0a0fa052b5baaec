//! Refine (Stage 2): displacement-preserving refinement by rendering feedback.
