//! What this machine has.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Programs that a Slurm of its own is made of.
const SLURM: [&str; 5] = ["munged", "slurmctld", "slurmd", "sbatch", "sinfo"];

/// The package, and the robots that come as data without a module.
const PINOCCHIO_AND_ROBOTS: &str = "pinocchio, sys, pathlib; above = [q for p in sys.path for q in pathlib.Path(p).parents]; \
     assert any((p / 'share/example-robot-data').is_dir() for p in above)";

/// Why a need is not met, or `None` when it is; `why` is what the test says of a long run.
///
/// # Errors
/// When there is no such need.
pub(crate) fn missing(need: &str, why: &str) -> Result<Option<String>, String> {
    let unless = |there: bool, reason: &str| (!there).then(|| reason.to_owned());
    Ok(match need {
        "shared" => unless(
            Path::new(&shared_root()).is_dir(),
            "needs ../shared beside the checkout, or ROGS_SHARED",
        ),
        "ffmpeg" => unless(
            ["ffmpeg", "ffprobe"].into_iter().all(on_path),
            "needs ffmpeg and ffprobe",
        ),
        "libx264" => unless(encodes_h264(), "needs an ffmpeg with libx264"),
        "numpy" => unless(imports("numpy"), "needs Python with numpy (ROGS_PEER_PYTHON)"),
        "pillow" => unless(imports("PIL"), "needs Python with Pillow (ROGS_PEER_PYTHON)"),
        "opencv" => unless(imports("cv2"), "needs Python with OpenCV (ROGS_PEER_PYTHON)"),
        "pinocchio" => unless(
            imports(PINOCCHIO_AND_ROBOTS),
            "needs Python with pinocchio and example-robot-data (ROGS_PEER_PYTHON)",
        ),
        "zstandard" => unless(imports("zstandard"), "needs Python with zstandard (ROGS_PEER_PYTHON)"),
        "plyfile" => unless(imports("plyfile"), "needs Python with plyfile (ROGS_PEER_PYTHON)"),
        "pycolmap" => unless(imports("pycolmap"), "needs Python with pycolmap (ROGS_PEER_PYTHON)"),
        "fourdgs" => unless(imports("fourdgs"), "needs Python with fourdgs (ROGS_PEER_PYTHON)"),
        "cc" => unless(on_path("cc"), "needs a C compiler (cc)"),
        "qemu" => unless(
            cfg!(target_arch = "x86_64") && on_path("qemu-x86_64-static"),
            "needs qemu-x86_64-static on an x86-64 machine",
        ),
        // Another program of this name is in moreutils.
        "parallel" => unless(
            succeeds("parallel", &["--will-cite", "--version"]),
            "needs GNU parallel",
        ),
        "hyperqueue" => unless(imports("hyperqueue"), "needs Python with hyperqueue (ROGS_PEER_PYTHON)"),
        "chromium" => unless(on_path("chromium"), "needs chromium"),
        "node" => unless(
            on_path("node") && viewer_modules().is_dir(),
            "needs node, and `npm ci` in pipeline/report/viewer",
        ),
        "bash" => unless(on_path("bash"), "needs bash"),
        // A mount namespace takes the same right as a mount, and leaves nothing behind.
        "mount" => unless(succeeds("unshare", &["--mount", "true"]), "needs the right to mount"),
        "slurm" => unless(
            is_root() && SLURM.into_iter().all(on_path),
            "needs root, Slurm and munge",
        ),
        "long" => unless(
            std::env::var_os("ROGS_LONG_TESTS").is_some(),
            &format!("long ({why}): needs ROGS_LONG_TESTS=1"),
        ),
        _ => {
            return Err(format!(
                "unknown need `{need}`; see the table of the crate `rogs-needs`"
            ));
        }
    })
}

/// The folder of reference data, there or not.
pub(crate) fn shared_root() -> String {
    let beside = || {
        let here = Path::new(env!("CARGO_MANIFEST_DIR"));
        let workspace = here.ancestors().nth(2).unwrap_or(here);
        workspace.join("../shared")
    };
    let root = std::env::var_os("ROGS_SHARED").map_or_else(beside, PathBuf::from);
    root.to_string_lossy().into_owned()
}

/// What `npm ci` installs for the viewer.
fn viewer_modules() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../pipeline/report/viewer/node_modules")
}

fn on_path(program: &str) -> bool {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    std::env::split_paths(&folders).any(|folder| folder.join(program).is_file())
}

fn imports(module: &str) -> bool {
    let python = std::env::var("ROGS_PEER_PYTHON").unwrap_or_else(|_| "python3".into());
    succeeds(&python, &["-c", &format!("import {module}")])
}

fn encodes_h264() -> bool {
    said("ffmpeg", &["-v", "quiet", "-encoders"]).contains("libx264")
}

fn is_root() -> bool {
    said("id", &["-u"]).trim() == "0"
}

fn succeeds(program: &str, arguments: &[&str]) -> bool {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null());
    command.output().is_ok_and(|output| output.status.success())
}

/// Standard output of a program; empty when it cannot be run.
fn said(program: &str, arguments: &[&str]) -> String {
    let mut command = Command::new(program);
    command.args(arguments).stdin(Stdio::null());
    let output = command.output().map(|output| output.stdout).unwrap_or_default();
    String::from_utf8_lossy(&output).into_owned()
}
