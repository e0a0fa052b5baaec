//! Containers and weights.

#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]

use std::path::{Path, PathBuf};

use serde_json::json;

use crate::cases::altered;
use crate::support::Workspace;

#[test]
fn containers_and_weights() {
    let workspace = Workspace::small(2);
    let manifest = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    workspace.write(
        "manifest.toml",
        &manifest.replacen("[run]\n", "[run]\nstages = [\"robot-maps\"]\n", 1),
    );
    assert_eq!(
        workspace.rogs(&["run", "manifest.toml", "--no-report"]).status.code(),
        Some(0)
    );
    let expected = workspace.outputs("run");
    let clips: Vec<PathBuf> = expected
        .keys()
        .filter(|path| path.ends_with("clip.r4c"))
        .cloned()
        .collect();
    let [a, b] = [&clips[0], &clips[1]].map(|path| workspace.path("run").join(path));
    let inspect = |path: &Path| {
        let output = workspace.rogs(&["inspect", &path.display().to_string()]);
        assert_eq!(output.status.code(), Some(2));
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    // Cut, a flipped bit in the data, a file of the future, a file of another clip.
    let whole = std::fs::read(&a).unwrap();
    std::fs::write(&a, &whole[..whole.len() / 2]).unwrap();
    assert!(inspect(&a).contains("clip.r4c"));
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 4;
    std::fs::write(&a, flipped).unwrap();
    assert!(inspect(&a).contains("clip.r4c"));
    let (code, found) = workspace.rogs_json(&["verify", "run", "--json"]);
    assert_eq!((code, &found["good"]), (Some(1), &json!(3)));
    assert!(
        found["bad"][0]["output"].as_str().unwrap().ends_with("clip.r4c"),
        "{found:#}"
    );
    std::fs::copy(&b, &a).unwrap();
    let (code, found) = workspace.rogs_json(&["verify", "run", "--json"]);
    assert_eq!(code, Some(1), "a file at a wrong place: {found:#}");
    let (code, summary) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!((code, &summary["units"]["made"]), (Some(0), &json!(1)), "{summary:#}");
    assert!(workspace.outputs("run") == expected);

    let bytes = |header: &str| [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 16]].concat();
    let tensor = |more: &str| format!("{{\"a\":{{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[0,8]}}{more}}}");
    for (name, bytes) in [
        ("length", [&(1_u64 << 63).to_le_bytes()[..], &[b' '; 64]].concat()),
        (
            "overlap",
            bytes(&tensor(
                ",\"b\":{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[4,12]}",
            )),
        ),
        ("outside", bytes(&tensor("").replace("[0,8]", "[8000,8008]"))),
        ("shape", bytes(&tensor("").replace("[2]", "[4611686018427387904,4]"))),
        ("text", b"no weights".to_vec()),
    ] {
        let file = format!("{name}.safetensors");
        std::fs::write(workspace.path(&file), bytes).unwrap();
        let output = workspace.rogs(&["weights", "list", &file]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{name}: {said}");
        assert!(said.contains(&file) && !said.contains("panicked"), "{name}: {said}");
    }
    // Good in itself, but of another network: the run says so, for every clip.
    std::fs::write(workspace.path("other.safetensors"), bytes(&tensor(""))).unwrap();
    workspace.write("manifest.toml", &manifest);
    let (code, text) = altered(&workspace, "lift = \"builtin\"", "lift = \"other.safetensors\"");
    assert_eq!(code, Some(1), "{text}");
    assert!(
        text.contains("at lift: ") && text.contains("other.safetensors"),
        "{text}"
    );
}
