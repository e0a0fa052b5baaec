//! The report of a small fixed run: the page, and the table files beside it. `UPDATE_EXPECT=1` writes what is expected anew.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use expect_test::expect_file;
use rogs_report::write_report;

/// Text that does not depend on the machine, the version or the encoder: one tag a line, the run folder as `RUN`, pictures as
/// their type, size and the hash of their bytes.
fn plain(page: &str, run: &Path) -> String {
    let version = format!("rogs {}", env!("CARGO_PKG_VERSION"));
    let page = page
        .replace(run.to_str().unwrap(), "RUN")
        .replace(&version, "rogs VERSION");
    let mut parts = page.split("data:image/");
    let mut text = parts.next().unwrap().to_owned();
    for part in parts {
        let (picture, rest) = part.split_once('"').unwrap();
        let (kind, bytes) = picture.split_once(";base64,").unwrap();
        let bytes = STANDARD.decode(bytes).unwrap();
        let image = image::load_from_memory(&bytes).unwrap();
        let hash = &blake3::hash(&bytes).to_hex()[..8];
        text += &format!("({kind} {}x{} {hash})\"{rest}", image.width(), image.height());
    }
    text.replace("><", ">\n<") + "\n"
}

#[test]
fn the_report_of_a_small_run() {
    let folder = tempfile::tempdir().unwrap();
    let run = std::path::absolute(folder.path()).unwrap();
    support::make_run(&run);
    let page = write_report(&run).unwrap();
    assert_eq!(page, run.join("report/index.html"));
    let html = std::fs::read_to_string(&page).unwrap();
    expect_file!["expected/report.html"].assert_eq(&plain(&html, &run));
    // What people write is shown and never run.
    for text in ["<script", "<b>&", "<i>", "http:", "https:"] {
        assert!(!html.contains(text), "`{text}` is in the page as it is");
    }
    // Exactly the tables of the page, each in every form.
    let files = std::fs::read_dir(run.join("report/tables")).unwrap();
    let mut names: Vec<String> = files
        .map(|file| file.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    let tables = [
        "additional",
        "ci",
        "inputs",
        "main",
        "recurrence",
        "robot_stage1",
        "timing",
    ];
    let expected: Vec<String> = tables
        .iter()
        .flat_map(|table| ["csv", "json", "tex", "txt"].map(|form| format!("{table}.{form}")))
        .collect();
    assert_eq!(names, expected);
    let text = tables.map(|table| std::fs::read_to_string(run.join(format!("report/tables/{table}.txt"))).unwrap());
    expect_file!["expected/report-tables.txt"].assert_eq(&text.join("\n"));
}
