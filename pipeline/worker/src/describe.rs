//! The face `describe`.

use rogs_schemas::protocol::Description;
use serde_json::Value;

use crate::error::{StageError, StageResult};
use crate::params::parse_params;
use crate::stage::Stage;

/// What a stage is. With `params`, `default_params` are those parameters with all others filled in: the canonical form
/// that a plan hashes.
///
/// # Errors
/// When the parameters are wrong.
pub fn describe<S: Stage>(params: &Value) -> StageResult<Description> {
    let params: S::Params = parse_params(params)?;
    let wrong = |error: serde_json::Error| StageError::internal(format!("parameters are not plain data: {error}"));
    Ok(Description {
        stage: S::NAME.to_owned(),
        summary: S::SUMMARY.to_owned(),
        stage_version: S::VERSION,
        inputs: S::inputs(),
        output_schema: S::OUTPUT.to_string(),
        default_params: serde_json::to_value(&params).map_err(wrong)?,
        params_schema: schemars::schema_for!(S::Params).to_value(),
    })
}
