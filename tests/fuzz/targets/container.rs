//! Containers: any bytes, and parts put together with right checksums, so that what lies behind those is reached too.
#![no_main]

#[path = "common/parts.rs"]
mod parts;
#[path = "common/place.rs"]
mod place;

use libfuzzer_sys::fuzz_target;
use rogs_r4c::{Limits, Reader, inspect, verify};

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, rest)) = bytes.split_first() else {
        return;
    };
    let path = if *kind & 1 == 0 {
        place::file("r4c", rest)
    } else {
        let Some(file) = parts::Parts::from_input(rest).map(|parts| parts.file()) else {
            return;
        };
        place::file("r4c", &file)
    };
    let limits = Limits {
        decoded: 32 << 20,
        ..Limits::default()
    };
    let Ok(reader) = Reader::open_with(&path, limits) else {
        return;
    };
    for stream in reader.streams() {
        let count = reader.chunks(&stream.name).map_or(0, |chunks| chunks.len());
        for ordinal in 0..count {
            let _ = reader.chunk_bytes(&stream.name, ordinal);
        }
    }
    let _ = inspect(&path);
    let _ = verify(&path);
    place::records(&path);
});
