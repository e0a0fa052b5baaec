//! What a reader must know of a measured table, one function a note.

use std::collections::BTreeSet;

use rogs_schemas::records::origin::ReferenceKind;
use rogs_schemas::records::scores::ScoreSheet;

use crate::origins;
use crate::summary::{OUTSIDE_SCALED, SheetSet};
use crate::tables::id::TableId;
use crate::tables::layout::{Layout, Origin};
use crate::tables::table::Row;
use crate::timing::{ClipTiming, peak_memory};

/// The notes below a table, in order.
pub(crate) fn of(
    id: TableId,
    layout: &Layout,
    set: &SheetSet<'_>,
    timings: &[ClipTiming],
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
    notes.extend(scaled_by_protocol(rows));
    if id == TableId::Scale {
        notes.push("every depth image is scaled by the median ratio to its target; this diagnostic only".to_owned());
    }
    let here = rows
        .iter()
        .filter(|row| sheets(&row.method).into_iter().any(was_scaled));
    notes.extend(
        list(here.map(|row| row.label.as_str()))
            .map(|labels| format!("{labels}: fields brought to metres here, by one source-depth factor per camera")),
    );
    notes.extend(coverage(rows));
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

/// Methods of the paper whose own protocol has a scale factor.
fn scaled_by_protocol(rows: &[Row]) -> Option<String> {
    let shown = |method: &str| rows.iter().any(|row| row.method.split('/').next() == Some(method));
    let scaled = [("movies", "MoVieS"), ("som", "SoM")]
        .into_iter()
        .filter(|(method, _)| shown(method));
    list(scaled.map(|(_, label)| label)).map(|labels| {
        format!("{labels}: by the paper's protocol one scale factor per camera from recorded source stereo depth")
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
