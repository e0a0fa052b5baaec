//! What a reader must know of a measured table, one function a note.

use std::collections::{BTreeMap, BTreeSet};

use rogs_schemas::records::field::WeightsInfo;
use rogs_schemas::records::origin::ReferenceKind;
use rogs_schemas::records::scores::ScoreSheet;

use crate::origins;
use crate::summary::{OUTSIDE, OUTSIDE_SCALED, SheetSet};
use crate::tables::id::TableId;
use crate::tables::input::{MissingScores, heading};
use crate::tables::layout::{Layout, Origin};
use crate::tables::table::Row;
use crate::timing::{ClipTiming, peak_memory};

/// Most reasons that a note gives.
const MOST_REASONS: usize = 4;

/// The notes below a table, in order.
pub(crate) fn of(
    id: TableId,
    layout: &Layout,
    set: &SheetSet<'_>,
    timings: &[ClipTiming],
    missing: &[MissingScores],
    settings: &[&str],
    rows: &[Row],
) -> Vec<String> {
    let sheets = |method: &'_ str| -> Vec<&ScoreSheet> {
        let of_method = settings.iter().flat_map(|setting| set.sheets(setting, method));
        of_method.collect()
    };
    let methods: BTreeSet<&str> = rows.iter().map(|row| row.method.as_str()).collect();
    let all: Vec<&ScoreSheet> = methods.iter().flat_map(|method| sheets(method)).collect();
    let has = |word: &str| layout.columns.iter().any(|(column, _)| column.name.contains(word));
    let memory = layout.columns.iter().any(|(_, origin)| *origin == Origin::Memory);

    let mut notes = Vec::new();
    if let Some(count) = layout.first_clips {
        notes.push(format!("the first {count} clips of the cohort at most"));
    }
    let ran_here = |row: &Row| {
        let outside = |info: &WeightsInfo| [OUTSIDE, OUTSIDE_SCALED].contains(&info.configuration.as_str());
        let weights = || sheets(&row.method).into_iter().flat_map(|sheet| &sheet.weights);
        weights().next().is_some() && !weights().any(outside)
    };
    notes.extend(scaled_by_protocol(rows, ran_here));
    if id == TableId::Scale {
        notes.push("every depth image is scaled by the median ratio to its target; this diagnostic only".to_owned());
    }
    if id == TableId::CrossView {
        notes.push(
            "the image of each source camera against the field without the Gaussians of its own pixels; recorded \
             observations are the floor. With attention across cameras, the others have been lifted beside that image"
                .to_owned(),
        );
    }
    let here = rows
        .iter()
        .filter(|row| sheets(&row.method).into_iter().any(was_scaled));
    notes.extend(list(here.map(|row| row.label.as_str())).map(|labels| {
        format!(
            "{labels}: fields brought to metres after they were made, by the median of source over rendered depth of \
                     each camera; the paper scales before"
        )
    }));
    notes.extend(coverage(rows));
    notes.extend(reasons(rows, missing));
    if has("LPIPS") {
        let reasons: BTreeSet<&str> = all.iter().filter_map(|sheet| sheet.lpips_note.as_deref()).collect();
        notes.extend(reasons.into_iter().map(|reason| format!("LPIPS: {reason}")));
    }
    if has("SSIM") {
        let variants = list(all.iter().map(|sheet| sheet.ssim_variant.as_str()));
        notes.extend(variants.map(|variants| format!("SSIM variant: {variants}")));
    }
    if has("AbsRel") || has("RMSE") || has("delta1") {
        notes.extend(without_support(&all));
    }
    notes.extend(undefined(rows, sheets));
    let depth = ["AbsRel", "RMSE", "delta1", "robot depth"].into_iter().any(has);
    let kinds = [(ReferenceKind::Depth, depth), (ReferenceKind::Tracks, has("EPE"))];
    let kinds = kinds.into_iter().filter_map(|(kind, shown)| shown.then_some(kind));
    notes.extend(origins::counted(&all, &kinds.collect::<Vec<_>>()));
    let untrained = all
        .iter()
        .filter(|sheet| sheet.weights.iter().any(|weights| !weights.trained));
    notes.extend(list(untrained.map(|sheet| sheet.method.as_str())).map(|methods| {
        format!(
            "UNTRAINED WEIGHTS: {methods} ran with seeded random weights; these numbers say nothing about the method"
        )
    }));
    if memory && methods.iter().any(|method| is_resident(timings, method)) {
        notes.push("memory is the peak resident memory of the process (CPU), not device memory".to_owned());
    }
    notes
}

/// The different names, ascending and separated by commas; `None` for none.
fn list<'a>(names: impl Iterator<Item = &'a str>) -> Option<String> {
    let names: BTreeSet<&str> = names.collect();
    (!names.is_empty()).then(|| names.into_iter().collect::<Vec<_>>().join(", "))
}

/// Methods that run here with one scale factor a camera, as the paper has it.
fn scaled_by_protocol(rows: &[Row], ran_here: impl Fn(&Row) -> bool) -> Option<String> {
    let of_movies = |row: &&Row| row.method.split('/').next() == Some("movies");
    let labels = rows.iter().filter(of_movies).filter(|row| ran_here(row));
    list(labels.map(|row| row.label.as_str())).map(|labels| {
        format!("{labels}: one scale per camera, the mean distance of its source stereo points, before the network and undone after")
    })
}

/// Whether the field of an outside method was brought to metres by us.
fn was_scaled(sheet: &ScoreSheet) -> bool {
    sheet.weights.iter().any(|info| info.configuration == OUTSIDE_SCALED)
}

/// Names the rows that lack clips which others have, a note a group.
fn coverage(rows: &[Row]) -> Vec<String> {
    let groups: BTreeSet<&str> = rows.iter().map(|row| row.group.as_str()).collect();
    let mut notes = Vec::new();
    for group in groups {
        let own = || rows.iter().filter(|row| row.group == group);
        let most = own().map(|row| row.clips).max().unwrap_or(0);
        let short = own().filter(|row| row.clips > 0 && row.clips < most);
        let list: Vec<String> = short.map(|row| format!("{} {}", row.label, row.clips)).collect();
        if !list.is_empty() {
            notes.push(format!("{group}: {most} clips, except {}", list.join(", ")));
        }
    }
    notes
}

/// Why rows lack clips: a note a row, the reasons by how many clips they kept away.
fn reasons(rows: &[Row], missing: &[MissingScores]) -> Vec<String> {
    let mut notes = Vec::new();
    for row in rows {
        let own = || {
            let of_row = |one: &&MissingScores| one.method == row.method && heading(&one.setting) == row.group;
            missing.iter().filter(of_row)
        };
        let count = own().count();
        if count == 0 {
            continue;
        }
        let mut counts: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for one in own() {
            counts.entry(&one.reason).or_default().push(&one.clip);
        }
        let mut counts: Vec<(&str, Vec<&str>)> = counts.into_iter().collect();
        counts.sort_by_key(|(_, clips)| std::cmp::Reverse(clips.len()));
        let told = counts
            .iter()
            .take(MOST_REASONS)
            .map(|(reason, clips)| match &clips[..] {
                [one] => format!("{one}: {reason}"),
                [first, ..] => format!("{} clips such as {first}: {reason}", clips.len()),
                [] => String::new(),
            });
        let mut told: Vec<String> = told.collect();
        if counts.len() > MOST_REASONS {
            told.push(format!("{} more reasons", counts.len() - MOST_REASONS));
        }
        let (label, done) = (&row.label, row.clips);
        let group = &row.group;
        notes.push(format!(
            "{group}, {label}: {done} of {} clips; {}",
            done + count,
            told.join("; ")
        ));
    }
    notes
}

/// How many images have reference depth that cannot be used.
fn without_support(sheets: &[&ScoreSheet]) -> Option<String> {
    let empty: u64 = sheets.iter().map(|sheet| u64::from(sheet.n_empty_support)).sum();
    (empty > 0).then(|| format!("{empty} images have reference depth but none of it in range; they are left out"))
}

/// Names the rows whose fields have Gaussians that are not finite.
fn undefined<'a>(rows: &[Row], sheets: impl Fn(&str) -> Vec<&'a ScoreSheet>) -> Option<String> {
    let told = |row: &Row| {
        let own = sheets(&row.method);
        let with: Vec<u64> = own
            .iter()
            .map(|sheet| sheet.invalid_gaussians)
            .filter(|count| *count > 0)
            .collect();
        let most = with.iter().max()?;
        Some(format!(
            "{} (up to {most} of a clip, in {} of {} clips)",
            row.label,
            with.len(),
            own.len()
        ))
    };
    let told: BTreeSet<String> = rows.iter().filter_map(told).collect();
    (!told.is_empty()).then(|| {
        format!(
            "NOT FINITE: {}; such Gaussians are scored as if they were not there",
            told.into_iter().collect::<Vec<_>>().join(", ")
        )
    })
}

/// Whether the memory of a method is that of its process, in some setting.
fn is_resident(timings: &[ClipTiming], method: &str) -> bool {
    let own = timings.iter().filter(|timing| timing.method == method);
    let settings: BTreeSet<&str> = own.map(|timing| timing.setting.as_str()).collect();
    let peak = |setting: &str| peak_memory(timings, setting, method);
    settings
        .into_iter()
        .any(|setting| peak(setting).is_some_and(|(_, resident)| resident))
}
