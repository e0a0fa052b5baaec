//! `rogs weights`: bringing network weights in, and checking them.

pub(super) mod catalogue;
mod download;
mod fetch;
pub(super) mod told;
mod verify;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context as _;
use rogs_4dgt::{ENCODER, FOUR_DGT, FourDgtConfig, import_encoder, import_network};
use rogs_stage1::Stage1Config;
use rogs_stage1::{ImportRequest, generate_stage1, import_stage1, merge_lora};
use rogs_stage2::{ReleasedImport, ReleasedModel, import_released};
use rogs_weights::{ElementType, TensorFile, average};

use self::told::{Averaged, Generated, Imported, Listed, Merged, Shape};
use crate::output;

/// Fetches, imports, verifies, makes, lists, merges and averages weights.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, clap::Subcommand)]
enum What {
    /// Reads a released file (safetensors, or PyTorch .pth, .pt, .ckpt; f32, bf16 or f16), checks every name and shape, and
    /// writes a checkpoint for rogs.
    Import {
        /// The released file.
        input: PathBuf,
        /// Where the checkpoint goes.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// Configuration whose tensors it must have: of Stage 1 (MoVieS too); `resplat-re10k` for a released Stage-2 file; `4dgt`
        /// and `dinov2` for those of the baseline 4DGT.
        #[arg(long, default_value = "full")]
        configuration: String,
        /// How numbers are stored.
        #[arg(long, value_enum, default_value_t = NumberFormat::F32)]
        numbers: NumberFormat,
        /// Where the file comes from, for reports.
        #[arg(long, default_value = "")]
        provenance: String,
        /// Leave out tensors that the configuration does not know, instead of failing.
        #[arg(long)]
        drop_unexpected: bool,
        /// Print one JSON value: what was written.
        #[arg(long)]
        json: bool,
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
        #[arg(long, value_enum, default_value_t = NumberFormat::F32)]
        numbers: NumberFormat,
        /// Print one JSON value: what was written.
        #[arg(long)]
        json: bool,
    },
    /// Folds the low-rank updates of a checkpoint into its weights.
    Merge {
        /// A checkpoint of rogs with LoRA tensors.
        input: PathBuf,
        /// Where the merged one goes.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// How numbers are stored.
        #[arg(long, value_enum, default_value_t = NumberFormat::F32)]
        numbers: NumberFormat,
        /// Print one JSON value: what was written.
        #[arg(long)]
        json: bool,
    },
    /// Averages checkpoints of one network, as of parts of a training that went different ways from the same start.
    Average {
        /// The checkpoints.
        #[arg(required = true, num_args = 1..)]
        inputs: Vec<PathBuf>,
        /// Weight of each, in their order; by default equal ones. They are divided by their sum.
        #[arg(long, value_delimiter = ',', value_name = "NUMBERS")]
        shares: Option<Vec<f64>>,
        /// Where the average goes.
        #[arg(long, value_name = "FILE")]
        out: PathBuf,
        /// How numbers are stored.
        #[arg(long, value_enum, default_value_t = NumberFormat::F32)]
        numbers: NumberFormat,
        /// Where the weights come from, for reports; by default what was averaged.
        #[arg(long)]
        provenance: Option<String>,
        /// Print one JSON value: what was written.
        #[arg(long)]
        json: bool,
    },
    /// Lists names, shapes and metadata of a safetensors file.
    List {
        /// The file.
        file: PathBuf,
        /// Print one JSON value.
        #[arg(long)]
        json: bool,
    },
    /// Checks a weights file: names, shapes, that every number is finite, and its SHA-256. Exit code 1 when something is
    /// wrong.
    Verify {
        /// The file, of any format that can be imported.
        file: PathBuf,
        /// What it should be: a Stage-1 configuration (`full`, `compact`), a Stage-2 preset (`paper`, `cpu`, `ci`) or a released
        /// model (`resplat-re10k`, `resplat-dl3dv`); by default what the file itself says or looks like.
        #[arg(long)]
        configuration: Option<String>,
        /// SHA-256 that it must have (hexadecimal, at least the first 8 digits).
        #[arg(long, value_name = "DIGITS")]
        sha256: Option<String>,
        /// Print one JSON value.
        #[arg(long)]
        json: bool,
    },
    /// Downloads a public weights file by name, resuming where an earlier attempt broke off, and keeps it only if its
    /// SHA-256 is right. Nothing else in this program downloads anything.
    Fetch(fetch::Args),
}

/// Number formats of a checkpoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum NumberFormat {
    F32,
    Bf16,
    F16,
}

impl From<NumberFormat> for ElementType {
    fn from(numbers: NumberFormat) -> Self {
        match numbers {
            NumberFormat::F32 => Self::F32,
            NumberFormat::Bf16 => Self::BF16,
            NumberFormat::F16 => Self::F16,
        }
    }
}

#[expect(clippy::too_many_lines, reason = "one arm a subcommand: arguments in, a line out")]
pub(crate) fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.what {
        What::Import {
            input,
            out,
            configuration,
            numbers,
            provenance,
            drop_unexpected,
            json,
        } => {
            if let Ok(model) = ReleasedModel::by_name(&configuration) {
                let request = ReleasedImport {
                    input,
                    output: out.clone(),
                    model,
                    element: numbers.into(),
                    provenance,
                    drop_unexpected,
                };
                return written_tensors(import_released(&request)?, out, json);
            }
            if [FOUR_DGT, ENCODER].contains(&configuration.as_str()) {
                let request = rogs_4dgt::import::ImportRequest {
                    input: &input,
                    output: &out,
                    element: numbers.into(),
                    provenance: &provenance,
                    drop_unexpected,
                };
                let written = match configuration == FOUR_DGT {
                    true => import_network(&request, &FourDgtConfig::full())?,
                    false => import_encoder(&request)?,
                };
                return written_tensors(written, out, json);
            }
            let request = ImportRequest {
                config: Stage1Config::by_name(&configuration)?,
                element: numbers.into(),
                output: out.clone(),
                input,
                provenance,
                drop_unexpected,
            };
            let report = import_stage1(&request)?;
            let origin = format!("{:?}", report.origin);
            if json {
                output::json(&Imported {
                    out,
                    tensors: report.written,
                    origin: Some(origin),
                    from_a_seed: report.fresh,
                })?;
            } else {
                output::text(&format!(
                    "{} tensors written to `{}` ({origin} file, {} start from a seed)",
                    report.written,
                    out.display(),
                    report.fresh.len()
                ))?;
            }
        }
        What::Generate {
            out,
            configuration,
            seed,
            numbers,
            json,
        } => {
            generate_stage1(
                &out,
                &Stage1Config::by_name(&configuration)?,
                seed,
                numbers.into(),
                true,
            )?;
            if json {
                output::json(&Generated {
                    out,
                    configuration,
                    seed,
                })?;
            } else {
                output::text(&format!(
                    "`{}`: seeded weights of `{configuration}`, not trained",
                    out.display()
                ))?;
            }
        }
        What::Merge {
            input,
            out,
            numbers,
            json,
        } => {
            merge_lora(&input, &out, numbers.into())?;
            if json {
                output::json(&Merged { out })?;
            } else {
                output::text(&format!("merged into `{}`", out.display()))?;
            }
        }
        What::Average {
            inputs,
            shares,
            out,
            numbers,
            provenance,
            json,
        } => {
            let shares = shares.unwrap_or_else(|| vec![1.0; inputs.len()]);
            anyhow::ensure!(
                shares.len() == inputs.len(),
                "`--shares` has {} numbers for {} files; give one for each",
                shares.len(),
                inputs.len()
            );
            let inputs: Vec<(PathBuf, f64)> = inputs.into_iter().zip(shares).collect();
            average(&inputs, &out, numbers.into(), provenance.as_deref())?;
            if json {
                output::json(&Averaged { out, inputs })?;
            } else {
                output::text(&format!(
                    "average of {} files written to `{}`",
                    inputs.len(),
                    out.display()
                ))?;
            }
        }
        What::List { file, json } => list(&file, json)?,
        What::Verify {
            file,
            configuration,
            sha256,
            json,
        } => return verify::run(&file, configuration.as_deref(), sha256.as_deref(), json),
        What::Fetch(args) => return fetch::run(&args),
    }
    Ok(ExitCode::SUCCESS)
}

/// Says how many tensors were written.
fn written_tensors(tensors: usize, out: PathBuf, json: bool) -> anyhow::Result<ExitCode> {
    if json {
        output::json(&Imported {
            out,
            tensors,
            origin: None,
            from_a_seed: Vec::new(),
        })?;
    } else {
        output::text(&format!("{tensors} tensors written to `{}`", out.display()))?;
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
        let shape = |(name, shape)| Shape { name, shape };
        return output::json(&Listed {
            tensors: shapes.into_iter().map(shape).collect(),
            elements,
            metadata: tensors.metadata().clone(),
        });
    }
    let mut text = String::new();
    for (name, shape) in &shapes {
        let shape: Vec<String> = shape.iter().map(usize::to_string).collect();
        text.push_str(&format!("{name:<72} {}\n", shape.join("x")));
    }
    text.push_str(&format!("{} tensors, {elements} elements", shapes.len()));
    output::text(&text)
}
