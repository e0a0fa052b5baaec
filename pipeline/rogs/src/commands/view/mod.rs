//! `rogs view`: the fields of a run, or one field, in the browser.

mod request;
mod server;

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};
use std::sync::{Arc, OnceLock};

use anyhow::{Context as _, bail, ensure};
use rogs_r4c::{read_header, read_key};
use rogs_report::{Player, RobotMesh, RunResults, SceneFiles, SceneSource, scenes_of, viewer_page};
use rogs_schemas::records::robot::RobotSpec;

use self::server::{Content, Server};
use crate::output;

/// Shows fields in the browser: turn, fly, play, compare. Ends with Ctrl-C.
///
/// A page is served on this machine alone (127.0.0.1), behind a random token. Nothing else can be reached through it, and the
/// page asks nobody else.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// A run folder, or a field (`field-1.r4c`).
    scene: PathBuf,
    /// Correction of Stage 2 to show beside a field. Default: `field-2.r4c` beside it, where it was made of this field.
    #[arg(long, value_name = "FILE")]
    refinement: Option<PathBuf>,
    /// Robot description to draw over a field; runs know theirs.
    #[arg(long, value_name = "FILE")]
    urdf: Option<PathBuf>,
    /// Only this clip of a run (by its id); may be given several times.
    #[arg(long, value_name = "CLIP")]
    clip: Vec<String>,
    /// Port to listen on; 0: any that is free.
    #[arg(long, value_name = "PORT", default_value_t = 0)]
    port: u16,
    /// Only print the address, and open no browser.
    #[arg(long)]
    no_open: bool,
    #[command(flatten)]
    beside: FieldFiles,
}

/// Files of the field's clip.
#[derive(Debug, clap::Args)]
struct FieldFiles {
    /// The clip of a field, for its cameras and images. Default: `clip.r4c` beside the field.
    #[arg(long, value_name = "FILE")]
    clip_file: Option<PathBuf>,
    /// Robot maps of the clip of a field. Default: `robot.r4c` beside the field.
    #[arg(long, value_name = "FILE")]
    robot: Option<PathBuf>,
}

/// Clips by name, with the files that their scenes are made of.
type Clips = Vec<(String, SceneFiles)>;

/// What a scene is called, and its bytes.
type Made = (&'static str, Arc<Vec<u8>>);

/// A clip whose scenes are made when they are first asked for.
struct Shown {
    name: String,
    files: SceneFiles,
    scenes: OnceLock<Result<Vec<Made>, String>>,
}

/// The page and the scenes.
struct Viewer {
    page: Arc<Vec<u8>>,
    clips: Vec<Shown>,
    robot: Option<RobotMesh>,
}

pub(crate) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let (title, clips, robot) = if args.scene.is_dir() {
        of_run(args)?
    } else {
        of_field(args)?
    };
    let viewer = Viewer::new(&title, clips, robot);
    // What cannot be shown is told before anything is opened.
    let first = viewer.clips.first().context("there is no clip to show")?;
    if let Err(what) = viewer.scenes(first) {
        bail!("clip `{}` cannot be shown: {what}", first.name);
    }
    let server = Server::listen(args.port)?;
    let address = server.address();
    output::text(&address)?;
    output::note("serving on this machine alone; end with Ctrl-C");
    if !args.no_open {
        open_browser(&address);
    }
    server.serve(&viewer);
    Ok(ExitCode::SUCCESS)
}

/// Clips of a run that have a field.
fn of_run(args: &Args) -> anyhow::Result<(String, Clips, Option<RobotMesh>)> {
    for (given, name) in [(&args.refinement, "--refinement"), (&args.urdf, "--urdf")] {
        ensure!(given.is_none(), "a run folder knows its files; leave `{name}` out");
    }
    let results = RunResults::read(&args.scene)?;
    let mut clips = results.scene_files();
    for wanted in &args.clip {
        let known = clips.iter().map(|(name, _)| name.as_str());
        if !known.clone().any(|name| name == wanted) {
            let meant = rogs_schemas::ids::suggestion(wanted, known);
            bail!("the run has no field of a clip `{wanted}`{meant}");
        }
    }
    clips.retain(|(name, _)| args.clip.is_empty() || args.clip.contains(name));
    ensure!(
        !clips.is_empty(),
        "no clip of `{}` has a field yet: `rogs status` says what is left",
        args.scene.display()
    );
    Ok((args.scene.display().to_string(), clips, results.robot_mesh()))
}

/// One field, with what lies beside it.
fn of_field(args: &Args) -> anyhow::Result<(String, Clips, Option<RobotMesh>)> {
    ensure!(args.clip.is_empty(), "`--clip` chooses clips of a run; a field is one");
    let field = &args.scene;
    let beside = |given: &Option<PathBuf>, name: &str| given.clone().unwrap_or_else(|| field.with_file_name(name));
    let made_of_it = |name: &str| Some(field.with_file_name(name)).filter(|path| made_of(path, field));
    let files = SceneFiles {
        field: field.clone(),
        refinement: args.refinement.clone().or_else(|| made_of_it("field-2.r4c")),
        fitted: made_of_it("field-fit.r4c"),
        polynomial: None,
        motion_bases: None,
        clip: beside(&args.beside.clip_file, "clip.r4c"),
        robot: beside(&args.beside.robot, "robot.r4c"),
    };
    // As it looks: no link is left out.
    let whole = RobotSpec {
        exclude_links: Vec::new(),
        collision_links: Vec::new(),
        ..RobotSpec::default()
    };
    let mesh = |urdf: &PathBuf| {
        RobotMesh::load(urdf, &whole).with_context(|| format!("reading the robot `{}`", urdf.display()))
    };
    let robot = args.urdf.as_ref().map(mesh).transpose()?;
    let title = field.display().to_string();
    Ok((title.clone(), vec![(title, files)], robot))
}

/// Whether a file was made of this field.
fn made_of(path: &Path, field: &Path) -> bool {
    let (Ok(made), Ok(key)) = (read_header(path), read_key(field)) else {
        return false;
    };
    let inputs = &made.info.provenance.material.inputs;
    inputs.get("field").is_some_and(|own| *own == key.to_string())
}

impl Viewer {
    fn new(title: &str, clips: Clips, robot: Option<RobotMesh>) -> Self {
        let player = |(index, (name, files)): (usize, &(String, SceneFiles))| {
            let source = |(number, name): (usize, &str)| {
                (name.to_owned(), SceneSource::Address(format!("scene/{index}/{number}")))
            };
            Player {
                name: name.clone(),
                scenes: files.names().into_iter().enumerate().map(source).collect(),
                notes: Vec::new(),
            }
        };
        let players: Vec<Player> = clips.iter().enumerate().map(player).collect();
        let page = viewer_page(&format!("rogs: {title}"), &players).into_string();
        let shown = |(name, files)| Shown {
            name,
            files,
            scenes: OnceLock::new(),
        };
        Self {
            page: Arc::new(rogs_schemas::shown::text(&page).into_owned().into_bytes()),
            clips: clips.into_iter().map(shown).collect(),
            robot,
        }
    }

    /// The scenes of a clip, made at the first call; why there are none.
    fn scenes<'a>(&self, clip: &'a Shown) -> Result<&'a [Made], &'a str> {
        let make = || {
            let made = scenes_of(&clip.files, self.robot.as_ref())
                .map_err(|error| format!("{:#}", anyhow::Error::new(error)))?;
            Ok(made.into_iter().map(|(name, bytes)| (name, Arc::new(bytes))).collect())
        };
        let made: &Result<Vec<Made>, String> = clip.scenes.get_or_init(make);
        made.as_deref().map_err(String::as_str)
    }
}

impl Content for Viewer {
    fn get(&self, path: &str) -> Option<(&'static str, Arc<Vec<u8>>)> {
        if path.is_empty() {
            return Some(("text/html; charset=utf-8", Arc::clone(&self.page)));
        }
        let (clip, scene) = path.strip_prefix("scene/")?.split_once('/')?;
        let clip = self.clips.get(clip.parse::<usize>().ok()?)?;
        match self.scenes(clip) {
            Ok(scenes) => {
                let (_, bytes) = scenes.get(scene.parse::<usize>().ok()?)?;
                Some(("application/octet-stream", Arc::clone(bytes)))
            }
            Err(what) => {
                output::warning(&format!("clip `{}` cannot be shown: {what}", clip.name));
                None
            }
        }
    }
}

/// Opens the page in the browser of the desktop, where there is one; its address was printed in any case.
fn open_browser(address: &str) {
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(windows) {
        "explorer"
    } else {
        "xdg-open"
    };
    let mut command = Command::new(program);
    command.arg(address);
    let quiet = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    if quiet.spawn().is_err() {
        output::note("no browser was opened: open the address above");
    }
}
