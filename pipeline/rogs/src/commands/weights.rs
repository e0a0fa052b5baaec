//! `rogs weights`: bringing network weights in, and checking them.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context as _;
use rogs_networks::checkpoint::{ElementType, ImportRequest, TensorFile, generate_stage1, import_stage1, merge_lora};
use rogs_networks::stage1::Stage1Config;

use crate::output;

/// Imports, makes, lists and merges Stage-1 weights.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Reads a released file (safetensors, or PyTorch .pth, .pt, .ckpt; f32, bf16 or f16), checks every name and shape, and
    /// writes our checkpoint.
    Import {
        /// The released file.
        input: PathBuf,
        /// Where our checkpoint goes.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Configuration whose tensors it must have.
        #[arg(long, default_value = "full")]
        configuration: String,
        /// How numbers are stored.
        #[arg(long, value_enum, default_value_t = Numbers::F32)]
        numbers: Numbers,
        /// Where the file comes from, for reports.
        #[arg(long, default_value = "")]
        provenance: String,
        /// Leave out tensors that the configuration does not know, instead of failing.
        #[arg(long)]
        drop_unexpected: bool,
    },
    /// Writes a checkpoint with seeded random weights: right names and shapes, nothing learned.
    Generate {
        /// Where it goes.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Configuration.
        #[arg(long, default_value = "compact")]
        configuration: String,
        /// Seed.
        #[arg(long, default_value_t = 73)]
        seed: u64,
        /// How numbers are stored.
        #[arg(long, value_enum, default_value_t = Numbers::F32)]
        numbers: Numbers,
    },
    /// Folds the low-rank updates of a checkpoint into its weights.
    Merge {
        /// A checkpoint of ours with LoRA tensors.
        input: PathBuf,
        /// Where the merged one goes.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// How numbers are stored.
        #[arg(long, value_enum, default_value_t = Numbers::F32)]
        numbers: Numbers,
    },
    /// Names, shapes and metadata of a safetensors file.
    List {
        /// The file.
        file: PathBuf,
        /// Print one JSON value.
        #[arg(long)]
        json: bool,
    },
}

/// Number formats of a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Numbers {
    F32,
    Bf16,
    F16,
}

impl From<Numbers> for ElementType {
    fn from(numbers: Numbers) -> Self {
        match numbers {
            Numbers::F32 => Self::F32,
            Numbers::Bf16 => Self::BF16,
            Numbers::F16 => Self::F16,
        }
    }
}

pub(crate) fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.what {
        What::Import {
            input,
            out,
            configuration,
            numbers,
            provenance,
            drop_unexpected,
        } => {
            let request = ImportRequest {
                config: Stage1Config::by_name(&configuration)?,
                element: numbers.into(),
                output: out.clone(),
                input,
                provenance,
                drop_unexpected,
            };
            let report = import_stage1(&request)?;
            output::text(&format!(
                "{} tensors written to `{}` ({:?} file, {} start from a seed)",
                report.written,
                out.display(),
                report.origin,
                report.fresh.len()
            ))?;
        }
        What::Generate {
            out,
            configuration,
            seed,
            numbers,
        } => {
            generate_stage1(
                &out,
                &Stage1Config::by_name(&configuration)?,
                seed,
                numbers.into(),
                true,
            )?;
            output::text(&format!(
                "`{}`: seeded weights of `{configuration}`, not trained",
                out.display()
            ))?;
        }
        What::Merge { input, out, numbers } => {
            merge_lora(&input, &out, numbers.into())?;
            output::text(&format!("merged into `{}`", out.display()))?;
        }
        What::List { file, json } => list(&file, json)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn list(file: &std::path::Path, json: bool) -> anyhow::Result<()> {
    let tensors = TensorFile::open(file).with_context(|| format!("reading `{}`", file.display()))?;
    let shapes: Vec<(String, Vec<usize>)> = tensors
        .tensors()
        .iter()
        .map(|(name, entry)| (name.clone(), entry.shape.clone()))
        .collect();
    let elements: usize = shapes.iter().map(|(_, shape)| shape.iter().product::<usize>()).sum();
    if json {
        let tensors_json: Vec<_> = shapes
            .iter()
            .map(|(name, shape)| serde_json::json!({ "name": name, "shape": shape }))
            .collect();
        return output::json(&serde_json::json!({
            "tensors": tensors_json, "elements": elements, "metadata": tensors.metadata(),
        }));
    }
    let mut text = String::new();
    for (name, shape) in &shapes {
        let shape: Vec<String> = shape.iter().map(usize::to_string).collect();
        text.push_str(&format!("{name:<72} {}\n", shape.join("x")));
    }
    text.push_str(&format!("{} tensors, {elements} elements", shapes.len()));
    output::text(&text)
}
