//! Headers of safetensors files. The reader is taken by its path, since the crate it belongs to takes long to build.
#![no_main]

#[allow(dead_code, unreachable_pub)]
#[path = "../../../pipeline/weights/src/header.rs"]
mod header;

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Some((length, rest)) = bytes.split_first_chunk::<8>() else {
        return;
    };
    let length = u64::from_le_bytes(*length);
    if length > rest.len() as u64 {
        return;
    }
    let (text, data) = rest.split_at(length as usize);
    match header::parse(text, data.len()) {
        Ok((tensors, _)) => assert!(tensors.len() <= text.len()),
        Err(reason) => assert!(!reason.is_empty()),
    }
});
