//! Arrays and images in files that rogs shares with other programs.
//!
//! | format | read | written |
//! |---|---|---|
//! | numpy `.npy` | [`NpyFile`], [`npy_numbers`], [`ArrayFile`] | [`npy_header`], [`npy_bytes`] |
//! | numpy `.npz`, `.safetensors` | [`ArrayFile`] | [`write_npz`] |
//! | HDF5 | [`Hdf5File`] | |
//! | OpenEXR, one flat part | [`FlatExr`] | [`write_exr`] |
//! | PNG | [`Png`]; what it and JPEG say beside their pixels: [`Remarks`] | [`write_png`], [`grey_png_bytes`], [`grey16_png_bytes`] |
//!
//! Readers meet files of strangers: what a header announces is compared with the length of the file (no file takes more
//! memory than its [`budget`]), and with fixed limits, before anything is allocated for it. What is no file - a pipe, a
//! device - is not read. Files are written whole or not at all ([`rogs_files`]). What the values
//! mean (units, frames) is the caller's business.
//!
//! ```
//! use rogs_arrays::{ArrayFile, NamedArray, Values, write_npz};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("view.npz");
//! let depth_m = [1.0_f32, 1.5, 2.0, 2.5, 3.0, 3.5];
//! write_npz(&path, &[NamedArray::new("depth", &[2, 3], &depth_m)])?;
//!
//! let depth = ArrayFile::open(&path)?.need(&["depth"])?;
//! assert_eq!(depth.shape, [2, 3]);
//! assert_eq!(depth.values, Values::Floats(depth_m.to_vec()));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod budget;
mod dtype;
mod error;
mod exr;
mod hdf5;
mod named;
mod npy;
mod npz;
mod png;
mod remarks;
mod shape;
mod zip;

pub use budget::{budget, within_budget};
pub use dtype::{Dtype, Scalar, Values, le_bytes};
pub use error::{Error, Problem, Result};
pub use exr::{FlatExr, write_exr};
pub use hdf5::{Hdf5Dataset, Hdf5Element, Hdf5File, Hdf5Value};
pub use named::{Array, ArrayFile};
pub use npy::{NpyFile, npy_bytes, npy_header, npy_numbers};
pub use npz::{NamedArray, write_npz};
pub use png::{Png, grey_png_bytes, grey16_png_bytes, png_bytes, write_png};
pub use remarks::Remarks;
pub use shape::ANY;
