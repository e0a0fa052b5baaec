//! What wide worlds are furnished with: photographs, models and light probes of a folder, and other robots by their URDF.
//! They are read once in a process; training runs without any.

mod robots;
mod simplify;

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use image::{ImageReader, Limits};
use rogs_arrays::FlatExr;
use rogs_robot::Mesh;
use rogs_robot::model::RobotFolder;
use rogs_schemas::records::robot::MeshAxes;
use rogs_synth::{Model, Photo, Props, Sky};

use self::simplify::simplified;
use crate::config::DataSettings;
use crate::error::{Error, Result};

/// Folders of a folder of props, as `tools/train/props/fetch.py` fills them.
const PHOTOS: &str = "photos";
const MODELS: &str = "models";
const PROBES: &str = "probes";
/// Most files of a kind that are read.
const MOST_FILES: usize = 4096;
/// Largest side of a photograph, pixels.
const LARGEST_PHOTO: u32 = 8192;
/// Most triangles of a model; larger ones are simplified.
const MOST_TRIANGLES: usize = 3000;

/// What was read, by what asked for it.
static READ: Mutex<Vec<(DataSettings, Arc<Props>)>> = Mutex::new(Vec::new());

/// The props that the settings name; nothing without a wide world.
///
/// # Errors
/// When a folder or file that is named cannot be read or used; the message names it.
pub fn props(data: &DataSettings) -> Result<Arc<Props>> {
    if data.world.is_none() || (data.props.is_none() && data.robots.is_empty()) {
        return Ok(Arc::default());
    }
    let asked = DataSettings {
        world: None,
        props: data.props.clone(),
        robots: data.robots.clone(),
        ..DataSettings::default()
    };
    let mut read = READ.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, props)) = read.iter().find(|(its, _)| *its == asked) {
        return Ok(props.clone());
    }
    let mut props = match &data.props {
        Some(folder) => of_folder(folder)?,
        None => Props::default(),
    };
    props.arms = data.robots.iter().map(robots::arm).collect::<Result<_>>()?;
    let props = Arc::new(props);
    read.push((asked, props.clone()));
    Ok(props)
}

fn of_folder(folder: &Path) -> Result<Props> {
    if !folder.is_dir() {
        return Err(unusable(
            folder,
            "is no folder; `tools/train/props/fetch.py` makes one, and without `data.props` training runs too",
        ));
    }
    let photos = files(&folder.join(PHOTOS), &["png", "jpg", "jpeg"])?;
    let models = files(&folder.join(MODELS), &["obj"])?;
    let probes = files(&folder.join(PROBES), &["exr"])?;
    if photos.is_empty() && models.is_empty() && probes.is_empty() {
        return Err(unusable(
            folder,
            "holds no `photos`, `models` or `probes`; `tools/train/props/fetch.py` makes them",
        ));
    }
    Ok(Props {
        photos: Arc::new(photos.iter().map(|path| photo(path)).collect::<Result<_>>()?),
        models: models.iter().map(|path| model(path)).collect::<Result<_>>()?,
        skies: probes.iter().map(|path| sky(path)).collect::<Result<_>>()?,
        arms: Vec::new(),
    })
}

/// Files of a folder with these endings, ascending by name; none where there is no folder.
fn files(folder: &Path, endings: &[&str]) -> Result<Vec<PathBuf>> {
    if !folder.exists() {
        return Ok(Vec::new());
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(Error::io(folder))? {
        let path = entry.map_err(Error::io(folder))?.path();
        let ending = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        if endings.contains(&ending.as_str()) {
            found.push(path);
        }
        if found.len() > MOST_FILES {
            return Err(unusable(
                folder,
                &format!("holds more than {MOST_FILES} files; leave fewer there"),
            ));
        }
    }
    found.sort();
    Ok(found)
}

fn unusable(path: &Path, reason: &str) -> Error {
    Error::Folder {
        path: path.to_owned(),
        reason: reason.to_owned(),
    }
}

fn photo(path: &Path) -> Result<Photo> {
    let file = rogs_files::open(path).map_err(Error::io(path))?;
    let mut reader = ImageReader::new(std::io::BufReader::new(file));
    let mut limits = Limits::default();
    limits.max_image_width = Some(LARGEST_PHOTO);
    limits.max_image_height = Some(LARGEST_PHOTO);
    reader.limits(limits);
    let decoded = reader
        .with_guessed_format()
        .map_err(Error::io(path))?
        .decode()
        .map_err(|error| unusable(path, &format!("is no picture: {error}")))?
        .into_rgb8();
    let (width, height) = decoded.dimensions();
    Photo::new(width as usize, height as usize, &decoded)
        .ok_or_else(|| unusable(path, "is smaller than 16 pixels; take it out of the folder"))
}

fn model(path: &Path) -> Result<Model> {
    let folder = RobotFolder::of_urdf(path).map_err(Error::io(path))?;
    let file = Mesh::load(path, &folder, MeshAxes::Viewers).map_err(|error| unusable(path, &error.chain()))?;
    let Mesh { positions, triangles } = simplified(file.mesh, MOST_TRIANGLES);
    Model::new(&positions, &triangles).ok_or_else(|| {
        unusable(
            path,
            "is no thing of a room: expected z up in metres, a box of 2 cm to 6 m; take it out of the folder",
        )
    })
}

fn sky(path: &Path) -> Result<Sky> {
    let wrong = |error: rogs_arrays::Error| unusable(path, &error.to_string());
    let file = FlatExr::open(path).map_err(wrong)?;
    let (width, height) = (file.width, file.height);
    let channels: Option<Vec<usize>> = ["R", "G", "B"].iter().map(|name| file.position(name)).collect();
    let channels = channels.ok_or_else(|| unusable(path, "has no channels R, G and B"))?;
    let planes = file.planes(&channels).map_err(wrong)?;
    let rgb: Vec<f32> = (0..width * height)
        .flat_map(|pixel| [0, 1, 2].map(|channel: usize| planes[channel][pixel]))
        .collect();
    Sky::new(width, height, &rgb).ok_or_else(|| unusable(path, "has no light, or numbers that are not finite"))
}

#[cfg(test)]
mod tests {
    use rogs_synth::World;

    use super::*;

    fn settings(folder: &Path) -> DataSettings {
        DataSettings {
            world: Some(World::default()),
            props: Some(folder.to_owned()),
            ..DataSettings::default()
        }
    }

    #[test]
    fn a_folder_gives_what_it_holds_and_is_named_where_it_cannot_be_used() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let refused = |root: &Path| of_folder(root).unwrap_err().to_string();
        assert!(refused(&root.join("none")).contains("is no folder"));
        assert!(refused(root).contains("holds no `photos`"));
        for kind in [PHOTOS, MODELS] {
            std::fs::create_dir(root.join(kind)).unwrap();
        }
        rogs_arrays::write_png(&root.join("photos/b.png"), (20, 16), &[200; 3 * 320]).unwrap();
        let triangle = b"v 0 0 0\nv 0.4 0 0\nv 0 0.3 0.5\nf 1 2 3\n";
        rogs_files::write_bytes(&root.join("models/a.obj"), triangle).unwrap();
        let read = props(&settings(root)).unwrap();
        assert_eq!((read.photos.len(), read.models.len(), read.skies.len()), (1, 1, 0));
        assert!(Arc::ptr_eq(&read, &props(&settings(root)).unwrap()), "read once");
        rogs_files::write_bytes(&root.join("photos/a.jpg"), b"no picture").unwrap();
        let said = refused(root);
        assert!(said.contains("a.jpg") && said.contains("is no picture"), "{said}");
    }

    #[test]
    fn plain_cells_need_no_folder() {
        let plain = DataSettings {
            world: None,
            ..settings(Path::new("/nowhere"))
        };
        assert!(props(&plain).unwrap().photos.is_empty());
        assert!(props(&settings(Path::new("/nowhere"))).is_err());
    }
}
