//! Random numbers that are bit-equal to numpy's default_rng, and the query plan made from them.
