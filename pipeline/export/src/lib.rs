//! Files of other programs, written and read.
//!
//! | module | what | page |
//! |---|---|---|
//! | [`nerfstudio`] | camera paths of its viewer | `docs/films.md` |

mod error;
pub mod nerfstudio;

pub use error::{Error, Result};
