//! Variants of a run: the interventions of `manifests/ablations.toml`, and tokens from latents.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::print_stderr, clippy::too_many_lines)]

mod support;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use rogs_needs::needs;
use rogs_r4c::read_record;
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::field::Field;
use rogs_weights::{ElementType, TensorSource, write};
use serde_json::Value;
use support::Workspace;

/// The `[[variants]]` of the ablations manifest, as TOML.
fn variants() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../manifests/ablations.toml");
    let text = std::fs::read_to_string(path).unwrap();
    text[text.find("[[variants]]").unwrap()..].to_owned()
}

/// Adds text to the manifest of a workspace.
fn extend(workspace: &Workspace, name: &str, more: &str) {
    let text = std::fs::read_to_string(workspace.path(name)).unwrap();
    workspace.write(name, &format!("{text}\n{more}\n"));
}

/// Fields of a run by what they hold: the path of each, and a digest of its numbers without key and description.
fn fields(workspace: &Workspace, run: &str) -> BTreeMap<PathBuf, String> {
    let outputs = workspace.outputs(run);
    let paths = outputs.keys().filter(|path| path.ends_with("field-1.r4c"));
    let numbers = |path: &PathBuf| {
        let (field, _) = read_record::<Field>(&workspace.path(run).join(path)).unwrap();
        let mut text = format!("{:?}", (&field.position_m, &field.base_raw, &field.scale_cap_iu));
        for slice in &field.slices {
            text.push_str(&format!("{:?}", (&slice.displacement_m, &slice.moving_raw)));
        }
        (path.clone(), text)
    };
    paths.map(numbers).collect()
}

#[needs(long = "an episode lifted in ten ways")]
#[test]
fn every_intervention_has_a_field_of_its_own_and_shares_what_is_before_it() {
    let workspace = Workspace::with_episodes(1);
    let more = variants();
    for needed in [
        "within-camera",
        "anchoring = false",
        "fk_conditioning = false",
        "kinematics",
        "rgb_downsample = 8",
        "source_frames",
        "camera-wise",
    ] {
        assert!(more.contains(needed), "the ablations lack `{needed}`");
    }
    extend(&workspace, "manifest.toml", &more);
    // Fields alone: what comes after them is another test's.
    let text = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let text = text.replacen("[run]\n", "[run]\nstages = [\"lift\"]\n", 1);
    workspace.write("manifest.toml", &text);
    let (code, summary) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(0), "{summary:#}");

    let lifted = more.matches("\nlift = ").count();
    let outputs = workspace.outputs("run");
    for upstream in ["clip.r4c", "robot.r4c", "conditioning.r4c"] {
        let count = outputs.keys().filter(|path| path.ends_with(upstream)).count();
        assert_eq!(count, 1, "{upstream} is shared");
    }
    let fields = fields(&workspace, "run");
    assert_eq!(fields.len(), lifted + 1, "{:?}", fields.keys());
    let different: std::collections::BTreeSet<&String> = fields.values().collect();
    assert_eq!(different.len(), fields.len(), "two interventions gave the same field");
}

fn tensor(name: &str, shape: &[usize], value: impl Fn(usize) -> f32 + 'static) -> TensorSource<'static> {
    let count = shape.iter().product();
    TensorSource {
        name: name.into(),
        shape: shape.to_vec(),
        values: Box::new(move || Ok((0..count).map(&value).collect())),
    }
}

fn noise(k: usize) -> f32 {
    ((k * 7919) % 1009) as f32 / 1009.0 - 0.5
}

/// An adapter without blocks for a network of this width.
fn adapter(path: &Path, width: usize) {
    let tensors = vec![
        tensor("adapter.patch_embed.proj.weight", &[width, 48, 2, 2], |k| {
            noise(k) * 0.1
        }),
        tensor("adapter.patch_embed.proj.bias", &[width], |_| 0.0),
        tensor("adapter.ln.weight", &[width], |_| 1.0),
        tensor("adapter.ln.bias", &[width], |_| 0.0),
    ];
    write(path, &BTreeMap::new(), ElementType::F32, tensors).unwrap();
}

/// Latents of one latent per token for every source camera of a clip.
fn latents(path: &Path, clip: &Clip, scale: f32) {
    let (rows, columns) = (clip.height as usize / 14, clip.width as usize / 14);
    let metadata = [
        ("rogs.kind", "latents"),
        ("episode_id", clip.episode_id.as_str()),
        ("stride", "16"),
        ("temporal_stride", "4"),
        ("normalised", "true"),
        ("layout", "per_camera"),
    ];
    let metadata = metadata.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
    let tensors = clip.source_cameras().into_iter().map(|camera| {
        let name = format!("latents.{}", clip.cameras[camera.at()].id);
        tensor(&name, &[48, 5, rows, columns], move |k| noise(k) * scale)
    });
    write(path, &metadata, ElementType::F32, tensors.collect()).unwrap();
}

#[test]
fn latents_reach_the_lift_stage_by_manifest_and_are_part_of_its_key() {
    let workspace = Workspace::with_episodes(2);
    let plain = std::fs::read_to_string(workspace.path("manifest.toml")).unwrap();
    let plain = plain.replacen("[run]\n", "[run]\nstages = [\"lift\"]\n", 1);
    workspace.write("manifest.toml", &plain);
    let (code, summary) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(0), "{summary:#}");
    let before = workspace.outputs("run");
    let mut ids: Vec<String> = std::fs::read_dir(workspace.path("run/clips"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    ids.sort();

    // Asking for latents without naming any is refused, with what to write.
    let variant = "[[variants]]\nname = \"latent\"\nlift = { tokens = \"latents\" }\n";
    workspace.write("manifest.toml", &format!("{plain}\n{variant}"));
    let refused = workspace.rogs(&["plan", "manifest.toml"]);
    assert_eq!(refused.status.code(), Some(2));
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(message.contains("[latents]"), "{message}");
    let table = "[latents]\nroot = \"latents\"\n";
    std::fs::create_dir(workspace.path("latents")).unwrap();
    workspace.write("manifest.toml", &format!("{plain}\n{table}\n{variant}"));
    let refused = workspace.rogs(&["plan", "manifest.toml"]);
    let message = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(message.contains("adapter"), "{message}");

    // Only the first clip has latents: its variant is lifted, the other's fails by name, the main run is untouched.
    let width = rogs_stage1::Stage1Config::compact().width;
    adapter(&workspace.path("adapter.safetensors"), width);
    let (clip, _) = read_record::<Clip>(&workspace.path("run/clips").join(&ids[0]).join("clip.r4c")).unwrap();
    let file = workspace.path("latents").join(format!("{}.safetensors", ids[0]));
    latents(&file, &clip, 2.0);
    let variant = format!("{variant}weights = {{ adapter = \"adapter.safetensors\" }}\n");
    workspace.write("manifest.toml", &format!("{plain}\n{table}\n{variant}"));
    let (code, summary) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!(code, Some(3), "{summary:#}");
    assert_eq!(summary["units"]["made"], 1, "{summary:#}");
    let failure = summary["failures"][0].to_string();
    assert!(failure.contains(&ids[1]) && failure.contains("latents"), "{failure}");
    let after = workspace.outputs("run");
    assert!(before.iter().all(|(path, bytes)| after.get(path) == Some(bytes)));
    let fields = fields(&workspace, "run");
    let of_first = |(path, _): &(&PathBuf, &String)| path.starts_with(Path::new("clips").join(&ids[0]));
    let own: Vec<&String> = fields.iter().filter(of_first).map(|(_, numbers)| numbers).collect();
    assert!(own.len() == 2 && own[0] != own[1], "latent tokens make another field");

    // Other latents are another key: what is there is stale, and `plan --explain` says why.
    latents(&file, &clip, 1.0);
    let (_, summary): (_, Value) = workspace.rogs_json(&["run", "manifest.toml", "--no-report", "--json"]);
    assert_eq!(summary["units"]["made"], 1, "{summary:#}");
}
