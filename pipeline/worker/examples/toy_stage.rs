//! The smallest stage: copies the text of its source into a scores record. The tests of this crate run it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of examples may be left half-written")]

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Duration;

use rogs_r4c::Record;
use rogs_schemas::SchemaId;
use rogs_schemas::interim::Figures;
use rogs_schemas::protocol::InputDescription;
use rogs_schemas::records::progress::Progress;
use rogs_schemas::records::scores::{ScoreSheet, Scores};
use rogs_worker::{Context, Stage, StageError, StageResult, stage_main};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// What the stage should do, so that a test can have it misbehave.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct Params {
    /// Repeats of the text.
    repeat: u32,
    /// Seconds to sleep before writing.
    sleep: f64,
}

impl Default for Params {
    fn default() -> Self {
        Self { repeat: 1, sleep: 0.0 }
    }
}

struct Toy {
    params: Params,
    loads: u32,
}

static LOADS: std::sync::atomic::AtomicU32 = std::sync::atomic::AtomicU32::new(0);

impl Stage for Toy {
    const NAME: &'static str = "toy";
    const SUMMARY: &'static str = "Copies the text of its source into a scores record";
    const VERSION: u32 = 3;
    const OUTPUT: SchemaId = Scores::SCHEMA;
    type Params = Params;

    fn inputs() -> Vec<InputDescription> {
        vec![
            InputDescription::required("source", "file"),
            InputDescription::optional("before", Scores::SCHEMA.name),
            InputDescription::optional("weights", "file"),
        ]
    }

    fn load(params: &Params, _inputs: &BTreeMap<String, PathBuf>) -> StageResult<Self> {
        let loads = 1 + LOADS.fetch_add(1, std::sync::atomic::Ordering::SeqCst);
        Ok(Self {
            params: params.clone(),
            loads,
        })
    }

    fn run(&mut self, context: &mut Context<'_>) -> StageResult<()> {
        let path = context.input("source")?.to_owned();
        let text = std::fs::read_to_string(&path)
            .map_err(|error| StageError::io(format!("cannot read `{}`: {error}", path.display())))?;
        let mut text = text.trim().to_owned();
        if context.optional_input("before").is_some() {
            let before: Scores = context.read("before")?;
            text = format!("{} {text}", before.summary.method);
        }
        context.progress(0.5, "half way");
        println!("a line that a library prints to stdout");
        std::thread::sleep(Duration::from_secs_f64(self.params.sleep));
        match text.as_str() {
            "panic" => panic!("the text says so"),
            "fail" => return Err(StageError::bad_input("the text says so").with_hint("write another text")),
            "silent" => return Ok(()),
            "abort" => std::process::abort(),
            // Killed at its first step, and where it is asked for once more at its second.
            "steps" => {
                let done = context.kept().and_then(|kept| kept.counter("steps")).unwrap_or(0);
                if done < 2 {
                    context.keep(&Progress {
                        clip_id: context.clip_id().clone(),
                        counters: vec![("steps".to_owned(), done + 1)],
                        arrays: Vec::new(),
                    })?;
                    let figures = Figures {
                        part: None,
                        update: done as u32 + 1,
                        updates: 2,
                        loss: 0.5,
                        source_psnr_db: None,
                    };
                    context.show(&figures, b"picture");
                    std::process::abort();
                }
                text = format!("after {done}");
            }
            "litter" => {
                let litter = rogs_files::Draft::begin(&path.with_file_name("out.r4c"));
                std::mem::forget(litter.map_err(|error| StageError::io(error.to_string()))?);
                return Err(StageError::io("no more disk"));
            }
            _ => {}
        }
        context.warn(format!("loaded {} times", self.loads));
        let scores = Scores {
            summary: ScoreSheet {
                clip_id: context.clip_id().clone(),
                method: text.repeat(self.params.repeat as usize),
                setting: "recorded".into(),
                ssim_variant: String::new(),
                lpips_note: None,
                weights: vec![],
                images: vec![],
                tracks: vec![],
                robot_depth: vec![],
                n_empty_support: 0,
                invalid_gaussians: 0,
                references: Vec::new(),
                cross_view: Vec::new(),
            },
            renders: vec![],
        };
        context.timed("copy", |context| context.write(&scores))?;
        if text == "regret" {
            return Err(StageError::bad_input("found out too late"));
        }
        Ok(())
    }
}

fn main() -> ExitCode {
    stage_main::<Toy>()
}
