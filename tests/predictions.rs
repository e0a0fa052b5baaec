//! An outside method from the manifest to the tables and the report: our own field, handed in as PLY files, must have the
//! scores of the field itself.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]
#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

mod support;

use std::path::Path;

use rogs_arrays::{NamedArray, write_npz};
use rogs_needs::needs;
use rogs_r4c::read_record;
use rogs_schemas::records::clip::{Clip, time_of_frame};
use rogs_schemas::records::field::Field;
use serde_json::Value;
use support::Workspace;

/// Writes `frame-N.ply` for the frames that are scored.
fn export(clip_folder: &Path, out: &Path) {
    let (clip, _) = read_record::<Clip>(&clip_folder.join("clip.r4c")).unwrap();
    let (field, _) = read_record::<Field>(&clip_folder.join("field-1.r4c")).unwrap();
    let timed = rogs_field::TimedField::new(&field).unwrap();
    std::fs::create_dir_all(out).unwrap();
    let anchor = clip.tracks.as_ref().map(|tracks| tracks.anchor_frame);
    for frame in clip.query_frames.iter().copied().chain(anchor) {
        let time = time_of_frame(frame, clip.frame_count());
        rogs_field::export_field(
            &timed,
            time,
            rogs_field::Axes::Recon,
            &out.join(format!("frame-{frame}.ply")),
        )
        .unwrap();
    }
}

fn row<'a>(table: &'a Value, method: &str) -> &'a Value {
    let rows = table["rows"].as_array().unwrap();
    rows.iter()
        .find(|row| row["method"] == method)
        .unwrap_or_else(|| panic!("no row `{method}`: {table:#}"))
}

/// Means that are NaN: the clip is scored as an empty scene, and the log, which the report repeats, says so.
#[test]
fn predictions_that_are_not_finite_are_said() {
    let workspace = Workspace::small(1);
    workspace.manifest("predictions.toml", "run");
    let manifest = std::fs::read_to_string(workspace.path("predictions.toml")).unwrap();
    let (code, first) = workspace.rogs_json(&["run", "predictions.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(0), "{first:#}");
    let clips = std::fs::read_dir(workspace.path("run/clips")).unwrap();
    let clip = clips.map(|entry| entry.unwrap().file_name()).next().unwrap();
    let folder = workspace.path("theirs").join(&clip);
    std::fs::create_dir_all(&folder).unwrap();
    let frames: Vec<u32> = (0..17).collect();
    let arrays = [
        NamedArray::new("frames", &[17], &frames),
        NamedArray::new("means", &[17, 4, 3], &[f32::NAN; 17 * 4 * 3]),
        NamedArray::new("quats", &[4, 4], &[1.0_f32, 0.0, 0.0, 0.0].repeat(4)),
        NamedArray::new("scales", &[4, 3], &[0.01_f32; 12]),
        NamedArray::new("opacities", &[4], &[0.5_f32; 4]),
        NamedArray::new("rgb", &[4, 3], &[0.5_f32; 12]),
    ];
    write_npz(&folder.join("gaussians.npz"), &arrays).unwrap();
    workspace.write(
        "predictions.toml",
        &(manifest + "\n[[predictions]]\nname = \"theirs\"\nroot = \"theirs\"\n"),
    );
    let (code, second) = workspace.rogs_json(&["run", "predictions.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(0), "{second:#}");
    let logs = workspace.rogs(&["logs", "run", &clip.to_string_lossy()]).stdout;
    let logs = String::from_utf8_lossy(&logs).into_owned();
    assert!(
        logs.contains("`theirs`: 4 Gaussians have values that are not finite"),
        "{logs}"
    );
    // Below the table, too, where nobody sees the log.
    let table = workspace.rogs(&["table", "run"]).stdout;
    let table = String::from_utf8_lossy(&table).into_owned();
    assert!(
        table.contains("NOT FINITE: theirs (up to 4 of a clip, in 1 of 1 clips)"),
        "{table}"
    );
}

#[needs(long = "two episodes through every stage, twice")]
#[test]
fn a_field_handed_in_as_files_has_the_scores_of_the_field() {
    let workspace = Workspace::with_episodes(2);
    workspace.manifest("predictions.toml", "run");
    let manifest = std::fs::read_to_string(workspace.path("predictions.toml")).unwrap();
    let updates =
        [0, 1].map(|update| format!("\n[[variants]]\nname = \"r{update}\"\nscore = {{ update = {update} }}\n"));
    workspace.write("predictions.toml", &(manifest + &updates.concat()));
    let (code, first) = workspace.rogs_json(&["run", "predictions.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(0), "{first:#}");
    let clips = workspace.path("run/clips");
    let mut names: Vec<_> = std::fs::read_dir(&clips)
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    names.sort();

    // Only the first clip has a prediction.
    let folder = workspace.path("theirs").join(&names[0]);
    export(&clips.join(&names[0]), &folder);
    std::fs::write(folder.join("timing.json"), r#"{"lift_s": 12.5, "device": "elsewhere"}"#).unwrap();
    let manifest = std::fs::read_to_string(workspace.path("predictions.toml")).unwrap();
    let more = "\n[[predictions]]\nname = \"theirs\"\nroot = \"theirs\"\nframe = \"camera\"\n";
    workspace.write("predictions.toml", &(manifest + more));
    let (code, second) = workspace.rogs_json(&["run", "predictions.toml", "--json"]);
    assert_eq!(code, Some(0), "{second:#}");
    assert_eq!(
        second["units"]["made"], 2,
        "one score a clip and nothing else: {second:#}"
    );

    let (_, main) = workspace.rogs_json(&["report", "run", "--table", "main", "--json"]);
    assert_eq!(row(&main, "theirs")["clips"], 1);
    assert_eq!(row(&main, "stage1")["clips"], 2);
    let text = String::from_utf8(workspace.rogs(&["table", "run"]).stdout).unwrap();
    assert!(text.contains("2 clips, except theirs 1"), "{text}");

    // The same numbers as those of the field on that clip.
    let scores = |suffix: &str| -> rogs_schemas::records::scores::ScoreSheet {
        let outputs = workspace.outputs("run");
        let mut own = outputs
            .keys()
            .filter(|path| path.starts_with(Path::new("clips").join(&names[0])));
        let found = own.find(|path| {
            let (record, _) =
                match read_record::<rogs_schemas::records::scores::Scores>(&workspace.path("run").join(path)) {
                    Ok(read) => read,
                    Err(_) => return false,
                };
            record.summary.method == suffix
        });
        let path = workspace.path("run").join(found.unwrap());
        read_record::<rogs_schemas::records::scores::Scores>(&path)
            .unwrap()
            .0
            .summary
    };
    let (ours, theirs) = (scores("stage1"), scores("theirs"));
    for (a, b) in ours.images.iter().zip(&theirs.images) {
        assert_eq!((&a.camera, a.frame, a.support_n), (&b.camera, b.frame, b.support_n));
        for (a, b) in [(a.psnr, b.psnr), (a.ssim, b.ssim), (a.absrel, b.absrel)] {
            assert!(a.zip(b).is_none_or(|(a, b)| (a - b).abs() < 1e-2), "{a:?} {b:?}");
            assert_eq!(a.is_some(), b.is_some());
        }
    }
    assert_eq!(ours.tracks.len(), theirs.tracks.len());
    for (a, b) in ours.tracks.iter().zip(&theirs.tracks) {
        assert!(
            a.epe_mm.zip(b.epe_mm).is_none_or(|(a, b)| (a - b).abs() < 0.05),
            "{a:?} {b:?}"
        );
    }

    let (_, timing) = workspace.rogs_json(&["table", "run", "--table", "timing", "--json"]);
    let cells = row(&timing, "theirs")["cells"].to_string();
    assert!(cells.contains("12.5") && cells.contains("elsewhere"), "{cells}");

    // A field after so many updates is a row of the refined field alone.
    let (_, recurrence) = workspace.rogs_json(&["table", "run", "--table", "recurrence", "--json"]);
    assert_eq!(row(&recurrence, "stage1+2/r0")["clips"], 2);
    assert_eq!(row(&recurrence, "stage1+2/r1")["clips"], 2);
    assert_eq!(recurrence["rows"].as_array().unwrap().len(), 2);

    // The report shows it beside ours, with plots, and stays self-contained.
    let report = std::fs::read_to_string(second["report"].as_str().unwrap()).unwrap();
    assert!(report.contains("<th>theirs</th>") && report.contains("<svg role"));
    assert!(report.contains("Refinement updates: novel PSNR"));
    assert!(report.contains("not an input time") && report.contains("(novel)"));
    let report = report
        .rsplit_once("<script>")
        .map_or(report.as_str(), |(before, _)| before);
    assert!(!report.contains("<script") && !report.contains("https://") && !report.contains("src=\"/"));

    // A folder that is gone is a clip that is gone, and a wrong name is an error with a place.
    std::fs::rename(workspace.path("theirs"), workspace.path("gone")).unwrap();
    let output = workspace.rogs(&["plan", "predictions.toml"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(
        stderr.contains("predictions.toml") && stderr.contains("is not a folder"),
        "{stderr}"
    );
}
