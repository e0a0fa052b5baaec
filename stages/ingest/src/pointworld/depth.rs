//! `UUID_depth.h5`: a group `SERIAL+ext` or `SERIAL+wrist` a camera, with `depth` (uint16 millimetres, 0 where invalid)
//! and `timestamps` (milliseconds).

use std::path::Path;

use rogs_arrays::{ANY, Hdf5Dataset, Hdf5File, Hdf5Value};
use rogs_schemas::records::origin::ReferenceOrigin;
use rogs_worker::StageResult;

use super::{camera_of, nearest, same_episode, serials};
use crate::fault::{unreadable, wrong};
use crate::source::{CachedDepth, Source, SourceDepth};

/// Where depth is scored unless the parameters say otherwise, metres.
const RANGE_M: [f32; 2] = [0.1, 5.0];
/// Depth of a scene never stays below this in millimetres; in metres it does.
const METRES_BELOW: u16 = 50;
/// Longest side of a map, pixels.
const MAX_SIDE: usize = 8192;

/// Adds the depth of every camera that the episode has.
pub(super) fn join(path: &Path, source: &mut Source, tolerance_ms: f64) -> StageResult<()> {
    let file = Hdf5File::open(path).map_err(unreadable)?;
    let metadata = file.attributes("metadata").map_err(unreadable)?;
    complete(
        metadata.get("write_complete").and_then(|value| value.truth()),
        "metadata",
        path,
    )?;
    if let Some(uuid) = metadata.get("uuid").and_then(|value| value.text()) {
        same_episode(uuid, source, path)?;
    }
    let stated = stated_origin(metadata.get("origin"), path)?;
    let groups = file.groups("").map_err(unreadable)?;
    let cameras: Vec<(&str, &str)> = groups.iter().filter_map(|group| group.split_once('+')).collect();
    if cameras.is_empty() {
        return Err(wrong(
            path,
            format!("it has no group SERIAL+ext or SERIAL+wrist: {}", groups.join(", ")),
        ));
    }
    let mut found = 0;
    for (serial, kind) in cameras {
        let Some(index) = camera_of(source, serial) else {
            let known = serials(source);
            source.warnings.push(format!(
                "`{}` has depth of camera `{serial}`, the episode has {known}",
                path.display()
            ));
            continue;
        };
        let group = format!("{serial}+{kind}");
        let depth = whole_dataset(&file, &format!("{group}/depth"))?;
        depth.expect_shape(&[ANY, ANY, ANY]).map_err(unreadable)?;
        if !depth.is_whole() {
            return Err(wrong(
                path,
                format!("`{group}/depth` holds fractions: expected whole millimetres (uint16)"),
            ));
        }
        let (frames, height, width) = (depth.shape()[0], depth.shape()[1], depth.shape()[2]);
        if ![height, width].iter().all(|side| (1..=MAX_SIDE).contains(side)) {
            let what = format!("`{group}/depth` has maps of {width}x{height} pixels: impossible");
            return Err(wrong(path, what));
        }
        let camera = &source.cameras[index];
        let aspect = |width: f64, height: f64| width / height;
        let (own, cached) = (
            aspect(f64::from(camera.width), f64::from(camera.height)),
            aspect(width as f64, height as f64),
        );
        // A pixel of rounding is no other aspect.
        if (own / cached - 1.0).abs() > 1.0 / height as f64 {
            return Err(wrong(
                path,
                format!(
                    "`{group}/depth` has maps of {width}x{height}, the images of camera `{}` are {}x{}: they do not show the same",
                    camera.id, camera.width, camera.height
                ),
            ));
        }
        let size = (width as u32, height as u32);
        let times = whole_dataset(&file, &format!("{group}/timestamps"))?;
        times.expect_shape(&[frames]).map_err(unreadable)?;
        let times: Vec<f64> = times.read().map_err(unreadable)?;
        let rows =
            rows(&times, source, index, tolerance_ms).map_err(|what| wrong(path, format!("`{group}`: {what}")))?;
        let range_m = source.cameras[index]
            .depth
            .as_ref()
            .map_or(RANGE_M, |depth| depth.range_m);
        source.cameras[index].depth = Some(SourceDepth {
            path: path.to_owned(),
            unit_m: None,
            range_m,
            // The release's depth is FoundationStereo's; caches made of something else say so.
            origin: stated.unwrap_or(ReferenceOrigin::FoundationStereo),
            cached: Some(CachedDepth { group, rows, size }),
        });
        // Whatever else the cache says of these frames goes by its own clock.
        if source.cameras[index].times_ms.is_none() {
            source.cameras[index].times_ms = Some(times);
        }
        found += 1;
    }
    if found == 0 {
        return Err(wrong(
            path,
            format!("none of its cameras is one of the episode ({})", serials(source)),
        ));
    }
    Ok(())
}

/// Which entry is of which episode frame: by time where the episode has a clock, else one by one.
fn rows(times: &[f64], source: &Source, camera: usize, tolerance_ms: f64) -> Result<Vec<Option<usize>>, String> {
    if !times.is_sorted_by(|a, b| a < b) {
        return Err("its timestamps do not ascend".to_owned());
    }
    let frames = source.frame_count as usize;
    let Some(own) = &source.cameras[camera].times_ms else {
        if times.len() != frames {
            return Err(format!(
                "it has {} maps, the episode {frames} frames and no clock: they cannot be paired",
                times.len()
            ));
        }
        return Ok((0..frames).map(Some).collect());
    };
    let rows = nearest(times, own, tolerance_ms);
    if rows.iter().all(Option::is_none) {
        return Err(format!(
            "none of its {} maps is within {tolerance_ms} ms of an image: its times are {:.0} to {:.0} ms, those of the images {:.0} to {:.0} ms",
            times.len(),
            times.first().unwrap_or(&f64::NAN),
            times.last().unwrap_or(&f64::NAN),
            own.first().unwrap_or(&f64::NAN),
            own.last().unwrap_or(&f64::NAN)
        ));
    }
    Ok(rows)
}

/// Hands the maps of these episode frames to `take`: metres, NaN where there is none. `[h, w]`
pub(crate) fn read_cached(
    path: &Path,
    cached: &CachedDepth,
    (first, step, count): (u32, u32, u32),
    mut take: impl FnMut(&[f32]),
) -> StageResult<()> {
    let file = Hdf5File::open(path).map_err(unreadable)?;
    let depth = whole_dataset(&file, &format!("{}/depth", cached.group))?;
    let area = cached.size.0 as usize * cached.size.1 as usize;
    let mut largest = 0;
    for index in 0..count {
        let row = cached.rows.get((first + index * step) as usize).copied().flatten();
        let Some(row) = row else {
            take(&vec![f32::NAN; area]);
            continue;
        };
        let millimetres: Vec<u16> = depth.read_rows(row..row + 1).map_err(unreadable)?;
        largest = largest.max(millimetres.iter().copied().max().unwrap_or(0));
        let metres = |&value: &u16| {
            if value == 0 {
                f32::NAN
            } else {
                f32::from(value) / 1000.0
            }
        };
        take(&millimetres.iter().map(metres).collect::<Vec<f32>>());
    }
    if (1..METRES_BELOW).contains(&largest) {
        let text = format!("`{}/depth` reaches {largest} mm at most", cached.group);
        return Err(wrong(path, text).with_hint("depth is millimetres; were these metres?"));
    }
    Ok(())
}

/// What made the references, where a file says so.
pub(super) fn stated_origin(attribute: Option<&Hdf5Value>, path: &Path) -> StageResult<Option<ReferenceOrigin>> {
    let text = attribute.and_then(Hdf5Value::text);
    text.map(|text| text.parse().map_err(|what: String| wrong(path, what)))
        .transpose()
}

/// A data set that its writer has finished.
pub(super) fn whole_dataset<'a>(file: &'a Hdf5File, at: &str) -> StageResult<Hdf5Dataset<'a>> {
    let dataset = file.need(at).map_err(unreadable)?;
    let attributes = dataset.attributes().map_err(unreadable)?;
    let flag = attributes.get("write_complete").and_then(|value| value.truth());
    complete(flag, at, file.path())?;
    Ok(dataset)
}

/// `write_complete` must be true.
fn complete(flag: Option<bool>, at: &str, path: &Path) -> StageResult<()> {
    let what = match flag {
        Some(true) => return Ok(()),
        Some(false) => "`write_complete` is false",
        None => "`write_complete` is missing",
    };
    let text = format!("`{at}`: {what}: its writer did not finish");
    Err(wrong(path, text).with_hint("fetch or make the file again"))
}
