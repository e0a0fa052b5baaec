//! From the results of a run to the files of its report.

use std::path::{Path, PathBuf};

use maud::Markup;
use rogs_files::write_bytes;
use rogs_orchestrator::manifest::{Manifest, PICTURE_CLIPS};
use rogs_orchestrator::{Error, Result};
use rogs_schemas::shown;
use rogs_score::tables::{Table, TableId, TableOptions};

use crate::beside::beside_page;
use crate::forms::Form;
use crate::page::Pages;
use crate::players::Player;
use crate::results::RunResults;

/// Folder of the report in a run folder.
const FOLDER: &str = "report";
/// Folder of the table files beside the page.
const TABLES_FOLDER: &str = "tables";

/// Writes the report of a run folder: `report/index.html`, of many clips `report/clips/`, and in every form
/// `report/tables/`. Returns the path of the first page. Outputs that cannot be read are named in a page instead of stopping
/// it.
///
/// # Errors
/// When `run` is not a run folder, cannot be read, or the report cannot be written.
pub fn write_report(run: &Path) -> Result<PathBuf> {
    let results = RunResults::read(run)?;
    let folder = results.plan.run.join(FOLDER);
    let options = TableOptions {
        hide_empty_rows: true,
        ..TableOptions::default()
    };
    let mut tables = Vec::new();
    for id in TableId::ALL {
        let table = results.table(id, None, options)?;
        if has_content(&table) {
            write_table(&results.plan.run, &folder.join(TABLES_FOLDER), &table)?;
            tables.push(table);
        }
    }
    let manifest = Manifest::load(&results.plan.manifest).ok();
    let picture_clips = manifest.and_then(|(manifest, _)| manifest.report.clips);
    let picture_clips = picture_clips.unwrap_or(PICTURE_CLIPS);
    let robot = results.robot_mesh();
    rogs_files::make_folder_below(&results.plan.run, &folder)?;
    let mut players: Vec<Player> = Vec::new();
    for (index, clip) in results.clips.iter().enumerate().take(picture_clips) {
        players.extend(beside_page(&results.plan.run, &folder, index, clip, robot.as_ref())?);
    }
    let pages = Pages {
        results: &results,
        picture_clips,
        mesh: robot.as_ref(),
    };
    // One after the other: pictures of many clips are more than should be in memory at once.
    for index in 0..results.clips.len() {
        if let Some(address) = pages.address(index) {
            let path = folder.join(address);
            if let (0, Some(parent)) = (index, path.parent()) {
                rogs_files::make_folder_below(&results.plan.run, parent)?;
            }
            write_page(&path, pages.clip(index))?;
        }
    }
    let path = folder.join("index.html");
    write_page(&path, pages.index(&tables, &players))?;
    Ok(path)
}

/// Writes a page, with whatever else has a name in it shown so that it steers nothing.
fn write_page(path: &Path, page: Markup) -> Result<()> {
    Ok(write_bytes(path, shown::text(&page.into_string()).as_bytes())?)
}

/// Whether a table says something about this run: a number, and in tables of variants one of a variant.
fn has_content(table: &Table) -> bool {
    if table.id == TableId::Inputs {
        return table.rows.iter().any(|row| !row.method.is_empty());
    }
    let of_variants = !matches!(
        table.id,
        TableId::Main
            | TableId::Additional
            | TableId::Ci
            | TableId::Scale
            | TableId::Timing
            | TableId::Following
            | TableId::CrossView
    );
    let measured = table
        .rows
        .iter()
        .filter(|row| row.cells.iter().any(|cell| cell.value().is_some()));
    let mut methods = measured.map(|row| row.method.as_str());
    methods.any(|method| !of_variants || method.contains('/'))
}

/// Writes a table in all its forms.
fn write_table(run: &Path, folder: &Path, table: &Table) -> Result<()> {
    rogs_files::make_folder_below(run, folder)?;
    for form in Form::ALL {
        let path = folder.join(format!("{}.{}", table.id, form.extension()));
        let text = form.print(table).map_err(|error| Error::Io {
            action: "cannot write",
            path: path.clone(),
            source: error.into(),
        })?;
        write_bytes(&path, text.as_bytes())?;
    }
    Ok(())
}
