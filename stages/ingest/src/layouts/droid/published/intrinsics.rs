//! Published intrinsics: every form that `intrinsics.json` has had.

use rogs_schemas::Intrinsics;
use rogs_worker::StageResult;
use serde_json::Value;

use super::super::zed;
use super::tables::{Tables, Wanted, numbers};

pub(super) const INTRINSICS: &str = "intrinsics.json";

/// Intrinsics of a camera with integer pixel centres, and the image size that they belong to. `None` also for those
/// that are all zeros; the text says so then.
pub(super) fn find(tables: &Tables, uuid: &str, serial: &str) -> StageResult<Option<Result<Lens, String>>> {
    let Some((_, entry)) = tables.find(INTRINSICS, Wanted::Key(uuid))? else {
        return Ok(None);
    };
    let keys = [serial.to_owned(), format!("{serial}_left")];
    let Some(value) = keys.iter().find_map(|key| entry.get(key)) else {
        return Ok(None);
    };
    match lens(value) {
        Ok(lens) => Ok(Some(Ok(lens))),
        Err(Fault::Zeros) => Ok(Some(Err(format!("`{INTRINSICS}` has zeros for camera {serial}")))),
        Err(Fault::Wrong(what)) => Err(tables.wrong(INTRINSICS, format!("camera {serial} of `{uuid}`: {what}"))),
    }
}

/// Intrinsics and the width and height of the images they belong to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in super::super) struct Lens {
    pub(in super::super) intrinsics: Intrinsics,
    pub(in super::super) size: (u32, u32),
}

enum Fault {
    Zeros,
    Wrong(String),
}

/// `[fx, cx, fy, cy]`, or an object with these as `cameraMatrix` and `width` and `height`; or a 3x3 `cameraMatrix`.
fn lens(value: &Value) -> Result<Lens, Fault> {
    let wrong = |what: &str| Fault::Wrong(what.to_owned());
    let (matrix, size) = match value.get("cameraMatrix") {
        None => (value, zed::SIZE),
        Some(matrix) => {
            let side = |key: &str| match value.get(key) {
                None => Ok(None),
                Some(side) => match side.as_u64().and_then(|side| u32::try_from(side).ok()) {
                    Some(side) if (1..=8192).contains(&side) => Ok(Some(side)),
                    _ => Err(wrong(&format!("invalid `{key}`: expected the side of an image"))),
                },
            };
            let size = match (side("width")?, side("height")?) {
                (Some(width), Some(height)) => (width, height),
                (None, None) => zed::SIZE,
                _ => return Err(wrong("`width` and `height` belong together")),
            };
            (matrix, size)
        }
    };
    let rows: Option<Vec<Vec<f64>>> = matrix.as_array().and_then(|rows| rows.iter().map(numbers).collect());
    let four = match (numbers(matrix), rows.as_deref()) {
        (Some(four), _) => four,
        (None, Some([first, second, _])) if first.len() == 3 && second.len() == 3 => {
            vec![first[0], first[2], second[1], second[2]]
        }
        _ => return Err(wrong("its intrinsics are no list of numbers")),
    };
    let Ok([fx, cx, fy, cy]) = <[f64; 4]>::try_from(four) else {
        return Err(wrong("its intrinsics are not the four numbers fx, cx, fy, cy"));
    };
    if [fx, cx, fy, cy].iter().all(|&number| number == 0.0) {
        return Err(Fault::Zeros);
    }
    // Pixels are square before anybody resizes: fx and fy agree.
    if (fx / fy - 1.0).abs() > 0.1 && (fx / cx - 1.0).abs() < 0.05 {
        return Err(wrong(&format!(
            "[{fx}, {cx}, {fy}, {cy}] looks like fx, fy, cx, cy; the order of this file is fx, cx, fy, cy"
        )));
    }
    Ok(Lens {
        intrinsics: Intrinsics { fx, fy, cx, cy },
        size,
    })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn of(value: Value) -> Result<Lens, String> {
        lens(&value).map_err(|fault| match fault {
            Fault::Zeros => "zeros".to_owned(),
            Fault::Wrong(what) => what,
        })
    }

    #[test]
    fn every_published_form_of_intrinsics_is_read() {
        let expected = Intrinsics {
            fx: 524.3,
            fy: 524.5,
            cx: 639.8,
            cy: 370.3,
        };
        let four = json!([524.3, 639.8, 524.5, 370.3]);
        assert_eq!(
            of(four.clone()).unwrap(),
            Lens {
                intrinsics: expected,
                size: (1280, 720)
            }
        );
        let object = of(json!({"cameraMatrix": four, "width": 640, "height": 360, "distCoeffs": [0]})).unwrap();
        assert_eq!(
            object,
            Lens {
                intrinsics: expected,
                size: (640, 360)
            }
        );
        let matrix = json!({"cameraMatrix": [[524.3, 0, 639.8], [0, 524.5, 370.3], [0, 0, 1]]});
        assert_eq!(of(matrix).unwrap().intrinsics, expected);
    }

    #[test]
    fn other_orders_and_zeros_are_told() {
        assert_eq!(of(json!([0, 0, 0, 0])).unwrap_err(), "zeros");
        assert!(
            of(json!([524.3, 524.5, 639.8, 370.3]))
                .unwrap_err()
                .contains("looks like fx, fy, cx, cy")
        );
        assert!(of(json!([1, 2, 3])).unwrap_err().contains("four numbers"));
        assert!(of(json!("x")).unwrap_err().contains("no list"));
        assert!(
            of(json!({"cameraMatrix": [1, 2, 3, 4], "width": 640}))
                .unwrap_err()
                .contains("belong together")
        );
    }
}
