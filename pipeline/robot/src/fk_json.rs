//! Forward kinematics of a table of joint values, as JSON (`rogs fk`).

use serde_json::{Map, Value, json};

use crate::error::{Error, Result};
use crate::model::{JointKind, RobotModel};

/// One JSON object per row; its `links` maps each link's name to its row-major 4x4 pose in the base link's frame.
///
/// `header` names the joints of the columns; mimic joints follow their drivers, joints without a column are at 0.
/// `rows` are the fields as text. An object is `{"row": 0, "links": {"panda_link0": [16 numbers], ...}}`: the matrices are
/// flat, row after row, so that entries 3, 7 and 11 are the position in metres.
///
/// # Errors
/// Names the row (counted from 1 below the header) and the column: unknown, fixed or repeated joint, wrong number of
/// fields, a field that is not a finite number, a mimic joint that contradicts its driver.
pub fn fk_rows<R, F>(model: &RobotModel, header: &[String], rows: R) -> Result<Vec<Value>>
where
    R: IntoIterator<Item = Vec<F>>,
    F: AsRef<str>,
{
    let header: Vec<&str> = header.iter().map(|name| name.trim()).collect();
    check_header(model, &header)?;
    rows.into_iter()
        .enumerate()
        .map(|(row, fields)| fk_row(model, &header, row, &fields))
        .collect()
}

fn check_header(model: &RobotModel, header: &[&str]) -> Result<()> {
    for (column, name) in header.iter().enumerate() {
        let refuse = |what: String| Error::Table {
            place: format!("header, column {}", column + 1),
            what,
        };
        let joint = model.joint_index(name).map_err(|error| refuse(error.to_string()))?;
        if model.joints[joint].kind == JointKind::Fixed {
            return Err(refuse(format!("joint `{name}` is fixed and takes no value")));
        }
        if header[..column].contains(name) {
            return Err(refuse(format!("joint `{name}` appears twice")));
        }
    }
    Ok(())
}

fn fk_row<F: AsRef<str>>(model: &RobotModel, header: &[&str], row: usize, fields: &[F]) -> Result<Value> {
    let refuse = |what: String| Error::Table {
        place: format!("row {}", row + 1),
        what,
    };
    if fields.len() != header.len() {
        return Err(refuse(format!(
            "{} fields, the header has {}",
            fields.len(),
            header.len()
        )));
    }
    let number = |(name, field): (&&'_ str, &F)| {
        let text = field.as_ref().trim();
        let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
        value.ok_or_else(|| Error::Table {
            place: format!("row {}, column `{name}`", row + 1),
            what: format!("`{}` is not a finite number", text.chars().take(40).collect::<String>()),
        })
    };
    let values = header.iter().zip(fields).map(number).collect::<Result<Vec<f64>>>()?;
    let state = model
        .joint_state(header.iter().copied().zip(values))
        .map_err(|error| refuse(error.to_string()))?;
    let mut links = Map::new();
    for (link, pose) in model.links.iter().zip(model.fk(&state)) {
        links.insert(link.name.clone(), json!(pose.to_matrix4()));
    }
    Ok(json!({ "row": row, "links": links }))
}
