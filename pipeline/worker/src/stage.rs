//! What a stage is.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rogs_schemas::SchemaId;
use rogs_schemas::protocol::InputDescription;
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::context::Context;
use crate::error::StageResult;

/// One stage of the pipeline: maps the files of one clip to one new file of that clip.
pub trait Stage: Sized {
    /// Name, `robot-maps`; the program is `rogs-NAME`.
    const NAME: &'static str;
    /// One sentence for help texts.
    const SUMMARY: &'static str;
    /// Raised whenever the bytes of the output change for the same inputs and parameters.
    const VERSION: u32;
    /// Schema of the output.
    const OUTPUT: SchemaId;
    /// Parameters; everything that determines the output besides the inputs. `Default` gives the paper's choices.
    type Params: Serialize + DeserializeOwned + Default + JsonSchema + PartialEq + Clone;

    /// The inputs of the stage.
    fn inputs() -> Vec<InputDescription>;

    /// Makes the stage ready for these parameters (loads a checkpoint once; `inputs` are those of the first job).
    ///
    /// # Errors
    /// When the parameters are wrong or a checkpoint cannot be read.
    fn load(params: &Self::Params, inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self>;

    /// Runs one clip and returns what to write.
    ///
    /// # Errors
    /// When the clip cannot be processed; the worker continues with the next clip.
    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()>;
}
