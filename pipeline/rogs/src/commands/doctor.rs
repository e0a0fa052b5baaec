//! `rogs doctor`: what this machine has, for people and for bug reports.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use serde::Serialize;

use crate::output;

/// Shows what this machine offers and what is missing.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder in which runs will lie; checked for writing, renaming and locking.
    #[arg(long, default_value = ".")]
    folder: PathBuf,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// One finding.
#[derive(Debug, Serialize)]
struct Finding {
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
    let findings = [version(), processor(), memory(), media(), folder(&args.folder)];
    if args.json {
        output::json(&findings)?;
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
    let sound = findings.iter().all(|finding| finding.state != "problem");
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
