//! Gaussian PLY files.
#![no_main]

use libfuzzer_sys::fuzz_target;
use rogs_field::read_ply;

fuzz_target!(|bytes: &[u8]| {
    if let Err(error) = read_ply(bytes) {
        assert!(!error.to_string().is_empty());
    }
});
