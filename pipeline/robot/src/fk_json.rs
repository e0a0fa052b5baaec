//! Forward kinematics of a table of joint values, as JSON (`rogs fk`).

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;

use crate::error::{Error, Result};
use crate::model::{JointKind, JointState, RobotModel};

/// Link poses of one row of a table.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct FkRow {
    /// The row, counted from 0.
    pub row: usize,
    /// Poses of the links in the base link's frame, metres: 4x4 matrices row after row, so that entries 3, 7 and 11 are
    /// the position.
    pub links: BTreeMap<String, [f64; 16]>,
}

/// A table of joint values that is gone through row by row.
#[derive(Debug)]
pub struct FkTable<'a> {
    model: &'a RobotModel,
    header: Vec<String>,
}

impl<'a> FkTable<'a> {
    /// A table whose columns are the joints that `header` names; mimic joints follow their drivers, joints without a
    /// column are at 0.
    ///
    /// # Errors
    /// Names the column: unknown, fixed or repeated joint.
    pub fn new<F: AsRef<str>>(model: &'a RobotModel, header: &[F]) -> Result<Self> {
        let header: Vec<String> = header.iter().map(|name| name.as_ref().trim().to_owned()).collect();
        check_header(model, &header.iter().map(String::as_str).collect::<Vec<_>>())?;
        Ok(Self { model, header })
    }

    /// Checks a row, counted from 0, whose fields are text, and gives its state.
    ///
    /// # Errors
    /// Names the row (counted from 1 below the header) and the column: wrong number of fields, a field that is not a
    /// finite number, a mimic joint that contradicts its driver.
    pub fn check<F: AsRef<str>>(&self, row: usize, fields: &[F]) -> Result<JointState> {
        self.state(row, fields)
    }

    /// Link poses of a row, counted from 0.
    ///
    /// # Errors
    /// See [`check`](Self::check).
    pub fn row<F: AsRef<str>>(&self, row: usize, fields: &[F]) -> Result<FkRow> {
        let state = self.state(row, fields)?;
        let links = self.model.links.iter().zip(self.model.fk(&state));
        let links = links.map(|(link, pose)| (link.name.clone(), pose.to_matrix4()));
        Ok(FkRow {
            row,
            links: links.collect(),
        })
    }

    fn state<F: AsRef<str>>(&self, row: usize, fields: &[F]) -> Result<JointState> {
        let refuse = |what: String| Error::Table {
            place: format!("row {}", row + 1),
            what,
        };
        if fields.len() != self.header.len() {
            return Err(refuse(format!(
                "{} fields, the header has {}",
                fields.len(),
                self.header.len()
            )));
        }
        let number = |(name, field): (&String, &F)| {
            let text = field.as_ref().trim();
            let value = text.parse::<f64>().ok().filter(|value| value.is_finite());
            value.ok_or_else(|| Error::Table {
                place: format!("row {}, column `{name}`", row + 1),
                what: format!("`{}` is not a finite number", text.chars().take(40).collect::<String>()),
            })
        };
        let values = self
            .header
            .iter()
            .zip(fields)
            .map(number)
            .collect::<Result<Vec<f64>>>()?;
        self.model
            .joint_state(self.header.iter().map(String::as_str).zip(values))
            .map_err(|error| refuse(error.to_string()))
    }
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
