//! HDF5: groups, data sets of numbers, texts or byte strings, and attributes.
//!
//! The format is read by the crate `hdf5-reader` (pure Rust: superblocks 0 to 3, old and new groups, compact, contiguous
//! and chunked data; gzip, shuffle, Fletcher-32, szip, n-bit and scale-offset filters). What it lacks for files of h5py,
//! the LZF filter, is here; and so are the bounds: no read makes more of a file than its bytes can hold when packed as
//! densely as any filter packs ([`EXPANSION`]), links to other files are not followed, and a file that is shorter than
//! its header says is refused.
//!
//! ```no_run
//! use std::path::Path;
//! use rogs_arrays::{ANY, Hdf5File};
//!
//! let file = Hdf5File::open(Path::new("trajectory.h5"))?;
//! let joints = file.need("observation/robot_state/joint_positions")?;
//! joints.expect_shape(&[ANY, 7])?;
//! let values: Vec<f64> = joints.read()?;                      // all steps, row-major
//! let step: Vec<f64> = joints.read_rows(3..4)?;               // one, reading no other chunk
//! let success = file.attributes("")?.get("success").cloned(); // of the root
//! # Ok::<(), rogs_arrays::Error>(())
//! ```

mod attribute;
mod dataset;
mod element;
mod file;
mod lzf;

pub use attribute::Hdf5Value;
pub use dataset::Hdf5Dataset;
pub use element::Hdf5Element;
pub use file::Hdf5File;

/// Most bytes that one packed byte can become: the bound of deflate (258 bytes from two bits), rounded up.
const EXPANSION: u64 = 1040;
/// Most bytes of one read, whatever the file's length.
const MAX_READ: u64 = 1 << 30;
/// Largest unpacked chunk, bytes.
const MAX_CHUNK: usize = 1 << 27;
/// Largest object header, bytes.
const MAX_HEADER: usize = 1 << 22;
