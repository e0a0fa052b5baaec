//! Decoding in this process with libavcodec (cargo feature `libav`).
//!
//! The same frames as the `ffmpeg` program gives, byte for byte where both are the same release: frames are counted, not
//! timed, the conversion to RGB has the same flags, and decoding stops behind the last frame needed. It saves the start of
//! a process per video.

use std::path::Path;

use ffmpeg_next as ffmpeg;
use ffmpeg_next::util::frame::Video;
use rogs_worker::StageResult;

use crate::fault::wrong;
use crate::media::VideoInfo;

/// Conversion to packed RGB, as in [`crate::video::decode`].
const TO_RGB: &str = "scale=flags=bilinear+accurate_rnd+full_chroma_int+bitexact,format=rgb24";

/// Decodes `count` frames, `first`, `first + step`, ..., and hands each to `take` as RGB. `[h, w, 3]`
///
/// # Errors
/// When the file cannot be decoded up to the last frame asked for; the message names the frame.
pub(crate) fn decode(
    path: &Path,
    info: &VideoInfo,
    (first, step, count): (u64, u64, u64),
    mut take: impl FnMut(u64, &[u8]) -> StageResult<()>,
) -> StageResult<Option<String>> {
    let mut frames = Frames {
        path,
        info,
        first,
        step,
        count,
        seen: 0,
        taken: 0,
        converter: None,
    };
    let failed = |error: ffmpeg::Error| wrong(path, format!("libavcodec cannot read the video: {error}"));
    ffmpeg::init().map_err(failed)?;
    let mut input = ffmpeg::format::input(path).map_err(failed)?;
    let stream = input.streams().best(ffmpeg::media::Type::Video);
    let stream = stream.ok_or_else(|| wrong(path, "there is no video stream in it"))?;
    let (index, time_base) = (stream.index(), stream.time_base());
    let context = ffmpeg::codec::context::Context::from_parameters(stream.parameters()).map_err(failed)?;
    let mut decoder = context.decoder().video().map_err(failed)?;
    for (stream, packet) in input.packets() {
        if stream.index() != index {
            continue;
        }
        decoder.send_packet(&packet).map_err(failed)?;
        frames.drain(&mut decoder, time_base, &mut take)?;
        if frames.done() {
            return Ok(None);
        }
    }
    decoder.send_eof().map_err(failed)?;
    frames.drain(&mut decoder, time_base, &mut take)?;
    if frames.done() {
        return Ok(None);
    }
    let at = first + frames.taken * step;
    let text = format!(
        "decoding ended before frame {at} of {}, {} of {count} frames came",
        info.frames, frames.taken
    );
    Err(wrong(path, text))
}

/// Which frames are wanted and how far the video is.
struct Frames<'a> {
    path: &'a Path,
    info: &'a VideoInfo,
    first: u64,
    step: u64,
    count: u64,
    /// Frames that came out of the decoder, in the order of presentation.
    seen: u64,
    /// Frames handed on.
    taken: u64,
    converter: Option<ffmpeg::filter::Graph>,
}

impl Frames<'_> {
    fn done(&self) -> bool {
        self.taken == self.count
    }

    fn wanted(&self) -> bool {
        self.seen >= self.first && (self.seen - self.first).is_multiple_of(self.step.max(1)) && !self.done()
    }

    /// Takes what the decoder has ready.
    fn drain(
        &mut self,
        decoder: &mut ffmpeg::decoder::Video,
        time_base: ffmpeg::Rational,
        take: &mut impl FnMut(u64, &[u8]) -> StageResult<()>,
    ) -> StageResult<()> {
        let mut frame = Video::empty();
        while !self.done() && decoder.receive_frame(&mut frame).is_ok() {
            if self.wanted() {
                let rgb = self.convert(&frame, time_base)?;
                take(self.taken, &rgb)?;
                self.taken += 1;
            }
            self.seen += 1;
        }
        Ok(())
    }

    /// A frame as packed RGB rows. `[h, w, 3]`
    fn convert(&mut self, frame: &Video, time_base: ffmpeg::Rational) -> StageResult<Vec<u8>> {
        let (width, height) = (self.info.width, self.info.height);
        if (frame.width(), frame.height()) != (width, height) {
            let (found_w, found_h) = (frame.width(), frame.height());
            let text = format!(
                "frame {} has {found_w}x{found_h} pixels, the first had {width}x{height}",
                self.seen
            );
            return Err(wrong(self.path, text));
        }
        let path = self.path;
        let failed = |error: ffmpeg::Error| wrong(path, format!("libavfilter cannot convert the video: {error}"));
        if self.converter.is_none() {
            self.converter = Some(converter(frame, time_base).map_err(failed)?);
        }
        let missing = || wrong(path, "libavfilter lost its ends");
        let graph = self.converter.as_mut().ok_or_else(missing)?;
        graph
            .get("in")
            .ok_or_else(missing)?
            .source()
            .add(frame)
            .map_err(failed)?;
        let mut converted = Video::empty();
        graph
            .get("out")
            .ok_or_else(missing)?
            .sink()
            .frame(&mut converted)
            .map_err(failed)?;
        let (row, stride) = (width as usize * 3, converted.stride(0));
        let rows = converted.data(0).chunks(stride).take(height as usize);
        Ok(rows.flat_map(|line| line[..row].iter().copied()).collect())
    }
}

/// A graph that turns frames like this one into packed RGB, with the colour space that the frames declare.
fn converter(frame: &Video, time_base: ffmpeg::Rational) -> Result<ffmpeg::filter::Graph, ffmpeg::Error> {
    let find = |name: &str| ffmpeg::filter::find(name).ok_or(ffmpeg::Error::FilterNotFound);
    let mut graph = ffmpeg::filter::Graph::new();
    let format = ffmpeg::ffi::AVPixelFormat::from(frame.format()) as i32;
    let (width, height) = (frame.width(), frame.height());
    let (over, under) = (time_base.numerator().max(1), time_base.denominator().max(1));
    let arguments = format!("video_size={width}x{height}:pix_fmt={format}:time_base={over}/{under}:pixel_aspect=1/1");
    graph.add(&find("buffer")?, "in", &arguments)?;
    graph.add(&find("buffersink")?, "out", "")?;
    graph.output("in", 0)?.input("out", 0)?.parse(TO_RGB)?;
    graph.validate()?;
    Ok(graph)
}
