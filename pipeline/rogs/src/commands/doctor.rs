//! `rogs doctor`: what this machine has, for people and for bug reports.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use schemars::JsonSchema;
use serde::Serialize;

use crate::output::{self, Items};

/// Shows what this machine offers and what is missing.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder in which runs will lie; checked for writing, renaming and locking.
    #[arg(long, default_value = ".")]
    folder: PathBuf,
    /// A manifest that will be run: its weights are looked for, and its size is compared with the free space.
    #[arg(long, value_name = "FILE")]
    manifest: Option<PathBuf>,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// One finding.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Finding {
    /// What was looked at.
    name: &'static str,
    /// `ok`, `note` or `problem`.
    state: &'static str,
    /// What was found.
    found: String,
    /// What to do about it.
    #[serde(skip_serializing_if = "Option::is_none")]
    hint: Option<String>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let mut findings = vec![
        version(),
        processor(),
        memory(),
        limits(),
        gpu(),
        media(),
        slurm(),
        weights(),
    ];
    findings.push(folder(&args.folder));
    findings.extend(args.manifest.as_deref().map(manifest));
    let sound = findings.iter().all(|finding| finding.state != "problem");
    if args.json {
        output::json(&Items { items: findings })?;
    } else {
        let mut text = String::new();
        for finding in &findings {
            let _ = writeln!(text, "{:<8} {:<10} {}", finding.state, finding.name, finding.found);
            if let Some(hint) = &finding.hint {
                let _ = writeln!(text, "{:<19} → {hint}", "");
            }
        }
        output::text(&text)?;
    }
    Ok(if sound { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn version() -> Finding {
    let found = format!(
        "rogs {} on {} {}",
        env!("CARGO_PKG_VERSION"),
        std::env::consts::OS,
        std::env::consts::ARCH
    );
    Finding {
        name: "version",
        state: "ok",
        found,
        hint: None,
    }
}

fn processor() -> Finding {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    #[cfg(target_arch = "x86_64")]
    let features: Vec<&str> = [
        ("AVX2", std::arch::is_x86_feature_detected!("avx2")),
        ("FMA", std::arch::is_x86_feature_detected!("fma")),
        ("AVX-512", std::arch::is_x86_feature_detected!("avx512f")),
    ]
    .into_iter()
    .filter_map(|(name, has)| has.then_some(name))
    .collect();
    #[cfg(not(target_arch = "x86_64"))]
    let features: Vec<&str> = Vec::new();
    let found = format!(
        "{threads} threads; {}",
        if features.is_empty() {
            "portable code only".to_owned()
        } else {
            features.join(", ")
        }
    );
    Finding {
        name: "processor",
        state: "ok",
        found,
        hint: None,
    }
}

/// The number of kibibytes behind a key of a `/proc` table.
fn proc_kib(table: &str, key: &str) -> Option<u64> {
    table
        .lines()
        .find_map(|line| line.strip_prefix(key)?.trim().strip_suffix("kB")?.trim().parse().ok())
}

fn memory() -> Finding {
    let table = std::fs::read_to_string("/proc/meminfo").unwrap_or_default();
    let Some(available) = proc_kib(&table, "MemAvailable:") else {
        return Finding {
            name: "memory",
            state: "note",
            found: "unknown on this system".into(),
            hint: None,
        };
    };
    let gib = available as f64 / (1 << 20) as f64;
    // A compact clip needs about this much per worker; the plan knows better once a run has been measured.
    let enough = gib >= 2.0;
    Finding {
        name: "memory",
        state: if enough { "ok" } else { "problem" },
        found: format!("{gib:.1} GiB available"),
        hint: (!enough).then(|| "one worker needs about 2 GiB; close other programs or use a larger machine".into()),
    }
}

/// What a process may have open, and how much address space; small limits break runs with many workers.
fn limits() -> Finding {
    let table = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let limit = |name: &str| -> Option<String> {
        let line = table.lines().find_map(|line| line.strip_prefix(name))?;
        line.split_whitespace().next().map(str::to_owned)
    };
    let (files, space) = (limit("Max open files"), limit("Max address space"));
    let few = files
        .as_ref()
        .and_then(|files| files.parse::<u64>().ok())
        .is_some_and(|files| files < 256);
    let bounded = space.as_ref().is_some_and(|space| space != "unlimited");
    let told = |what: Option<String>| what.unwrap_or_else(|| "unknown".to_owned());
    Finding {
        name: "limits",
        state: if few || bounded { "note" } else { "ok" },
        found: format!("{} open files, address space {}", told(files), told(space)),
        hint: (few || bounded).then(|| "`ulimit -n 1024` and `ulimit -v unlimited` lift them".to_owned()),
    }
}

/// The first line that a program prints, where it is there and ends well.
fn says(program: &str, arguments: &[&str]) -> Option<String> {
    let mut command = std::process::Command::new(program);
    let output = command
        .args(arguments)
        .stdin(std::process::Stdio::null())
        .output()
        .ok()?;
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let line = text.lines().find(|line| !line.trim().is_empty())?.trim().to_owned();
    output.status.success().then_some(line)
}

fn gpu() -> Finding {
    let built = cfg!(feature = "gpu");
    let seen = says(
        "nvidia-smi",
        &["--query-gpu=name,memory.total,driver_version", "--format=csv,noheader"],
    );
    let there = seen.is_some();
    let found = seen.unwrap_or_else(|| "nvidia-smi shows none".to_owned());
    Finding {
        name: "GPU",
        state: if there && !built { "note" } else { "ok" },
        found: format!(
            "{found}; {}",
            if built {
                "built with GPU support"
            } else {
                "built without GPU support"
            }
        ),
        hint: (there && !built).then(|| "`cargo build --release -p rogs --features gpu` uses it".to_owned()),
    }
}

fn slurm() -> Finding {
    let found = says("sbatch", &["--version"]);
    Finding {
        name: "Slurm",
        state: "ok",
        found: found
            .unwrap_or_else(|| "not here: `rogs run`, or `rogs plan --emit jsonl` for other engines".to_owned()),
        hint: None,
    }
}

/// The weights inside the program.
fn weights() -> Finding {
    let [height, width] = rogs_lift::BUILTIN_SIZE;
    let of = |file: &rogs_weights::Bundled| format!("{} {}", file.name, &file.hash()[..12]);
    Finding {
        name: "weights",
        state: "ok",
        found: format!(
            "built-in {} (images of {width}x{height}), {} (no robot in view), {}",
            of(&rogs_lift::BUILTIN),
            of(&rogs_lift::BUILTIN_SCENES),
            of(&rogs_refine::BUILTIN)
        ),
        hint: None,
    }
}

/// Whether a manifest can be planned and fits on the disk.
fn manifest(path: &std::path::Path) -> Finding {
    let planned = super::run::Machine::default()
        .prepare(path)
        .and_then(|prepared| rogs_orchestrator::estimate::estimate(&prepared.plan, &prepared.options));
    let (state, found, hint) = match planned {
        Ok(estimate) => {
            let gibibytes = |bytes: Option<u64>| bytes.map(|bytes| bytes as f64 / f64::from(1 << 30));
            let (need, free) = (gibibytes(estimate.disk_bytes), gibibytes(estimate.free_bytes));
            let told = |size: Option<f64>| size.map_or_else(|| "?".to_owned(), |size| format!("{size:.1}"));
            let short = need.zip(free).is_some_and(|(need, free)| need > free);
            (
                if short { "problem" } else { "ok" },
                format!(
                    "`{}`: {} clips; about {} GiB to write, {} GiB free; {}",
                    path.display(),
                    estimate.clips,
                    told(need),
                    told(free),
                    estimate.weights.join("; ")
                ),
                short.then(|| "name another `out` under [run], on a larger disk".to_owned()),
            )
        }
        Err(error) => ("problem", error.to_string(), error.hint()),
    };
    Finding {
        name: "manifest",
        state,
        found,
        hint,
    }
}

fn media() -> Finding {
    let report = rogs_ingest::media_report();
    let codecs = [("H.264", report.h264), ("HEVC", report.hevc), ("AV1", report.av1)];
    let codecs: Vec<&str> = codecs
        .into_iter()
        .filter_map(|(name, has)| has.then_some(name))
        .collect();
    Finding {
        name: "video",
        state: if report.problems.is_empty() { "ok" } else { "note" },
        found: match &report.ffmpeg {
            Some(version) => format!("{version}; decodes {}", codecs.join(", ")),
            None => "folders of PNG frames only".to_owned(),
        },
        hint: (!report.problems.is_empty()).then(|| report.problems.join("; ")),
    }
}

fn folder(folder: &std::path::Path) -> Finding {
    match rogs_files::probe(folder) {
        Ok(missing) if missing.is_empty() => Finding {
            name: "folder",
            state: "ok",
            found: format!("`{}` can be written, renamed in, flushed and locked", folder.display()),
            hint: None,
        },
        Ok(missing) => Finding {
            name: "folder",
            state: "note",
            found: format!("the file system of `{}` has no {}", folder.display(), missing.join(", no ")),
            hint: Some(
                "runs work there all the same: without locks they hold a lease, without a flush a power cut may cost the \
                 last outputs; mount options (Lustre: `flock`) or another folder give both"
                    .into(),
            ),
        },
        Err(error) => Finding {
            name: "folder",
            state: "problem",
            found: format!("{error}: {}", error.source),
            hint: Some("choose a folder on a writable disk with `--folder`".into()),
        },
    }
}
