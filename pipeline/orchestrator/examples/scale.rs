//! Scale figures of the orchestrator over the toy pipeline.
//!
//! `cargo run --release -p rogs-orchestrator --example scale -- [CLIPS [RUN_CLIPS [FACTOR]]]` (after `--example toy_pipeline`):
//! plans CLIPS text episodes (default 10,000), looks at their state with no output and with all outputs there, plans ten
//! and FACTOR (default 100) times as many clips without files, and runs RUN_CLIPS (default 200) through the executor.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of examples may be left half-written")]

use std::path::{Path, PathBuf};
use std::time::Instant;

use rayon::prelude::*;
use rogs_orchestrator::executor::ProgressMode;
use rogs_orchestrator::plan::{Plan, WorkUnit, read_plan};
use rogs_orchestrator::programs::StagePrograms;
use rogs_orchestrator::{Prepared, estimate, status};
use rogs_schemas::records::scores::{ScoreSheet, Scores};
use rogs_schemas::{ClipId, Provenance};

type Anyhow<T> = anyhow::Result<T>;

fn main() -> Anyhow<()> {
    let number = |index: usize, default: usize| {
        std::env::args()
            .nth(index)
            .and_then(|text| text.parse().ok())
            .unwrap_or(default)
    };
    let (clips, run_clips) = (number(1, 10_000), number(2, 200));
    let folder = std::env::temp_dir().join(format!("rogs-scale-{}", std::process::id()));
    let result = measure(&folder, clips, run_clips, number(3, 100));
    let _ = std::fs::remove_dir_all(&folder);
    result
}

fn programs() -> Anyhow<StagePrograms> {
    let program = std::env::current_exe()?.with_file_name("toy_pipeline");
    anyhow::ensure!(program.exists(), "build the example `toy_pipeline` first");
    Ok(StagePrograms::Embedded {
        program,
        prefix: vec!["stage".into()],
    })
}

/// Prints wall time and CPU time of this process, which other work on the machine does not change.
fn timed<T>(what: &str, act: impl FnOnce() -> T) -> T {
    let (start, processor) = (Instant::now(), processor_seconds());
    let value = act();
    println!(
        "{what:<50} {:>9.3} s, processor {:>7.2} s",
        start.elapsed().as_secs_f64(),
        processor_seconds() - processor
    );
    value
}

/// User and system seconds of this process so far.
fn processor_seconds() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let fields = stat
        .rsplit_once(')')
        .map(|(_, rest)| rest.to_owned())
        .unwrap_or_default();
    // Fields 14 and 15, in ticks of a hundredth.
    fields
        .split_whitespace()
        .skip(11)
        .take(2)
        .filter_map(|ticks| ticks.parse::<f64>().ok())
        .sum::<f64>()
        / 100.0
}

/// A manifest over this many one-line episodes.
fn dataset(folder: &Path, clips: usize) -> Anyhow<PathBuf> {
    std::fs::create_dir_all(folder.join("episodes"))?;
    std::fs::create_dir_all(folder.join("robot"))?;
    std::fs::write(folder.join("robot/robot.urdf"), "<robot/>")?;
    for clip in 0..clips {
        std::fs::write(
            folder.join(format!("episodes/episode-{clip:06}.txt")),
            format!("episode {clip}"),
        )?;
    }
    let manifest = folder.join("scale.toml");
    let text = "[run]\nname = \"scale\"\nout = \"run\"\nagreement = false\n[input]\nroot = \"episodes\"\n[robot]\nurdf = \"robot/robot.urdf\"\n";
    std::fs::write(&manifest, text)?;
    Ok(manifest)
}

/// Writes an output with the right key for every unit; what is in it does not matter for its state.
fn fill(plan: &Plan) -> Anyhow<()> {
    let sheet = |clip: &str| ScoreSheet {
        clip_id: ClipId::made_of(clip),
        method: String::new(),
        setting: String::new(),
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
    };
    (0..plan.clips.len())
        .into_par_iter()
        .try_for_each(|clip| -> Anyhow<()> {
            let keys = plan.keys(clip);
            std::fs::create_dir_all(plan.clip_folder(clip))?;
            for (node, key) in keys.iter().enumerate() {
                let provenance = Provenance {
                    material: key.material.clone(),
                    input_content: Default::default(),
                };
                let record = Scores {
                    summary: sheet(&plan.clips[clip].id),
                    renders: vec![],
                };
                rogs_r4c::write_record(
                    &plan.run.join(plan.output(WorkUnit { clip, node }, &keys)),
                    &record,
                    &provenance,
                )?;
            }
            Ok(())
        })
}

fn measure(folder: &Path, clips: usize, run_clips: usize, large: usize) -> Anyhow<()> {
    let manifest = dataset(&folder.join("plan"), clips)?;
    let prepared = timed(&format!("plan {clips} clips, cold (list, hash, keys)"), || {
        Prepared::load(&manifest, programs()?).map_err(anyhow::Error::from)
    })?;
    timed("write the plan", || prepared.plan.freeze())?;
    timed("plan again, hashes remembered", || {
        Prepared::load(&manifest, programs()?).map_err(anyhow::Error::from)
    })?;
    timed("status, no outputs", || status::status(&prepared.plan.run))?;
    fill(&prepared.plan)?;
    timed("status, all outputs there", || status::status(&prepared.plan.run))?;
    timed("estimate, all outputs there", || {
        estimate::estimate(&prepared.plan, &prepared.options)
    })?;
    println!(
        "peak memory after {clips} clips: {} MiB",
        rogs_worker::peak_rss_bytes() >> 20
    );

    for factor in [10, large] {
        let mut plan = prepared.plan.clone();
        plan.run = folder.join(format!("large-{factor}"));
        let base = plan.clips.clone();
        plan.clips = (0..factor)
            .flat_map(|round| {
                base.iter().map(move |clip| {
                    let mut clip = clip.clone();
                    clip.id = ClipId::made_of(&format!("{}-{round}", clip.id));
                    clip
                })
            })
            .collect();
        let count = plan.clips.len();
        timed(&format!("keys of {count} clips"), || {
            (0..count)
                .into_par_iter()
                .map(|clip| plan.keys(clip).len())
                .sum::<usize>()
        });
        timed(&format!("write the plan of {count} clips"), || plan.freeze())?;
        let run = plan.run.clone();
        drop(plan);
        let plan = timed(&format!("read the plan of {count} clips"), || read_plan(&run))?;
        println!(
            "peak memory after {} clips: {} MiB",
            plan.clips.len(),
            rogs_worker::peak_rss_bytes() >> 20
        );
    }

    let manifest = dataset(&folder.join("run"), run_clips)?;
    let mut prepared = Prepared::load(&manifest, programs()?)?;
    prepared.options.progress = ProgressMode::Silent;
    prepared.options.workers = 1;
    let summary = timed(&format!("run {run_clips} clips with one worker"), || prepared.run())?;
    let attempts = rogs_orchestrator::ledger::read_all(&summary.run)?;
    let busy: f64 = attempts.iter().filter_map(|attempt| attempt.seconds.get("total")).sum();
    let units = summary.units.made as f64;
    println!(
        "  in stages {:.2} ms a unit, around them {:.2} ms a unit",
        1e3 * busy / units,
        1e3 * (summary.seconds - busy) / units
    );
    timed("run again, everything up to date", || prepared.run())?;
    Ok(())
}
