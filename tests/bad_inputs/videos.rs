//! Video files.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::{Path, PathBuf};
use std::process::Command;

use rogs_needs::needs;

use crate::cases::{Cases, Failure, GOOD, Nothing, Said, Warning, edit};

/// MPEG-4 part 2 is in every build of ffmpeg. The order of decoding differs from that of showing: B-frames.
const PLAIN: [&str; 6] = ["-c:v", "mpeg4", "-q:v", "2", "-bf", "2"];

/// H.264, as most datasets have it. The index (`moov`) lies at the end of the file.
const H264: [&str; 6] = ["-c:v", "libx264", "-bf", "2", "-g", "5"];

/// The same with the index at the front, for streaming.
const STREAMED: [&str; 8] = ["-c:v", "libx264", "-bf", "2", "-g", "5", "-movflags", "+faststart"];

/// Makes the wrist camera of an episode a video of its images; returns its path.
fn encode(folder: &Path, file: &str, options: &[&str]) -> PathBuf {
    let common = "-v error -framerate 15 -i wrist/%06d.png -pix_fmt yuv420p";
    let output = Command::new("ffmpeg")
        .args(common.split(' '))
        .args(options)
        .arg(file)
        .current_dir(folder)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}: {said}", folder.display());
    edit(folder, |episode| episode["cameras"][0]["images"] = file.into());
    folder.join(file)
}

/// Adds an episode whose wrist camera is a video with a damage.
fn video(cases: &mut Cases, name: &str, said: Said, options: &[&str], damage: impl FnOnce(&mut Vec<u8>)) {
    let path = encode(&cases.add(name, said), "wrist.mp4", options);
    let mut bytes = std::fs::read(&path).unwrap();
    damage(&mut bytes);
    std::fs::write(path, bytes).unwrap();
}

fn whole(_: &mut Vec<u8>) {}

/// Where the box `name` of an MP4 file has its name.
fn at(bytes: &[u8], name: &[u8]) -> usize {
    bytes.windows(4).position(|window| window == name).unwrap()
}

const UNREADABLE: Said = Failure("wrist.mp4`: ffprobe cannot read the video", "");

#[needs(ffmpeg)]
#[test]
fn every_frame_is_the_one_of_its_number() {
    let mut cases = Cases::new();
    video(&mut cases, "video", Nothing, &PLAIN, whole);
    // Frames are taken by number: a rate that varies moves none, and is said.
    let varies = "-vf setpts=N*N/15/TB/10 -fps_mode vfr -enc_time_base 1/60000".split(' ');
    let varies: Vec<&str> = PLAIN.into_iter().chain(varies).collect();
    video(&mut cases, "varies", Warning("its times leave 3 gaps"), &varies, whole);
    cases.check();
    for clip in ["video", "varies"] {
        assert_aligned(&cases, clip);
    }
}

#[needs(ffmpeg)]
#[test]
fn a_video_that_is_cut_or_empty_is_refused() {
    let mut cases = Cases::new();
    video(&mut cases, "whole-later", UNREADABLE, &PLAIN, |bytes| {
        bytes.truncate(bytes.len() / 2);
    });
    video(&mut cases, "empty", UNREADABLE, &PLAIN, Vec::clear);
    cases.check();
}

#[needs(ffmpeg)]
#[test]
fn a_video_of_another_length_is_refused() {
    let mut cases = Cases::new();
    let of = |options: [&'static str; 2]| PLAIN.into_iter().chain(options).collect::<Vec<_>>();
    let shorter = Failure("it has 16 frames, the episode 17", "");
    video(&mut cases, "shorter", shorter, &of(["-frames:v", "16"]), whole);
    let longer = Failure("it has 19 frames, the episode 17", "");
    video(&mut cases, "longer", longer, &of(["-vf", "tpad=stop=2"]), whole);
    cases.check();
}

#[needs(ffmpeg)]
#[test]
fn a_video_of_another_size_is_refused() {
    let mut cases = Cases::new();
    let scaled: Vec<&str> = PLAIN.into_iter().chain(["-vf", "scale=112:84"]).collect();
    let other = Failure("images are 112x84, the episode says 56x42", "");
    video(&mut cases, "other-size", other, &scaled, whole);
    cases.check();
}

/// By what it declares, before a frame is decoded.
#[needs(ffmpeg)]
#[test]
fn a_huge_video_is_refused() {
    let mut cases = Cases::new();
    let huge = Failure("frames of 30000x20 pixels are larger than this program reads", "");
    let folder = cases.add("huge", huge);
    encode(&folder, "wrist.mkv", &["-c:v", "ffv1", "-vf", "scale=30000:20"]);
    cases.check();
}

#[needs(ffmpeg, libx264)]
#[test]
fn h264_is_read() {
    let mut cases = Cases::new();
    video(&mut cases, "h264", Nothing, &H264, whole);
    cases.check();
    assert_aligned(&cases, "h264");
}

#[needs(ffmpeg, libx264)]
#[test]
fn h264_without_its_index_is_refused() {
    let mut cases = Cases::new();
    video(&mut cases, "h264-no-moov", UNREADABLE, &H264, |bytes| {
        bytes.truncate(at(bytes, b"moov") - 4);
    });
    let begins = Failure("wrist.mp4`: ", "");
    video(&mut cases, "h264-moov-begins", begins, &H264, |bytes| {
        bytes.truncate(at(bytes, b"moov") + 200);
    });
    video(&mut cases, "h264-moov-cut", UNREADABLE, &H264, |bytes| {
        bytes.truncate(bytes.len() - 100);
    });
    cases.check();
}

/// The index is whole, the pictures are not: the frames that came are not taken for the clip.
#[needs(ffmpeg, libx264)]
#[test]
fn h264_whose_pictures_are_cut_or_damaged_is_refused() {
    let mut cases = Cases::new();
    let cut = Failure("its header declares 17 frames but it holds ", "");
    video(&mut cases, "h264-cut", cut, &STREAMED, |bytes| {
        let data = at(bytes, b"mdat");
        bytes.truncate(data + (bytes.len() - data) * 6 / 10);
    });
    let damaged = Failure("wrist.mp4`: decoding stopped at frame ", "");
    video(&mut cases, "h264-damaged", damaged, &STREAMED, |bytes| {
        let middle = (at(bytes, b"mdat") + bytes.len()) / 2;
        bytes[middle - 200..middle + 200]
            .iter_mut()
            .for_each(|byte| *byte ^= 0xff);
    });
    cases.check();
}

/// Every frame fits the image of its number, up to what the encoder lost: one frame off fits much worse.
fn assert_aligned(cases: &Cases, clip: &str) {
    let rgb = |clip: &str| {
        let path = cases.workspace.path(&format!("run/clips/{clip}/clip.r4c"));
        let (clip, _) = rogs_r4c::read_record::<rogs_schemas::records::clip::Clip>(&path).unwrap();
        clip.cameras[0].recorded.clone().unwrap()
    };
    let (good, frames) = (rgb(GOOD), rgb(clip));
    let area = good.len() / 17;
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
