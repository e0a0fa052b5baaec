//! The lifters inside the program.

use std::sync::OnceLock;

use rogs_schemas::records::robot::RobotMaps;
use rogs_weights::Bundled;

/// The bundled checkpoint for clips of robots: the `compact-sweep` network in bfloat16, trained on procedural clips only. Its
/// model card is `stages/lift/weights/README.md`.
pub static COMPACT_WEIGHTS: &[u8] = include_bytes!("../weights/compact-stage1.safetensors");

/// The same with its name: what a run takes that names no weights, for every clip in which a camera sees the robot.
pub static BUILTIN: Bundled = Bundled::new("compact-stage1.safetensors", COMPACT_WEIGHTS);

/// What such a run takes for the other clips: the `compact-wide` network, trained on wide worlds and rooms with sensor depth.
pub static BUILTIN_SCENES: Bundled = Bundled::new(
    "wide-stage1.safetensors",
    include_bytes!("../weights/wide-stage1.safetensors"),
);

/// Height and width of the images that [`BUILTIN`] was trained at, pixels.
pub const BUILTIN_SIZE: [u32; 2] = [84, 154];

/// Whether a source camera of a clip sees the robot, which is what [`BUILTIN`] finds its way by.
#[must_use]
pub fn sees_robot(robot: &RobotMaps) -> bool {
    let seen = |support: &[u8]| support.iter().any(|&supported| supported != 0);
    robot.maps.iter().any(|map| seen(&map.support))
}

/// The file with this hash, as a field names the weights that it was lifted with.
#[must_use]
pub fn builtin_of(hash: &str) -> Option<&'static Bundled> {
    [&BUILTIN, &BUILTIN_SCENES].into_iter().find(|file| file.hash() == hash)
}

/// Identity of all files together, in hex: outputs of other ones are not up to date.
pub(crate) fn builtin_hash() -> &'static str {
    static HASH: OnceLock<String> = OnceLock::new();
    HASH.get_or_init(|| {
        let all = [BUILTIN.hash(), BUILTIN_SCENES.hash()].concat();
        blake3::hash(all.as_bytes()).to_hex().to_string()
    })
}
