//! The report: one self-contained HTML page with the score table, failures, and pictures of every clip.
//!
//! The generator reads container files only through `rogs_schemas`; score tables are made by the caller, who knows the
//! scoring code. The page needs no network and no script: pictures are inlined, names are escaped, and a content security
//! policy forbids everything else.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_pages::Plot;
use rogs_schemas::read_record;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::robot::RobotMaps;
use rogs_schemas::records::scores::Scores;

use crate::{html, pictures};

/// Everything a report shows.
#[derive(Debug, Clone, Default)]
pub(crate) struct ReportInput {
    /// Name of the run.
    pub(crate) run_name: String,
    /// One line about the run: what was done, by which version.
    pub(crate) summary: Vec<(String, String)>,
    /// Tables, in order.
    pub(crate) tables: Vec<ReportTable>,
    /// Plots over all clips, in order.
    pub(crate) plots: Vec<Plot>,
    /// Clips, in order.
    pub(crate) clips: Vec<ClipReport>,
    /// At most this many clips get pictures; the others are listed.
    pub(crate) max_picture_clips: usize,
}

/// A table of text cells.
#[derive(Debug, Clone, Default)]
pub(crate) struct ReportTable {
    /// Heading.
    pub(crate) title: String,
    /// Column heads.
    pub(crate) columns: Vec<String>,
    /// Rows of cells, each as long as `columns`.
    pub(crate) rows: Vec<Vec<String>>,
    /// Footnotes.
    pub(crate) footnotes: Vec<String>,
}

/// One clip of the run.
#[derive(Debug, Clone, Default)]
pub(crate) struct ClipReport {
    /// Clip id.
    pub(crate) clip_id: String,
    /// Output files that exist, by name: `clip`, `robot`, and one `scores` entry per method under its label.
    pub(crate) clip: Option<PathBuf>,
    /// Robot maps.
    pub(crate) robot: Option<PathBuf>,
    /// Scores by method label, in order of display.
    pub(crate) scores: Vec<(String, PathBuf)>,
    /// What went wrong.
    pub(crate) failures: Vec<FailureReport>,
    /// Seconds and peak memory by stage, for people.
    pub(crate) timings: Vec<TimingReport>,
    /// Warnings by stage.
    pub(crate) warnings: Vec<(String, String)>,
}

/// One failed unit.
#[derive(Debug, Clone)]
pub(crate) struct FailureReport {
    /// Stage that failed or is blocked.
    pub(crate) stage: String,
    /// What happened.
    pub(crate) message: String,
    /// What to do.
    pub(crate) hint: Option<String>,
}

/// What one unit cost.
#[derive(Debug, Clone)]
pub(crate) struct TimingReport {
    /// Stage.
    pub(crate) stage: String,
    /// Seconds of the unit.
    pub(crate) seconds: f64,
    /// Peak resident memory of its worker, bytes.
    pub(crate) peak_rss_bytes: u64,
}

/// What could be read of a clip.
struct ClipData {
    clip: Option<Clip>,
    robot: Option<RobotMaps>,
    scores: Vec<(String, Scores)>,
    unreadable: Vec<FailureReport>,
}

/// Writes `index.html` into `folder` (made when missing) and returns its path. Files that cannot be read are named in
/// the page instead of stopping it.
///
/// # Errors
/// When the page cannot be written.
pub(crate) fn write_report(folder: &Path, input: &ReportInput) -> std::io::Result<PathBuf> {
    std::fs::create_dir_all(folder)?;
    let mut page = html::Page::new(&input.run_name);
    page.facts(&input.summary);
    let sections: Vec<(usize, String, BTreeMap<String, WeightsInfo>)> = input
        .clips
        .iter()
        .enumerate()
        .map(|(index, clip)| clip_section(index, clip, index < input.max_picture_clips))
        .collect();
    page.untrained_banner(sections.iter().flat_map(|(_, _, weights)| weights.values()));
    for table in &input.tables {
        page.table(table);
    }
    page.plots(&input.plots);
    page.failures(&input.clips);
    for (_, section, _) in &sections {
        page.raw(section);
    }
    let path = folder.join("index.html");
    let temporary = folder.join(format!(".index.html.{}.tmp", std::process::id()));
    std::fs::write(&temporary, page.finish())?;
    std::fs::rename(&temporary, &path)?;
    Ok(path)
}

fn clip_section(
    index: usize,
    report: &ClipReport,
    with_pictures: bool,
) -> (usize, String, BTreeMap<String, WeightsInfo>) {
    let mut section = html::Section::new(&report.clip_id, index == 0);
    let mut weights = BTreeMap::new();
    section.failures(&report.failures);
    section.warnings(&report.warnings);
    if with_pictures {
        let data = read_clip(report);
        section.failures(&data.unreadable);
        for (_, scores) in &data.scores {
            for info in &scores.summary.weights {
                weights.insert(format!("{}/{}", info.configuration, info.description), info.clone());
            }
        }
        if let Some(clip) = &data.clip {
            section.clip_facts(clip);
            section.figures(
                "Inputs with the outline of the robot mesh",
                pictures::inputs(clip, data.robot.as_ref()),
            );
            if let Some(robot) = &data.robot {
                section.figures(
                    "Mesh depth (camera z) and link ids at the source times",
                    pictures::robot(clip, robot),
                );
            }
            section.comparison(&pictures::comparison(clip, &data.scores));
            for (method, scores) in &data.scores {
                section.scores(method, &scores.summary);
                section.figures(
                    &format!("{method}: reference, render, error, rendered depth at query times"),
                    pictures::renders(clip, scores),
                );
            }
        }
    } else {
        section.note("Pictures are made for the first clips only; `rogs inspect` shows the files of this one.");
    }
    section.timings(&report.timings);
    (index, section.finish(), weights)
}

fn read_clip(report: &ClipReport) -> ClipData {
    let mut unreadable = Vec::new();
    let mut note = |stage: &str, error: rogs_schemas::Error| {
        unreadable.push(FailureReport {
            stage: stage.to_owned(),
            message: error.to_string(),
            hint: Some("delete the file and run again".to_owned()),
        });
    };
    let clip = report.clip.as_deref().and_then(|path| match read_record::<Clip>(path) {
        Ok((clip, _)) => Some(clip),
        Err(error) => {
            note("ingest", error);
            None
        }
    });
    let robot = report
        .robot
        .as_deref()
        .and_then(|path| match read_record::<RobotMaps>(path) {
            Ok((robot, _)) => Some(robot),
            Err(error) => {
                note("robot-maps", error);
                None
            }
        });
    let mut scores = Vec::new();
    for (method, path) in &report.scores {
        match read_record::<Scores>(path) {
            Ok((record, _)) => scores.push((method.clone(), record)),
            Err(error) => note("score", error),
        }
    }
    ClipData {
        clip,
        robot,
        scores,
        unreadable,
    }
}
