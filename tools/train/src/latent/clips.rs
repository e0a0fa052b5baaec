//! The clips that an adapter is trained on: records of a run, and latents made elsewhere.

use std::path::{Path, PathBuf};

use rogs_r4c::{Record, read_record};
use rogs_schemas::records::clip::Clip;
use rogs_schemas::records::conditioning::Conditioning;
use rogs_schemas::records::robot::RobotMaps;

use super::settings::LatentTraining;
use crate::error::{Error, Result};

/// A clip that has records and latents.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Place {
    folder: PathBuf,
    latents: PathBuf,
}

/// The records of a clip, and where its latents are.
pub struct LatentClip {
    pub(super) clip: Clip,
    pub(super) robot: RobotMaps,
    pub(super) conditioning: Conditioning,
    pub(super) latents: PathBuf,
}

/// The clips to train on and those to score, each ascending by name. Clips without latents or without all records are left
/// out.
///
/// # Errors
/// When a folder cannot be read or nothing is left to train on.
pub(super) fn find(settings: &LatentTraining) -> Result<[Vec<Place>; 2]> {
    let clips = settings.run.join("clips");
    let mut places = Vec::new();
    for entry in std::fs::read_dir(&clips).map_err(Error::io(&clips))? {
        let folder = entry.map_err(Error::io(&clips))?.path();
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let latents = settings.latents.join(format!("{name}.safetensors"));
        let records = ["clip", "robot", "conditioning"].map(|record| folder.join(format!("{record}.r4c")));
        if latents.is_file() && records.iter().all(|record| record.is_file()) {
            places.push(Place { folder, latents });
        }
    }
    places.sort_by(|a, b| a.folder.cmp(&b.folder));
    if places.len() <= settings.evaluation_clips {
        return Err(Error::Folder {
            path: clips,
            reason: format!(
                "{} clips have clip.r4c, robot.r4c, conditioning.r4c and a file CLIP.safetensors in `{}`; {} are held out, \
                 so at least {} are needed",
                places.len(),
                settings.latents.display(),
                settings.evaluation_clips,
                settings.evaluation_clips + 1
            ),
        });
    }
    let held_out = places.split_off(places.len() - settings.evaluation_clips);
    Ok([places, held_out])
}

impl Place {
    /// Reads the records.
    ///
    /// # Errors
    /// When one is damaged or of another version; the message names it.
    pub(super) fn read(&self) -> Result<LatentClip> {
        Ok(LatentClip {
            clip: record(&self.folder.join("clip.r4c"))?,
            robot: record(&self.folder.join("robot.r4c"))?,
            conditioning: record(&self.folder.join("conditioning.r4c"))?,
            latents: self.latents.clone(),
        })
    }
}

fn record<T: Record>(path: &Path) -> Result<T> {
    let read = read_record(path).map_err(|error| Error::Folder {
        path: path.to_owned(),
        reason: error.to_string(),
    })?;
    Ok(read.0)
}
