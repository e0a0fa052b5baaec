//! Depth in OpenEXR files: one part, channel `Z` (or the only channel), floating point, metres.

use std::path::Path;

use rogs_flat_exr::{ExrError, FlatExr};
use rogs_worker::StageResult;

use crate::checks::{io_error, wrong};

/// The channel of depth, as the format's own description names it.
const DEPTH_CHANNEL: &str = "Z";

/// The depth of an OpenEXR file of the expected size (width, height), metres. `[h, w]`
pub(crate) fn read_exr(path: &Path, (width, height): (u32, u32)) -> StageResult<Vec<f64>> {
    let bad = |error: ExrError| match error {
        ExrError::Read(error) => io_error(path, &error),
        other => wrong(path, other),
    };
    let image = FlatExr::open(path).map_err(bad)?;
    if (image.width, image.height) != (width as usize, height as usize) {
        let what = format!(
            "the image is {}x{}, the episode says {width}x{height}",
            image.width, image.height
        );
        return Err(wrong(path, what));
    }
    if !image.whole {
        return Err(wrong(
            path,
            "data window and display window differ; save the whole image",
        ));
    }
    let channel = depth_channel(&image).map_err(|what| wrong(path, what))?;
    let planes = image.planes(&[channel]).map_err(bad)?;
    Ok(planes.into_iter().flatten().map(f64::from).collect())
}

/// The position of the depth channel.
fn depth_channel(image: &FlatExr) -> Result<usize, String> {
    let only = (image.channels.len() == 1).then_some(0);
    only.or_else(|| image.position(DEPTH_CHANNEL)).ok_or_else(|| {
        format!(
            "none of its channels ({}) is `{DEPTH_CHANNEL}`; name the depth so or save it alone",
            image.channels.join(", ")
        )
    })
}
