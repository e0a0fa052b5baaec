//! The training objective of Stage 2.
