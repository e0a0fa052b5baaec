//! Synth: procedural robot episodes with exact references.
