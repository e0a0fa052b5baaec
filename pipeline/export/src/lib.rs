//! Files of other programs, written and read.
//!
//! | module | what | page |
//! |---|---|---|
//! | [`nerfstudio`] | camera paths of its viewer | `docs/export.md` |

mod error;
pub mod nerfstudio;

pub use error::{Error, Result};
