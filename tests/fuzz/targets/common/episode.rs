//! A small episode that other files are read beside.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::place;

/// Two frames of one camera.
const EPISODE: &str = r#"{"format": "rogs-episode 1", "episode_id": "E", "fps": 15.0, "frame_count": 2,
    "robot": {"joint_names": ["j"], "states": "joints.csv"},
    "cameras": [{"id": "a", "role": "source", "images": "a", "width": 8, "height": 6,
        "intrinsics": {"fx": 8.0, "fy": 8.0, "cx": 4.0, "cy": 3.0},
        "mount": {"fixed": {"base_from_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}}]}"#;

/// The folder of an episode of two frames of one camera.
pub fn one_camera() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = place::folder().join("episode");
        std::fs::create_dir_all(folder.join("a")).expect("a folder can be made");
        let write = |name: &str, bytes: &[u8]| std::fs::write(folder.join(name), bytes).expect("a file can be written");
        write("episode.json", EPISODE.as_bytes());
        write("joints.csv", b"time,j,gripper\n0.0,0.1,0.0\n0.066,0.1,0.0\n");
        for frame in 0..2 {
            let name = folder.join(format!("a/{frame:06}.png"));
            rogs_arrays::write_png(&name, (8, 6), &[7; 8 * 6 * 3]).expect("an image can be written");
        }
        folder
    })
}
