//! Poses as people and programs write them in JSON: every form that has one meaning.

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

use crate::pose::RigidPose;

/// What a pose may look like, for messages.
pub const FORMS: &str = "a 4x4 or 3x4 matrix in rows, 16 or 12 numbers, `[x, y, z, roll, pitch, yaw]`, or a `translation` \
                         with `quaternion_xyzw`, `quaternion_wxyz`, `rpy` or a 3x3 `rotation`";

const LAST: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// A pose as it was written, metres and radians; `rogs_geometry::Pose::from_written` checks it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WrittenPose {
    /// Rows of a homogeneous matrix.
    Matrix([[f64; 4]; 4]),
    /// x, y, z and the angles about the fixed axes x, y, z, in this order, as DROID and URDF have them.
    Euler([f64; 6]),
    /// Translation and quaternion (x, y, z, w).
    Quaternion([f64; 3], [f64; 4]),
}

impl WrittenPose {
    /// Reads any form. Quaternions without an order in their name are read only as an object of `x`, `y`, `z`, `w`, as ROS
    /// writes them.
    ///
    /// # Errors
    /// What was expected, when the value has no form of a pose.
    pub fn from_json(value: &Value) -> Result<Self, String> {
        Self::read(value).ok_or_else(|| format!("expected {FORMS}"))
    }

    fn read(value: &Value) -> Option<Self> {
        if let Some(rows) = rows::<4>(value) {
            return match rows.as_slice() {
                [a, b, c] => Some(Self::Matrix([*a, *b, *c, LAST])),
                [a, b, c, d] => Some(Self::Matrix([*a, *b, *c, *d])),
                _ => None,
            };
        }
        if let Some(values) = numbers(value) {
            return Self::from_numbers(&values);
        }
        let any = |names: &[&str]| names.iter().find_map(|name| value.get(*name));
        let translation = triple(any(&["translation", "position", "t"])?)?;
        let quaternions = [("quaternion_xyzw", [0, 1, 2, 3]), ("quaternion_wxyz", [1, 2, 3, 0])];
        let mut found = quaternions.iter().filter_map(|(name, order)| {
            let values: [f64; 4] = numbers(value.get(*name)?)?.try_into().ok()?;
            Some(Self::Quaternion(translation, order.map(|index| values[index])))
        });
        if let Some(first) = found.next() {
            return found.next().is_none().then_some(first);
        }
        if let Some(angles) = value.get("rpy") {
            let ([x, y, z], [a, b, c]) = (translation, triple(angles)?);
            return Some(Self::Euler([x, y, z, a, b, c]));
        }
        let rotation = any(&["rotation", "orientation", "R"])?;
        if rotation.is_object() {
            let part = |name: &str| rotation.get(name)?.as_f64();
            return Some(Self::Quaternion(
                translation,
                [part("x")?, part("y")?, part("z")?, part("w")?],
            ));
        }
        let rotation: [[f64; 3]; 3] = rows::<3>(rotation)?.try_into().ok()?;
        let row = |axis: usize| {
            let [x, y, z] = rotation[axis];
            [x, y, z, translation[axis]]
        };
        Some(Self::Matrix([row(0), row(1), row(2), LAST]))
    }

    /// From the numbers of one pose in a row, as tables and arrays hold them: 16 or 12 of a matrix, or six.
    #[must_use]
    pub fn from_numbers(values: &[f64]) -> Option<Self> {
        if let Ok(six) = <[f64; 6]>::try_from(values) {
            return Some(Self::Euler(six));
        }
        let (rows, []) = values.as_chunks::<4>() else {
            return None;
        };
        match *rows {
            [a, b, c] => Some(Self::Matrix([a, b, c, LAST])),
            [a, b, c, d] => Some(Self::Matrix([a, b, c, d])),
            _ => None,
        }
    }
}

/// Numbers of a list.
fn numbers(value: &Value) -> Option<Vec<f64>> {
    value.as_array()?.iter().map(Value::as_f64).collect()
}

/// Rows of `N` numbers.
fn rows<const N: usize>(value: &Value) -> Option<Vec<[f64; N]>> {
    let rows = value.as_array()?.iter();
    rows.map(|row| numbers(row)?.try_into().ok()).collect()
}

/// Three numbers: a list, a column of a matrix, or an object of `x`, `y`, `z`.
fn triple(value: &Value) -> Option<[f64; 3]> {
    if value.is_object() {
        let part = |name: &str| value.get(name)?.as_f64();
        return Some([part("x")?, part("y")?, part("z")?]);
    }
    if let Some(column) = rows::<1>(value) {
        return column
            .into_iter()
            .map(|[entry]| entry)
            .collect::<Vec<_>>()
            .try_into()
            .ok();
    }
    numbers(value)?.try_into().ok()
}

impl From<RigidPose> for WrittenPose {
    fn from(pose: RigidPose) -> Self {
        let [a, b, c, d, e, f, g, h, i] = pose.rotation;
        let [x, y, z] = pose.translation;
        Self::Matrix([[a, b, c, x], [d, e, f, y], [g, h, i, z], LAST])
    }
}

impl<'de> Deserialize<'de> for WrittenPose {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Self::from_json(&Value::deserialize(deserializer)?)
            .map_err(|expected| D::Error::custom(format!("not a pose: {expected}")))
    }
}

impl Serialize for WrittenPose {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Matrix(rows) => rows.serialize(serializer),
            Self::Euler(six) => six.serialize(serializer),
            Self::Quaternion(translation, xyzw) => {
                serde_json::json!({"translation": translation, "quaternion_xyzw": xyzw}).serialize(serializer)
            }
        }
    }
}

impl schemars::JsonSchema for WrittenPose {
    fn inline_schema() -> bool {
        true
    }

    fn schema_name() -> std::borrow::Cow<'static, str> {
        "WrittenPose".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({"type": ["array", "object"], "description": format!("A pose: {FORMS}.")})
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_come_in_every_usual_form() {
        let matrix = WrittenPose::Matrix([[0.0, -1.0, 0.0, 1.0], [1.0, 0.0, 0.0, 2.0], [0.0, 0.0, 1.0, 3.0], LAST]);
        let (half, place) = (0.5_f64.sqrt(), [1.0, 2.0, 3.0]);
        let quaternion = WrittenPose::Quaternion(place, [0.0, 0.0, half, half]);
        let euler = WrittenPose::Euler([1.0, 2.0, 3.0, 0.1, 0.2, 0.3]);
        for (text, expected) in [
            ("[[0,-1,0,1],[1,0,0,2],[0,0,1,3],[0,0,0,1]]", matrix),
            ("[[0,-1,0,1],[1,0,0,2],[0,0,1,3]]", matrix),
            ("[0,-1,0,1,1,0,0,2,0,0,1,3,0,0,0,1]", matrix),
            ("[0,-1,0,1,1,0,0,2,0,0,1,3]", matrix),
            (r#"{"R":[[0,-1,0],[1,0,0],[0,0,1]],"t":[[1],[2],[3]]}"#, matrix),
            (
                r#"{"rotation":[[0,-1,0],[1,0,0],[0,0,1]],"translation":[1,2,3]}"#,
                matrix,
            ),
            ("[1,2,3,0.1,0.2,0.3]", euler),
            (r#"{"translation":[1,2,3],"rpy":[0.1,0.2,0.3]}"#, euler),
            (
                r#"{"translation":[1,2,3],"quaternion_xyzw":[0,0,HALF,HALF]}"#,
                quaternion,
            ),
            (
                r#"{"translation":[1,2,3],"quaternion_wxyz":[HALF,0,0,HALF]}"#,
                quaternion,
            ),
            (
                r#"{"position":{"x":1,"y":2,"z":3},"orientation":{"x":0,"y":0,"z":HALF,"w":HALF}}"#,
                quaternion,
            ),
        ] {
            let text = text.replace("HALF", &half.to_string());
            let found: WrittenPose = serde_json::from_str(&text).unwrap();
            assert_eq!(found, expected, "{text}");
            let again = serde_json::to_string(&found).unwrap();
            assert_eq!(
                serde_json::from_str::<WrittenPose>(&again).unwrap(),
                expected,
                "{again}"
            );
        }
    }

    #[test]
    fn what_has_two_meanings_or_none_is_refused_with_what_was_expected() {
        for text in [
            "[[1,2],[3,4]]",
            "[1,2,3]",
            "[0,0,0,0,0,0,1]",
            "7",
            "null",
            "[[1,0,0,0]]",
            "[[1,0,0],[0,1,0],[0,0,1]]",
            r#"{"translation":[1,2,3]}"#,
            r#"{"translation":[1,2,3],"quaternion":[0,0,0,1]}"#,
            r#"{"translation":[1,2,3],"quaternion_xyzw":[0,0,0,1],"quaternion_wxyz":[1,0,0,0]}"#,
            r#"{"translation":[1,2],"quaternion_xyzw":[0,0,0,1]}"#,
        ] {
            let error = serde_json::from_str::<WrittenPose>(text).unwrap_err().to_string();
            assert!(error.contains("not a pose") && error.contains("3x4"), "{text}: {error}");
        }
    }
}
