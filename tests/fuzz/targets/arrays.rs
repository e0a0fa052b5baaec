//! Arrays of strangers: the same bytes as `.npy`, `.npz`, `.safetensors` and PNG, and as the one member of an archive
//! that is whole, so that what is behind its checksum is reached.
#![no_main]

#[path = "common/place.rs"]
mod place;

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use rogs_arrays::{ANY, ArrayFile, NpyFile, Png, Remarks};

fuzz_target!(|bytes: &[u8]| {
    let folder = place::folder();
    let written = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        std::fs::write(&path, bytes).expect("an input can be written");
        path
    };
    read_npy(&written("a.npy", bytes));
    for name in ["a.npz", "a.safetensors"] {
        read_named(&written(name, bytes));
    }
    read_named(&written("member.npz", &archive(bytes)));
    if let Ok(png) = Png::open(&written("a.png", bytes))
        && u64::from(png.width) * u64::from(png.height) < 1 << 22
    {
        let _ = png.decode_grey16();
    }
    let remarks = Remarks::read(&mut std::io::Cursor::new(bytes)).expect("nothing but memory is read");
    let (width, height) = remarks.size((3, 2));
    assert_eq!(width * height, 6);
});

fn read_npy(path: &Path) {
    let Ok(mut file) = NpyFile::open(path) else { return };
    let count: usize = file.shape().iter().product();
    assert_eq!(file.all().expect("the length was checked").len(), count);
    let _ = file.expect_shape(&[ANY, ANY]);
    let _ = file.entry(0);
}

fn read_named(path: &Path) {
    let Ok(file) = ArrayFile::open(path) else { return };
    for name in file.names() {
        if let Ok(array) = file.need(&[&name]) {
            let count: usize = array.shape.iter().product();
            assert_eq!(array.into_floats().len(), count);
        }
    }
}

/// A ZIP archive of one stored member, with the right checksum.
fn archive(member: &[u8]) -> Vec<u8> {
    let length = (member.len() as u32).to_le_bytes();
    let mut common = vec![20, 0, 0, 0, 0, 0, 0, 0, 0x21, 0];
    common.extend(crc32fast::hash(member).to_le_bytes());
    common.extend([length, length].concat());
    common.extend([5, 0, 0, 0]);
    let mut bytes = [b"PK\x03\x04", common.as_slice(), b"a.npy", member].concat();
    let directory = [b"PK\x01\x02\x14\x00", common.as_slice(), &[0; 14], b"a.npy"].concat();
    let at = (bytes.len() as u32).to_le_bytes();
    bytes.extend(&directory);
    bytes.extend(b"PK\x05\x06\0\0\0\0\x01\0\x01\0");
    bytes.extend((directory.len() as u32).to_le_bytes());
    bytes.extend(at);
    bytes.extend([0, 0]);
    bytes
}
