//! placeholder: write it WITHOUT criterion (integrator removed that dependency: it changes features of burn's dependencies, everything recompiled). Use
//! `harness = false` and `std::time::Instant`, interleaved runs, minimum and median, like pipeline/kernels/benches/kernels.rs. Reseeding done by the integrator.
fn main() {}
