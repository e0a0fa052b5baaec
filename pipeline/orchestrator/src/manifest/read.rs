//! Reading a manifest and making its paths absolute.

use std::io::Read as _;
use std::path::{Component, Path, PathBuf};

use super::{Manifest, Network, Weights, safe_name};
use crate::diagnose::{Text, from_toml_error};
use crate::error::{Error, Result, io};

/// Most bytes of a manifest that are read: more than 76,000 single episodes with paths of their own. What is made of the
/// text takes some forty times as much memory.
const MOST_BYTES: usize = 16 << 20;

/// The text of a manifest file.
fn read(path: &Path) -> Result<String> {
    let mut bytes = Vec::new();
    let file = rogs_files::open(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => Error::usage(format!("there is no manifest `{}`", path.display()))
            .with_hint("name a TOML file such as those in `manifests/`, or a run folder"),
        std::io::ErrorKind::InvalidInput => {
            Error::usage(format!("cannot read the manifest `{}`: {error}", path.display()))
                .with_hint("name a TOML file such as those in `manifests/`, or a run folder")
        }
        _ => io("cannot read the manifest", path)(error),
    })?;
    file.take(MOST_BYTES as u64 + 1)
        .read_to_end(&mut bytes)
        .map_err(io("cannot read the manifest", path))?;
    if bytes.len() > MOST_BYTES {
        let message = format!(
            "the manifest `{}` is larger than {} MiB",
            path.display(),
            MOST_BYTES >> 20
        );
        return Err(Error::usage(message).with_hint(
            "name a folder of episodes under `[input]`; `include` and `exclude` take some of them; or split the run",
        ));
    }
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        let line = error.as_bytes()[..at].iter().filter(|&&byte| byte == b'\n').count() + 1;
        Error::usage(format!("`{}` line {line}: not UTF-8 text", path.display()))
            .with_hint("save the manifest as UTF-8")
    })
}

impl Manifest {
    /// Reads and checks a manifest file and makes its paths absolute.
    ///
    /// # Errors
    /// When it cannot be read, is not TOML, has unknown names or wrong values; with line and column.
    pub fn load(path: &Path) -> Result<(Self, Text)> {
        let text = read(path)?;
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let folder = std::path::absolute(folder).map_err(io("cannot find", folder))?;
        Self::parse(&text, path, &folder)
    }

    /// The same from text; relative paths are taken from `folder`.
    ///
    /// # Errors
    /// See [`Manifest::load`].
    pub fn parse(text: &str, path: &Path, folder: &Path) -> Result<(Self, Text)> {
        let source = Text::new(path, text);
        let mut manifest: Self = toml::from_str(text).map_err(|error| from_toml_error(&source, &error))?;
        manifest.make_absolute(folder);
        manifest.check(&source)?;
        Ok((manifest, source))
    }

    fn make_absolute(&mut self, folder: &Path) {
        let fix = |path: &mut PathBuf| *path = normalise(&folder.join(&*path));
        let fix_some = |path: &mut Option<PathBuf>| path.iter_mut().for_each(fix);
        if self.run.out.as_os_str().is_empty() {
            self.run.out = Path::new("runs").join(safe_name(&self.run.name));
        }
        fix(&mut self.run.out);
        fix(&mut self.robot.urdf);
        if let Some(input) = &mut self.input {
            fix(&mut input.root);
            fix_some(&mut input.calibration);
            fix_some(&mut input.pointworld);
            fix_some(&mut input.selection);
        }
        for episode in &mut self.episodes {
            fix(&mut episode.root);
            fix_some(&mut episode.calibration);
            fix_some(&mut episode.pointworld);
        }
        self.predictions
            .iter_mut()
            .for_each(|prediction| fix(&mut prediction.root));
        self.latents.iter_mut().for_each(|latents| fix(&mut latents.root));
        self.sidecars.iter_mut().for_each(|sidecars| fix(&mut sidecars.root));
        if let Some(rollouts) = &mut self.rollouts {
            fix(&mut rollouts.root);
            fix_some(&mut rollouts.latents);
            fix_some(&mut rollouts.sidecars);
        }
        let weights =
            std::iter::once(&mut self.weights).chain(self.variants.iter_mut().map(|variant| &mut variant.weights));
        for weights in weights {
            let Weights {
                lift,
                refine,
                lpips,
                adapter,
                movies,
                four_dgt,
                dinov2,
            } = weights;
            for network in [lift, refine, movies, four_dgt, dinov2].into_iter().flatten() {
                if let Network::File(path) = network {
                    fix(path);
                }
            }
            [lpips, adapter].into_iter().for_each(&fix_some);
        }
        fix_some(&mut self.executor.programs);
    }
}

/// Removes `.` and `x/..` from a path by its text alone.
fn normalise(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for component in path.components() {
        match component {
            Component::CurDir => {}
            // A link may point elsewhere, so only a plain name before `..` that is not a link may be dropped.
            Component::ParentDir if out.file_name().is_some() && !out.is_symlink() => {
                out.pop();
            }
            other => out.push(other),
        }
    }
    out
}
