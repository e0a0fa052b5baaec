//! Rollouts of a small episode of three cameras: the first byte says the layout and the parameters, the others are the
//! PNG frames of its one or three folders, separated by a line of `====`.
#![no_main]

#[path = "common/place.rs"]
mod place;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use libfuzzer_sys::fuzz_target;
use rogs_ingest::{Observations, Params, RolloutLayout, RolloutParams, read_rollout};
use rogs_schemas::FrameIndex;

const CAMERAS: [&str; 3] = ["wrist", "ext1", "ext2"];
/// Width and height of the recorded images.
const SIZE: (u32, u32) = (8, 6);

/// Two frames of three cameras.
fn episode() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = place::folder().join("episode");
        let camera = |id: &str| {
            format!(
                r#"{{"id": "{id}", "role": "source", "images": "{id}", "width": 8, "height": 6,
                "intrinsics": {{"fx": 8.0, "fy": 8.0, "cx": 4.0, "cy": 3.0}},
                "mount": {{"fixed": {{"base_from_camera": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}}}}}}"#
            )
        };
        let text = format!(
            r#"{{"format": "rogs-episode 1", "episode_id": "E", "fps": 15.0, "frame_count": 2,
            "robot": {{"joint_names": ["j"], "states": "joints.csv"}}, "cameras": [{}]}}"#,
            CAMERAS.map(camera).join(", ")
        );
        for (index, id) in CAMERAS.iter().enumerate() {
            std::fs::create_dir_all(folder.join(id)).expect("a folder can be made");
            for frame in 0..2 {
                let name = folder.join(format!("{id}/{frame:06}.png"));
                let image: Vec<u8> = (0..8 * 6 * 3).map(|at| (40 * index + 9 * frame + at) as u8).collect();
                rogs_arrays::write_png(&name, SIZE, &image).expect("an image can be written");
            }
        }
        std::fs::write(folder.join("episode.json"), text).expect("a file can be written");
        std::fs::write(
            folder.join("joints.csv"),
            b"time,j,gripper\n0.0,0.1,0.0\n0.066,0.1,0.0\n",
        )
        .expect("a file can be written");
        folder
    })
}

fuzz_target!(|bytes: &[u8]| {
    let Some((&choice, mut rest)) = bytes.split_first() else {
        return;
    };
    let views = choice & 1 == 1;
    let rollout = place::folder().join(if views { "views" } else { "frames" });
    let mark = b"\n====\n";
    for id in CAMERAS {
        let folder = if views { rollout.join(id) } else { rollout.clone() };
        std::fs::create_dir_all(&folder).expect("a folder can be made");
        let end = rest.windows(mark.len()).position(|window| window == mark);
        let (piece, after) = end.map_or((rest, &[][..]), |end| (&rest[..end], &rest[end + mark.len()..]));
        std::fs::write(folder.join("000000.png"), piece).expect("an input can be written");
        rest = after;
        if !views {
            break;
        }
    }
    let layout = match (views, choice >> 1 & 3) {
        (true, 0) | (false, 0) => RolloutLayout::Auto,
        (true, _) => RolloutLayout::Views,
        (false, 1) => RolloutLayout::CtrlWorld,
        (false, _) => RolloutLayout::Composite,
    };
    let params = Params {
        frames: 1,
        source_frames: vec![FrameIndex(0)],
        height: SIZE.1,
        width: SIZE.0,
        observations: Observations::Rollout,
        rollout: RolloutParams {
            layout,
            // What a manifest may say: any four numbers.
            image_size: (choice & 8 != 0)
                .then(|| [0, 1, 2, 3].map(|at| u32::from(bytes.get(40 + at).copied().unwrap_or(9)))),
            min_first_frame_psnr_db: if choice & 16 != 0 { 20.0 } else { 0.001 },
            ..RolloutParams::default()
        },
        ..Params::default()
    };
    let _ = read_rollout(episode(), None, &rollout, &params, "clip");
});
