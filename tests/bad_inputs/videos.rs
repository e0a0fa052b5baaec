//! Video files.

use std::process::Command;

use crate::cases::{Cases, Failure, GOOD, Nothing, Said, edit};

/// True when the `ffmpeg` here can encode so.
fn encodes(encoder: &str) -> bool {
    let output = Command::new("ffmpeg").args(["-v", "error", "-encoders"]).output();
    output.is_ok_and(|output| String::from_utf8_lossy(&output.stdout).contains(&format!(" {encoder} ")))
}

#[test]
fn videos() {
    let has = |program: &str| {
        Command::new(program)
            .arg("-version")
            .output()
            .is_ok_and(|output| output.status.success())
    };
    if !has("ffmpeg") || !has("ffprobe") {
        eprintln!("skipped: no ffmpeg here");
        return;
    }
    let mut cases = Cases::new();
    let mut video = |name: &str, said: Said, options: &[&str], damage: &dyn Fn(&mut Vec<u8>)| {
        let folder = cases.add(name, said);
        let file = if options.contains(&"ffv1") {
            "wrist.mkv"
        } else {
            "wrist.mp4"
        };
        let path = folder.join(file);
        let output = Command::new("ffmpeg")
            .args([
                "-v",
                "error",
                "-framerate",
                "15",
                "-i",
                "wrist/%06d.png",
                "-pix_fmt",
                "yuv420p",
            ])
            .args(options)
            .arg(file)
            .current_dir(&folder)
            .output()
            .unwrap();
        assert!(
            output.status.success(),
            "{name}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        let mut bytes = std::fs::read(&path).unwrap();
        damage(&mut bytes);
        std::fs::write(path, bytes).unwrap();
        edit(&folder, |episode| episode["cameras"][0]["images"] = file.into());
    };
    // MPEG-4 part 2 is in every build of ffmpeg. The order of decoding differs from that of showing: B-frames.
    let plain = ["-c:v", "mpeg4", "-q:v", "2", "-bf", "2"];
    video("video", Nothing, &plain, &|_| {});
    video(
        "whole-later",
        Failure("wrist.mp4`: ffprobe cannot read the video", ""),
        &plain,
        &|bytes| bytes.truncate(bytes.len() / 2),
    );
    video(
        "empty",
        Failure("wrist.mp4`: ffprobe cannot read the video", ""),
        &plain,
        &Vec::clear,
    );
    let shorter = [&plain[..], &["-frames:v", "16"]].concat();
    video(
        "shorter",
        Failure("it has 16 frames, the episode 17", ""),
        &shorter,
        &|_| {},
    );
    let longer = [&plain[..], &["-vf", "tpad=stop=2"]].concat();
    video(
        "longer",
        Failure("it has 19 frames, the episode 17", ""),
        &longer,
        &|_| {},
    );
    let other = [&plain[..], &["-vf", "scale=112:84"]].concat();
    video(
        "other-size",
        Failure("images are 112x84, the episode says 56x42", ""),
        &other,
        &|_| {},
    );
    // Frames are taken by number: a rate that varies moves none.
    let varies = [
        &plain[..],
        &[
            "-vf",
            "setpts=N*N/15/TB/10",
            "-fps_mode",
            "vfr",
            "-enc_time_base",
            "1/60000",
        ],
    ]
    .concat();
    video("varies", Nothing, &varies, &|_| {});
    // Refused by what it declares, before a frame is decoded.
    let huge = ["-c:v", "ffv1", "-vf", "scale=30000:20"];
    video(
        "huge",
        Failure("frames of 30000x20 pixels are larger than this program reads", ""),
        &huge,
        &|_| {},
    );
    // H.264, as most datasets have it. The index (`moov`) lies at the end of a file, or at its front for streaming.
    let mut whole = vec!["video", "varies"];
    if encodes("libx264") {
        let h264 = ["-c:v", "libx264", "-bf", "2", "-g", "5"];
        let streamed = [&h264[..], &["-movflags", "+faststart"]].concat();
        let at = |bytes: &[u8], name: &[u8]| bytes.windows(4).position(|window| window == name).unwrap();
        video("h264", Nothing, &h264, &|_| {});
        whole.push("h264");
        video(
            "h264-no-moov",
            Failure("wrist.mp4`: ffprobe cannot read the video", ""),
            &h264,
            &|bytes| bytes.truncate(at(bytes, b"moov") - 4),
        );
        video("h264-moov-begins", Failure("wrist.mp4`: ", ""), &h264, &|bytes| {
            bytes.truncate(at(bytes, b"moov") + 200);
        });
        video(
            "h264-moov-cut",
            Failure("wrist.mp4`: ffprobe cannot read the video", ""),
            &h264,
            &|bytes| bytes.truncate(bytes.len() - 100),
        );
        // The index is whole, the pictures are not: the frames that came are not taken for the clip.
        video(
            "h264-cut",
            Failure("its header declares 17 frames but it holds ", ""),
            &streamed,
            &|bytes| {
                let data = at(bytes, b"mdat");
                bytes.truncate(data + (bytes.len() - data) * 6 / 10);
            },
        );
        video(
            "h264-damaged",
            Failure("wrist.mp4`: decoding stopped at frame ", ""),
            &streamed,
            &|bytes| {
                let middle = (at(bytes, b"mdat") + bytes.len()) / 2;
                bytes[middle - 200..middle + 200]
                    .iter_mut()
                    .for_each(|byte| *byte ^= 0xff);
            },
        );
    } else {
        eprintln!("without H.264: this ffmpeg has no libx264");
    }
    cases.check();
    let rgb = |clip: &str| {
        let path = cases.workspace.path(&format!("run/clips/{clip}/clip.r4c"));
        let (clip, _) = rogs_schemas::read_record::<rogs_schemas::records::clip::Clip>(&path).unwrap();
        clip.cameras[0].rgb.clone().unwrap()
    };
    // Every frame is the one of its number, up to what the encoder lost: one frame off fits much worse.
    let good = rgb(GOOD);
    let area = good.len() / 17;
    for clip in whole {
        let frames = rgb(clip);
        let difference = |shift: isize| -> u64 {
            let of_frame = |frame: usize| -> u64 {
                let other = frame.saturating_add_signed(shift).min(16);
                let (a, b) = (&frames[frame * area..][..area], &good[other * area..][..area]);
                a.iter().zip(b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum()
            };
            (0..17).map(of_frame).sum()
        };
        let aligned = difference(0);
        for shift in [-1, 1] {
            let shifted = difference(shift);
            assert!(
                2 * shifted > 3 * aligned,
                "{clip}: {aligned} aligned, {shifted} shifted by {shift}"
            );
        }
    }
}
