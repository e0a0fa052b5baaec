//! HDF5 files: everything that a file of a stranger lists is read, as numbers, texts and byte strings.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use rogs_arrays::{Hdf5Dataset, Hdf5File};

/// Objects that are read of one file: groups may hold themselves.
const OBJECTS: usize = 64;

fuzz_target!(|bytes: &[u8]| {
    let Ok(file) = Hdf5File::from_bytes(Path::new("a.h5"), bytes.to_vec()) else {
        return;
    };
    let mut groups = vec![String::new()];
    let mut seen = 0;
    while let Some(group) = groups.pop() {
        let _ = file.attributes(&group);
        let below = |name: &String| {
            if group.is_empty() {
                name.clone()
            } else {
                format!("{group}/{name}")
            }
        };
        for name in file.datasets(&group).unwrap_or_default() {
            seen += 1;
            if seen < OBJECTS
                && let Ok(Some(dataset)) = file.dataset(&below(&name))
            {
                read(&dataset);
            }
        }
        for name in file.groups(&group).unwrap_or_default() {
            seen += 1;
            if seen < OBJECTS {
                groups.push(below(&name));
            }
        }
    }
});

fn read(dataset: &Hdf5Dataset<'_>) {
    let count = dataset
        .shape()
        .iter()
        .try_fold(1_usize, |product, &length| product.checked_mul(length));
    if let Ok(values) = dataset.read::<f64>() {
        assert_eq!(Some(values.len()), count);
    }
    let _ = dataset.read::<u8>();
    let rows = dataset.shape().first().copied().unwrap_or(0).min(2);
    let _ = dataset.read_rows::<i64>(0..rows);
    let _ = dataset.texts();
    let _ = dataset.byte_strings();
    let _ = dataset.attributes();
}
