//! What people write, in the report.

use serde_json::Value;

use crate::cases::{Cases, Failure, Nothing};

#[test]
fn reports_show_names_and_run_none_of_them() {
    let mut cases = Cases::new();
    let script = "<script>alert(1)</script><img src=x onerror=alert(1)>";
    cases.edited("script", Nothing, |episode| {
        episode["episode_id"] = "<b>&\"bold\"".into();
        episode["task"] = script.into();
    });
    cases.edited("failing", Failure("\"<i>\"", ""), |episode| {
        episode["robot"]["states"] = "<i>".into()
    });
    let output = cases.workspace.rogs(&["run", "manifest.toml", "--json"]);
    let summary: Value = serde_json::from_slice(&output.stdout).unwrap();
    let html = std::fs::read_to_string(summary["report"].as_str().unwrap()).unwrap();
    assert!(html.contains("Content-Security-Policy") && html.contains("default-src 'none'"));
    // The last script is the viewer.
    let html = html.rsplit_once("<script>").map_or(html.as_str(), |(before, _)| before);
    for text in ["<script", "<img src=x", "<b>&", "<i>"] {
        assert!(!html.contains(text), "`{text}` is in the page as it is");
    }
    assert!(html.contains("&lt;i&gt;"), "what failed is told");
}
