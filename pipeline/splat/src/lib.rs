//! Gaussian fields, spherical harmonics and the differentiable rasteriser.
