//! Video through the programs `ffprobe` and `ffmpeg`: no system library is linked.
//!
//! Frames are taken by their number, never by time, and decoding stops behind the last one needed. The programs read
//! one local file in a known container format and nothing else.

#[cfg(any(not(feature = "libav"), test))]
use std::io::Read as _;
use std::path::Path;
#[cfg(any(not(feature = "libav"), test))]
use std::process::Stdio;

#[cfg(any(not(feature = "libav"), test))]
use rogs_video::program::{FFMPEG, Running, heard, listen};
use rogs_video::program::{FFPROBE, INSTALL, command, last_line, url};
use rogs_worker::{StageError, StageResult};
use serde::Deserialize;

use crate::fault::{io_error, wrong};
use crate::media::VideoInfo;

/// Largest side of a video, pixels.
const MAX_SIDE: u32 = 8192;
/// Most pixels of a frame.
const MAX_PIXELS: u64 = 40_000_000;
/// Container formats that are opened.
const FORMATS: &str = "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi";

#[derive(Deserialize)]
struct Probe {
    #[serde(default)]
    streams: Vec<ProbeStream>,
    #[serde(default)]
    packets: Vec<Packet>,
}

/// One encoded frame.
#[derive(Deserialize)]
struct Packet {
    /// Seconds at which it is shown; some containers do not say it for every frame.
    pts_time: Option<String>,
    #[serde(default)]
    flags: String,
}

#[derive(Deserialize)]
struct ProbeStream {
    #[serde(default)]
    codec_name: String,
    width: Option<u32>,
    height: Option<u32>,
    nb_frames: Option<String>,
    avg_frame_rate: Option<String>,
    sample_aspect_ratio: Option<String>,
    #[serde(default)]
    side_data_list: Vec<SideData>,
}

#[derive(Deserialize)]
struct SideData {
    /// Degrees against the clock; some versions of the program write whole numbers, some fractions.
    rotation: Option<f64>,
}

/// Reads a video file's header and counts its frames.
pub(crate) fn probe(path: &Path) -> StageResult<VideoInfo> {
    // Not a pipe, nor a device.
    rogs_files::open(path).map_err(|error| io_error(path, &error))?;
    let mut command = command(FFPROBE);
    command.args(["-protocol_whitelist", "file", "-format_whitelist", FORMATS]);
    command.args(["-select_streams", "v:0", "-of", "json", "-show_entries"]);
    command.arg(
        "stream=codec_name,width,height,nb_frames,avg_frame_rate,sample_aspect_ratio:stream_side_data=rotation:packet=pts_time,flags",
    );
    command.arg(url(path));
    let output = command.output().map_err(|error| no_program(FFPROBE, &error))?;
    let problem = last_line(&output.stderr);
    if !output.status.success() {
        return Err(wrong(path, format!("ffprobe cannot read the video: {problem}")));
    }
    let probe: Probe = serde_json::from_slice(&output.stdout)
        .map_err(|error| wrong(path, format!("ffprobe's answer is not readable: {error}")))?;
    let stream = probe
        .streams
        .first()
        .ok_or_else(|| wrong(path, "there is no video stream in it"))?;
    let (Some(width), Some(height)) = (stream.width, stream.height) else {
        return Err(wrong(path, "the video has no size"));
    };
    let sides = (1..=MAX_SIDE).contains(&width) && (1..=MAX_SIDE).contains(&height);
    if !sides || u64::from(width) * u64::from(height) > MAX_PIXELS {
        return Err(wrong(
            path,
            format!("frames of {width}x{height} pixels are larger than this program reads"),
        ));
    }
    let number = |text: &Option<String>| text.as_ref().and_then(|text| text.parse::<u64>().ok());
    let stored = probe.packets.len() as u64;
    if let Some(declared) = number(&stream.nb_frames)
        && declared != stored
    {
        return Err(wrong(
            path,
            format!("its header declares {declared} frames but it holds {stored}: it is cut off"),
        ));
    }
    let shown = shown_at(&probe.packets);
    let frames = shown.len() as u64;
    let quarter_turns = quarter_turns(stream).map_err(|what| wrong(path, what))?;
    let (width, height) = if quarter_turns % 2 == 1 {
        (height, width)
    } else {
        (width, height)
    };
    let fps = stream.avg_frame_rate.as_deref().and_then(rate).unwrap_or(0.0);
    Ok(VideoInfo {
        codec: stream.codec_name.clone(),
        width,
        height,
        frames,
        fps,
        quarter_turns,
        notes: notes(stream, quarter_turns)
            .into_iter()
            .chain(notes_of_times(stored, &shown))
            .collect(),
    })
}

/// Quarter turns of the display matrix.
fn quarter_turns(stream: &ProbeStream) -> Result<u32, String> {
    let degrees = stream
        .side_data_list
        .iter()
        .find_map(|data| data.rotation)
        .unwrap_or(0.0);
    let quarters = degrees / 90.0;
    if (quarters - quarters.round()).abs() > 1e-3 || quarters.abs() > 8.0 {
        return Err(format!(
            "its display matrix turns it by {degrees} degrees; save it turned (`ffmpeg -i IN OUT` does)"
        ));
    }
    Ok(quarters.round().rem_euclid(4.0) as u32)
}

/// When each frame is shown that an edit list does not hide, in seconds as far as the file says so. Decoders leave out the
/// hidden ones.
fn shown_at(packets: &[Packet]) -> Vec<Option<f64>> {
    let shown = packets.iter().filter(|packet| !packet.flags.contains('D'));
    shown
        .map(|packet| {
            packet
                .pts_time
                .as_ref()?
                .parse()
                .ok()
                .filter(|time: &f64| time.is_finite())
        })
        .collect()
}

/// What the times of the frames say that counting them does not: hidden frames, a late start, gaps.
fn notes_of_times(stored: u64, shown: &[Option<f64>]) -> Vec<String> {
    /// Encoders with reordered frames begin a few frames late, seconds.
    const LATE: f64 = 0.25;
    let mut notes = Vec::new();
    let hidden = stored - shown.len() as u64;
    if hidden > 0 {
        notes.push(format!(
            "its edit list hides {hidden} of its {stored} frames: they are left out, as players do"
        ));
    }
    let Some(mut times) = shown.iter().copied().collect::<Option<Vec<f64>>>() else {
        return notes;
    };
    times.sort_by(f64::total_cmp);
    if let Some(&first) = times.first().filter(|first| **first > LATE) {
        notes.push(format!(
            "its first frame is shown at {first:.3} s: frames are taken by number, so the first belongs to row 0"
        ));
    }
    let steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let mut sorted = steps.clone();
    sorted.sort_by(f64::total_cmp);
    let Some(&usual) = sorted.get(sorted.len() / 2) else {
        return notes;
    };
    let gaps = steps.iter().filter(|step| **step > 1.5 * usual).count();
    let longest = steps.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
    if let Some((before, step)) = longest.filter(|_| gaps > 0) {
        notes.push(format!(
            "its times leave {gaps} gaps, the longest of {step:.3} s before frame {}, where frames are usually {usual:.3} s \
             apart: frames are taken by number",
            before + 1
        ));
    }
    notes
}

/// What the file says about how it is to be shown.
fn notes(stream: &ProbeStream, quarter_turns: u32) -> Vec<String> {
    let turned = (quarter_turns > 0).then(|| {
        format!(
            "its display matrix says that it is rotated by {} degrees: images are turned, as players show them",
            90 * quarter_turns
        )
    });
    let odd = |aspect: &&String| !matches!(aspect.as_str(), "1:1" | "0:1" | "N/A" | "");
    let aspect = stream.sample_aspect_ratio.as_ref().filter(odd).map(|aspect| {
        format!(
            "its pixels have the aspect {aspect}: images are read as stored, intrinsics must be those of stored pixels"
        )
    });
    turned.into_iter().chain(aspect).collect()
}

/// Decodes `count` frames, `first`, `first + step`, ..., and hands each to `take` as RGB. `[h, w, 3]`
///
/// Returns what the decoder complained about, if anything.
pub(crate) fn decode(
    path: &Path,
    info: &VideoInfo,
    (first, step, count): (u64, u64, u64),
    take: impl FnMut(u64, &[u8]) -> StageResult<()>,
) -> StageResult<Option<String>> {
    let last = first + (count.max(1) - 1) * step;
    if last >= info.frames {
        return Err(wrong(
            path,
            format!("frame {last} is needed but the video has {} frames", info.frames),
        ));
    }
    #[cfg(feature = "libav")]
    if info.quarter_turns != 0 {
        return Err(wrong(
            path,
            "it is rotated by its display matrix, which builds with `libav` do not read",
        )
        .with_hint("save it turned (`ffmpeg -i IN OUT` does)"));
    }
    #[cfg(feature = "libav")]
    return crate::video_libav::decode(path, info, (first, step, count), take);
    #[cfg(not(feature = "libav"))]
    decode_by_program(path, info, (first, step, count), take)
}

/// [`decode`] with the program `ffmpeg`.
#[cfg(any(not(feature = "libav"), test))]
fn decode_by_program(
    path: &Path,
    info: &VideoInfo,
    (first, step, count): (u64, u64, u64),
    mut take: impl FnMut(u64, &[u8]) -> StageResult<()>,
) -> StageResult<Option<String>> {
    let mut command = command(FFMPEG);
    command.args(["-nostdin", "-xerror"]);
    if info.quarter_turns == 0 {
        command.arg("-noautorotate");
    }
    command.args(["-protocol_whitelist", "file", "-format_whitelist", FORMATS]);
    command.arg("-i").arg(url(path)).args(["-map", "0:v:0"]);
    command.args(["-vf", &format!("select='gte(n,{first})*not(mod(n-{first},{step}))'")]);
    command.args(["-fps_mode", "passthrough", "-frames:v", &count.to_string()]);
    command.args(["-sws_flags", "bilinear+accurate_rnd+full_chroma_int+bitexact"]);
    command.args(["-pix_fmt", "rgb24", "-f", "rawvideo", "pipe:1"]);
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = Running(command.spawn().map_err(|error| no_program(FFMPEG, &error))?);
    let (Some(mut frames), Some(complaints)) = (child.0.stdout.take(), child.0.stderr.take()) else {
        return Err(StageError::internal("ffmpeg was started without pipes"));
    };
    let complaints = listen(complaints);
    let mut frame = vec![0; info.width as usize * info.height as usize * 3];
    let mut decoded = 0;
    let mut failure = None;
    while decoded < count {
        match frames.read_exact(&mut frame) {
            Ok(()) => take(decoded, &frame)?,
            Err(error) => {
                failure = Some(error);
                break;
            }
        }
        decoded += 1;
    }
    let surplus = failure.is_none() && frames.read(&mut [0; 1]).is_ok_and(|bytes| bytes > 0);
    drop(frames);
    let status = child.0.wait().map_err(|error| no_program(FFMPEG, &error))?;
    let complaints = heard(complaints);
    let problem = last_line(&complaints);
    if failure.is_some() || surplus || !status.success() {
        let at = first + decoded * step;
        let text = format!(
            "decoding stopped at frame {at} of {}, {decoded} of {count} frames came: {problem}",
            info.frames
        );
        return Err(wrong(path, text));
    }
    Ok((!complaints.is_empty()).then_some(problem))
}

fn rate(text: &str) -> Option<f64> {
    let (over, under) = text.split_once('/')?;
    let value = over.parse::<f64>().ok()? / under.parse::<f64>().ok()?;
    (value.is_finite() && value > 0.0).then_some(value)
}

fn no_program(name: &str, error: &std::io::Error) -> StageError {
    StageError::bad_input(format!("the program `{name}` cannot be run: {error}")).with_hint(INSTALL)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The library gives the frames that the program gives, byte for byte.
    #[cfg(feature = "libav")]
    #[rogs_needs::needs(shared, ffmpeg)]
    #[test]
    fn libavcodec_and_the_program_agree() {
        let path = rogs_needs::shared!("data/droid_ctrlworld/new_setup/videos/0007/0.mp4");
        let info = probe(&path).unwrap();
        let range = (3, 4, 5);
        let mut by_library = Vec::new();
        let mut by_program = Vec::new();
        crate::video_libav::decode(&path, &info, range, |_, frame| {
            by_library.push(frame.to_vec());
            Ok(())
        })
        .unwrap();
        decode_by_program(&path, &info, range, |_, frame| {
            by_program.push(frame.to_vec());
            Ok(())
        })
        .unwrap();
        assert_eq!(by_library.len(), 5);
        assert!(by_library == by_program, "frames differ");
    }

    #[test]
    fn what_a_video_says_about_its_display_is_honoured_or_told() {
        let stream =
            |rest: &str| serde_json::from_str::<ProbeStream>(&format!("{{\"codec_name\":\"h264\"{rest}}}")).unwrap();
        let rotated = |degrees: &str| stream(&format!(",\"side_data_list\":[{{}},{{\"rotation\":{degrees}}}]"));
        for (degrees, expected) in [
            ("0", 0),
            ("-90", 3),
            ("90", 1),
            ("-180", 2),
            ("180", 2),
            ("270.0", 3),
            ("-450", 3),
        ] {
            assert_eq!(quarter_turns(&rotated(degrees)), Ok(expected), "{degrees}");
        }
        assert!(quarter_turns(&rotated("45")).unwrap_err().contains("45 degrees"));
        assert_eq!(quarter_turns(&stream("")), Ok(0));
        assert_eq!(notes(&stream(""), 0), Vec::<String>::new());
        assert!(notes(&stream(""), 2)[0].contains("rotated by 180"));
        assert!(notes(&stream(",\"sample_aspect_ratio\":\"4:3\""), 0)[0].contains("4:3"));
        for square in ["1:1", "0:1", "N/A"] {
            assert!(notes(&stream(&format!(",\"sample_aspect_ratio\":\"{square}\"")), 0).is_empty());
        }
    }

    #[test]
    fn edit_lists_late_starts_and_gaps_are_told() {
        let packets = |times: &[(f64, &str)]| -> Vec<Packet> {
            let packet = |(time, flags): &(f64, &str)| Packet {
                pts_time: Some(time.to_string()),
                flags: (*flags).to_owned(),
            };
            times.iter().map(packet).collect()
        };
        let told = |times: &[(f64, &str)]| {
            let packets = packets(times);
            let shown = shown_at(&packets);
            (shown.len(), notes_of_times(packets.len() as u64, &shown))
        };
        assert_eq!(
            told(&[(0.0, "K_"), (0.2, "__"), (0.1, "__")]),
            (3, vec![]),
            "reordered frames"
        );
        let (frames, notes) = told(&[(-0.1, "KD"), (0.0, "__"), (0.1, "__")]);
        assert_eq!(frames, 2);
        assert!(notes[0].contains("hides 1 of its 3 frames"), "{notes:?}");
        let (_, notes) = told(&[(0.5, "K_"), (0.6, "__"), (0.7, "__")]);
        assert!(notes[0].contains("first frame is shown at 0.500 s"), "{notes:?}");
        let (_, notes) = told(&[(0.0, "K_"), (0.1, "__"), (0.2, "__"), (0.6, "__"), (0.7, "__")]);
        assert!(
            notes[0].contains("1 gaps, the longest of 0.400 s before frame 3"),
            "{notes:?}"
        );
        let silent = Packet {
            pts_time: None,
            flags: String::new(),
        };
        assert_eq!(
            notes_of_times(1, &shown_at(&[silent])),
            Vec::<String>::new(),
            "AVI does not say"
        );
    }

    #[test]
    fn rates_are_fractions() {
        assert_eq!(rate("30000/1001"), Some(30000.0 / 1001.0));
        assert_eq!(rate("0/0"), None);
        assert_eq!(rate("x"), None);
    }
}
