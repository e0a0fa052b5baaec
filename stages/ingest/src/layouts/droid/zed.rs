//! Factory calibrations of ZED cameras (`SNserial.conf`), and what is usual for the two models that DROID uses.

use std::path::Path;

use rogs_schemas::Intrinsics;
use rogs_worker::StageResult;

use crate::fault::{read_text, wrong};

/// Longest file, bytes.
const MAX_CONF: u64 = 1 << 20;
/// Size of DROID's images, which published intrinsics and those of the HDF5 belong to.
pub(super) const SIZE: (u32, u32) = (1280, 720);

/// What is read of a factory calibration: the left eye at 1280 x 720 with integer pixel centres.
///
/// The values belong to images before rectification; those of the rectified images differ by up to 1.5 %
/// (`docs/spec/data.md` section 0).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Factory {
    pub(super) intrinsics: Intrinsics,
    /// From the left to the right eye, metres.
    pub(super) baseline_m: f64,
}

/// Means over 34 ZED 2 (external cameras) and 14 ZED Mini (wrist cameras), `docs/spec/data.md` section 0.
pub(super) fn usual(wrist: bool) -> Factory {
    let (focal, baseline_m) = if wrist { (772.0, 0.062_92) } else { (533.55, 0.120_04) };
    Factory {
        intrinsics: Intrinsics {
            fx: focal,
            fy: focal,
            cx: 644.0,
            cy: 360.0,
        },
        baseline_m,
    }
}

/// Reads a `.conf` file.
pub(super) fn read(path: &Path) -> StageResult<Factory> {
    let text = read_text(path, MAX_CONF)?;
    parse(&text).map_err(|what| {
        wrong(path, what)
            .with_hint("expected the factory calibration of a ZED camera with `[LEFT_CAM_HD]` and `[STEREO]`")
    })
}

fn parse(text: &str) -> Result<Factory, String> {
    let mut section = "";
    let (mut left, mut baseline) = ([None; 4], None);
    for line in text.lines().map(str::trim) {
        if let Some(name) = line.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            section = name;
            continue;
        }
        let Some((key, value)) = line.split_once('=') else {
            continue;
        };
        let (key, value) = (key.trim(), value.trim());
        let slot = match (section, key) {
            ("LEFT_CAM_HD", "fx") => &mut left[0],
            ("LEFT_CAM_HD", "fy") => &mut left[1],
            ("LEFT_CAM_HD", "cx") => &mut left[2],
            ("LEFT_CAM_HD", "cy") => &mut left[3],
            ("STEREO", "Baseline" | "BaseLine") => &mut baseline,
            _ => continue,
        };
        let number = value.parse::<f64>().ok().filter(|number| number.is_finite());
        *slot = Some(number.ok_or_else(|| format!("`{key}` of [{section}] is `{value}`, which is no number"))?);
    }
    let [Some(fx), Some(fy), Some(cx), Some(cy)] = left else {
        return Err("there is no [LEFT_CAM_HD] with fx, fy, cx and cy".to_owned());
    };
    let millimetres = baseline.ok_or("there is no `Baseline` in [STEREO]")?;
    if !(10.0..1000.0).contains(&millimetres) {
        return Err(format!("a `Baseline` of {millimetres} mm is impossible"));
    }
    Ok(Factory {
        intrinsics: Intrinsics { fx, fy, cx, cy },
        baseline_m: millimetres / 1000.0,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONF: &str = "[LEFT_CAM_2K]\nfx=1064\n[LEFT_CAM_HD]\nfx=532.025\nfy=531.9\ncx=637.95\ncy=369.1295\n\
                        [RIGHT_CAM_HD]\nfx=1\n[STEREO]\nBaseline=120.062\nTY=0.1\n";

    #[test]
    fn the_left_eye_at_the_size_of_droid_is_read() {
        let factory = parse(CONF).unwrap();
        let Intrinsics { fx, fy, cx, cy } = factory.intrinsics;
        assert_eq!((fx, fy, cx, cy), (532.025, 531.9, 637.95, 369.1295));
        assert!((factory.baseline_m - 0.120_062).abs() < 1e-12);
    }

    #[test]
    fn wrong_files_say_what_is_wrong() {
        let why = |from: &str, to: &str| parse(&CONF.replace(from, to)).unwrap_err();
        assert!(why("fy=531.9\n", "").contains("LEFT_CAM_HD"));
        assert!(why("cx=637.95", "cx=wide").contains("`wide`"));
        assert!(why("Baseline=120.062", "Baseline=0.12").contains("0.12 mm"));
        assert!(parse("").unwrap_err().contains("LEFT_CAM_HD"));
    }

    #[rogs_needs::needs(shared)]
    #[test]
    fn all_published_factory_calibrations_are_read() {
        let folder = rogs_needs::shared!("data/pointworld_droid/droid_zed_calibrations");
        let mut read_of = [0, 0];
        for entry in std::fs::read_dir(folder).unwrap() {
            let factory = read(&entry.unwrap().path()).unwrap();
            let wrist = factory.baseline_m < 0.09;
            let usual = usual(wrist);
            assert!((factory.baseline_m / usual.baseline_m - 1.0).abs() < 0.02);
            // One unit of the wrist class has 698.8.
            assert!(
                (factory.intrinsics.fx / usual.intrinsics.fx - 1.0).abs() < 0.1,
                "{factory:?}"
            );
            read_of[usize::from(wrist)] += 1;
        }
        assert_eq!(read_of, [34, 15]);
    }
}
