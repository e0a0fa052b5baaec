//! Scenes of a run: which files they are made of, and the scripts beside the page.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use rogs_export::scene::SCENE_VERSION;
use rogs_orchestrator::Result;
use rogs_orchestrator::manifest::Manifest;
use rogs_orchestrator::stage::StageId;
use rogs_r4c::read_key;
use rogs_schemas::records::robot::RobotSpec;

use crate::players::{Player, SceneSource};
use crate::results::{ClipResults, RunResults};
use crate::scenes::{RobotMesh, SceneFiles, scenes_of};

/// Folder of the scenes beside the page.
const FOLDER: &str = "scenes";

impl RunResults {
    /// What the robot maps of the run were told of the robot.
    #[must_use]
    pub fn robot_spec(&self) -> RobotSpec {
        let own = self.plan.nodes.iter().find(|node| node.stage == StageId::RobotMaps);
        let told = own.and_then(|node| node.params.get("robot")).cloned();
        told.and_then(|value| serde_json::from_value(value).ok())
            .unwrap_or_default()
    }

    /// The robot of the run, where its description is still where the manifest says.
    #[must_use]
    pub fn robot_mesh(&self) -> Option<RobotMesh> {
        let (manifest, _) = Manifest::load(&self.plan.manifest).ok()?;
        RobotMesh::load(&manifest.robot.urdf, &self.robot_spec()).ok()
    }

    /// Clips that have a field, by name, with the files that a scene is made of.
    #[must_use]
    pub fn scene_files(&self) -> Vec<(String, SceneFiles)> {
        let of = |clip: &ClipResults| Some((clip.id.clone(), SceneFiles::of(clip)?));
        self.clips.iter().filter_map(of).collect()
    }
}

impl SceneFiles {
    pub(crate) fn of(clip: &ClipResults) -> Option<Self> {
        Some(Self {
            field: clip.field.clone()?,
            refinement: clip.refinement.clone(),
            fitted: clip.fitted.clone(),
            polynomial: clip.polynomial.clone(),
            motion_bases: clip.motion_bases.clone(),
            clip: clip.clip.clone()?,
            robot: clip.robot.clone()?,
        })
    }
}

/// Writes the scenes of a clip beside the page, unless those that are there are of the same files; none where it has no
/// field. What cannot be read is a note of the player.
///
/// # Errors
/// When a scene cannot be written.
pub(crate) fn beside_page(
    run: &Path,
    folder: &Path,
    index: usize,
    clip: &ClipResults,
    robot: Option<&RobotMesh>,
) -> Result<Option<Player>> {
    let Some(files) = SceneFiles::of(clip) else {
        return Ok(None);
    };
    let mut player = Player {
        name: clip.id.clone(),
        scenes: Vec::new(),
        notes: Vec::new(),
    };
    let scripts: Vec<(&str, String)> = (1..)
        .zip(files.names())
        .map(|(number, name)| (name, format!("{FOLDER}/{:04}-{number}.js", index + 1)))
        .collect();
    let stamp = stamp(&files, robot.is_some());
    let there = |script: &String| {
        stamp
            .as_ref()
            .is_some_and(|stamp| begins_with(&folder.join(script), stamp))
    };
    if !scripts.iter().all(|(_, script)| there(script)) {
        let scenes = match scenes_of(&files, robot) {
            Ok(scenes) => scenes,
            Err(error) => {
                player.notes.push(format!("no scene to play: {error}"));
                return Ok(Some(player));
            }
        };
        rogs_files::make_folder_below(run, &folder.join(FOLDER))?;
        for ((_, script), (_, bytes)) in scripts.iter().zip(scenes) {
            let stamp = stamp.as_deref().unwrap_or_default();
            let text = format!("{stamp}rogsScene(\"{script}\",\"{}\");\n", STANDARD.encode(bytes));
            rogs_files::write_bytes(&folder.join(script), text.as_bytes())?;
        }
    }
    player.scenes = scripts
        .into_iter()
        .map(|(name, script)| (name.to_owned(), SceneSource::Script(script)))
        .collect();
    Ok(Some(player))
}

/// First line of a script, which says what it was made of.
fn stamp(files: &SceneFiles, robot: bool) -> Option<String> {
    let field = read_key(&files.field).ok()?;
    let key = |path: &Option<PathBuf>| match path {
        Some(path) => Some(read_key(path).ok()?.to_string()),
        None => Some(String::new()),
    };
    let others = [&files.refinement, &files.fitted, &files.polynomial, &files.motion_bases];
    let others: Vec<String> = others.into_iter().map(key).collect::<Option<_>>()?;
    let mesh = if robot { "robot" } else { "" };
    Some(format!(
        "/* rogs-scene {SCENE_VERSION} {field} {} {mesh} */\n",
        others.join(" ")
    ))
}

/// Whether a file begins with these bytes.
fn begins_with(path: &Path, start: &str) -> bool {
    let mut found = Vec::new();
    let read = rogs_files::open(path).and_then(|file| file.take(start.len() as u64).read_to_end(&mut found));
    read.is_ok() && found == start.as_bytes()
}
