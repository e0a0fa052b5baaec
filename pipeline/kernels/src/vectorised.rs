//! Loops compiled for the vector instructions found at run time.

use pulp::{Arch, Simd, WithSimd};

/// Runs a closure whose loops the compiler may turn into the widest vectors of this CPU. Mark the closure
/// `#[inline(always)]`, and what it calls.
pub fn vectorised(work: impl FnMut()) {
    Arch::new().dispatch(Vectorised(work));
}

struct Vectorised<F>(F);

impl<F: FnMut()> WithSimd for Vectorised<F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) {
        // Called as `FnMut`: as `FnOnce` the compiler puts a shim between, which is compiled for the oldest CPU and
        // takes the closure's body with it.
        (self.0)();
    }
}
