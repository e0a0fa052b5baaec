//! Files for readers that want a path.
#![allow(dead_code)]

use std::path::{Path, PathBuf};

/// A folder of this process, in the place that `tests/fuzz/run` makes and removes.
pub fn folder() -> PathBuf {
    let root = std::env::var_os("ROGS_FUZZ_PLACE").map_or_else(std::env::temp_dir, PathBuf::from);
    let folder = root.join(format!("rogs-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for inputs");
    folder
}

/// The bytes as a file of the only name for its ending.
pub fn file(ending: &str, bytes: &[u8]) -> PathBuf {
    let path = folder().join(format!("input.{ending}"));
    std::fs::write(&path, bytes).expect("an input can be written");
    path
}

/// Reads a container as every record there is.
pub fn records(path: &Path) {
    use rogs_r4c::read_record;
    use rogs_schemas::records::{
        agreement, clip, conditioning, field, motion_bases, polynomial, progress, references, refinement, robot, scores,
    };

    let _ = read_record::<clip::Clip>(path);
    let _ = read_record::<robot::RobotMaps>(path);
    let _ = read_record::<conditioning::Conditioning>(path);
    let _ = read_record::<references::References>(path);
    let _ = read_record::<agreement::Agreements>(path);
    let _ = read_record::<field::Field>(path);
    let _ = read_record::<polynomial::PolynomialField>(path);
    let _ = read_record::<motion_bases::MotionBasisField>(path);
    let _ = read_record::<progress::Progress>(path);
    let _ = read_record::<refinement::Refinement>(path);
    let _ = read_record::<scores::Scores>(path);
}
