//! Reading images and depth maps from files that belong to no manifest: PNG, JPEG, OpenEXR, numpy's `.npy` and `.npz`, and
//! safetensors.

use std::path::{Path, PathBuf};

use image::ImageDecoder as _;
use rogs_arrays::{Array, ArrayFile, FlatExr, Problem, Remarks, Values, within_budget};

use crate::metrics::Pixels;

/// Extensions of the files that are read.
pub const EXTENSIONS: [&str; 7] = ["png", "jpg", "jpeg", "exr", "npy", "npz", "safetensors"];
/// Largest image side that is read, pixels.
const MAX_SIDE: usize = 1 << 15;
/// Most memory that one decoded image may take, bytes.
const MAX_IMAGE_BYTES: u64 = 1 << 30;

/// What a file holds for one comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    /// Which of several in a file: the array's name and, with several times, the index. Empty for an image file.
    pub name: String,
    /// Rows.
    pub height: usize,
    /// Columns.
    pub width: usize,
    /// Its values.
    pub content: Content,
    /// What was taken for granted of it, or it says itself, and a person should know.
    pub notes: Vec<String>,
}

/// Metres of one step of 16-bit grey pixels, unless somebody says otherwise: millimetres, as ingest has them.
const PNG_STEP_M: f64 = 0.001;
/// What is said of them then.
const MILLIMETRES: &str = "16-bit grey pixels are taken as depth in millimetres";

/// Values of a picture.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// 8-bit colours. `[H, W, 3]`
    Bytes(Vec<u8>),
    /// Colours meant to lie in [0, 1]. `[H, W, 3]`
    Unit(Vec<f32>),
    /// Depth, metres. `[H, W]`
    Depth(Vec<f32>),
}

impl Content {
    /// The colours; none for depth.
    #[must_use]
    pub fn pixels(&self) -> Option<Pixels<'_>> {
        match self {
            Self::Bytes(values) => Some(Pixels::Bytes(values)),
            Self::Unit(values) => Some(Pixels::Unit(values)),
            Self::Depth(_) => None,
        }
    }
}

/// Why a file cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PictureError {
    /// The file cannot be read.
    #[error("reading `{}`", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file is not an image that can be read.
    #[error("not a readable image: `{}`", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// Why.
        source: image::ImageError,
    },
    /// A file holds something else than images.
    #[error("`{}`: {what}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
}

impl From<rogs_arrays::Error> for PictureError {
    fn from(error: rogs_arrays::Error) -> Self {
        let rogs_arrays::Error { path, problem } = error;
        match problem {
            Problem::Io(source) => Self::Read { path, source },
            Problem::Wrong(what) => Self::Wrong { path, what },
        }
    }
}

impl PictureError {
    fn wrong(path: &Path, what: impl Into<String>) -> Self {
        Self::Wrong {
            path: path.to_owned(),
            what: what.into(),
        }
    }
}

/// Reads all pictures of a file, in the order of their names.
///
/// PNG and JPEG files hold colours (16-bit ones keep their precision, an alpha channel is not looked at), turned as their
/// Exif data say; 16-bit grey PNG is depth in millimetres. OpenEXR files hold colours (channels R, G and B, taken as they are) or depth in metres (channel
/// Z, or the only one). In `.npy`, `.npz` and `.safetensors` files every array is taken: `[H, W, 3]` and `[T, H, W, 3]` are
/// colours, `[H, W]` and `[T, H, W]` (perhaps with a last axis of 1) depth in metres, and an array called `depth...` is depth
/// in any case; lists of numbers are passed over. `unit_m` are the metres of one step of depth where they are others.
///
/// # Errors
/// When the file cannot be read or holds something else.
pub fn read_pictures(path: &Path, unit_m: Option<f64>) -> Result<Vec<Picture>, PictureError> {
    let mut pictures = match extension(path).as_str() {
        "exr" => vec![read_exr(path)?],
        "npy" | "npz" | "safetensors" => read_arrays(path)?,
        "png" | "jpg" | "jpeg" => return Ok(vec![read_image(path, unit_m)?]),
        other => {
            let what = format!("files `.{other}` are not read; {} are", EXTENSIONS.join(", "));
            return Err(PictureError::wrong(path, what));
        }
    };
    if let Some(unit) = unit_m {
        for picture in &mut pictures {
            if let Content::Depth(values) = &mut picture.content {
                (values.iter_mut()).for_each(|value| *value = (f64::from(*value) * unit) as f32);
            }
        }
    }
    Ok(pictures)
}

/// The extension in lower case.
pub(crate) fn extension(path: &Path) -> String {
    let own = path.extension().and_then(|own| own.to_str());
    own.unwrap_or_default().to_ascii_lowercase()
}

fn read_image(path: &Path, unit_m: Option<f64>) -> Result<Picture, PictureError> {
    let read = |source| PictureError::Read {
        path: path.to_owned(),
        source,
    };
    let file = rogs_files::open(path).map_err(read)?;
    let length = file.metadata().map_err(read)?.len();
    let mut file = std::io::BufReader::new(file);
    let remarks = Remarks::read(&mut file).map_err(read)?;
    if let Some(fault) = remarks.fault {
        return Err(PictureError::wrong(path, fault));
    }
    let mut reader = image::ImageReader::new(file).with_guessed_format().map_err(read)?;
    let progressive = if reader.format() == Some(image::ImageFormat::Jpeg) {
        6
    } else {
        0
    };
    let mut limits = image::Limits::default();
    limits.max_image_width = Some(MAX_SIDE as u32);
    limits.max_image_height = Some(MAX_SIDE as u32);
    limits.max_alloc = Some(MAX_IMAGE_BYTES);
    reader.limits(limits);
    let unreadable = |source| PictureError::Image {
        path: path.to_owned(),
        source,
    };
    let decoder = reader.into_decoder().map_err(unreadable)?;
    let (width, height) = decoder.dimensions();
    let (bytes, channels) = (
        decoder.color_type().bytes_per_pixel(),
        decoder.color_type().channel_count(),
    );
    // The pixels as the file has them, and as three numbers of one or four bytes; of a JPEG its coefficients, too.
    let own = if bytes == channels { 3 } else { 12 };
    let a_pixel = u64::from(bytes) + own + progressive;
    let needed = (u64::from(width) * u64::from(height)).saturating_mul(a_pixel);
    within_budget(path, length, needed, "is it an image?")?;
    let mut image = image::DynamicImage::from_decoder(decoder).map_err(unreadable)?;
    remarks.turn(&mut image);
    let (height, width) = (image.height() as usize, image.width() as usize);
    let channels = usize::from(image.color().channel_count()).max(1);
    if let image::DynamicImage::ImageLuma16(steps) = image {
        let step = unit_m.unwrap_or(PNG_STEP_M);
        let depth_m = steps
            .into_raw()
            .into_iter()
            .map(|value| (f64::from(value) * step) as f32);
        return Ok(Picture {
            name: String::new(),
            height,
            width,
            content: Content::Depth(depth_m.collect()),
            notes: remarks
                .notes
                .into_iter()
                .chain(unit_m.is_none().then(|| MILLIMETRES.to_owned()))
                .collect(),
        });
    }
    let content = if usize::from(image.color().bytes_per_pixel()) == channels {
        Content::Bytes(image.into_rgb8().into_raw())
    } else {
        Content::Unit(image.into_rgb32f().into_raw())
    };
    Ok(Picture {
        name: String::new(),
        height,
        width,
        content,
        notes: remarks.notes,
    })
}

fn read_exr(path: &Path) -> Result<Picture, PictureError> {
    let mut image = FlatExr::open(path)?;
    let notes = std::mem::take(&mut image.notes);
    let (height, width) = (image.height, image.width);
    let chosen = channels(&image).map_err(|what| PictureError::wrong(path, what))?;
    let planes = image.planes(&chosen)?;
    let content = match <[Vec<f32>; 3]>::try_from(planes) {
        Ok([r, g, b]) => {
            let pixels = r.iter().zip(&g).zip(&b);
            Content::Unit(pixels.flat_map(|((r, g), b)| [*r, *g, *b]).collect())
        }
        Err(planes) => Content::Depth(planes.into_iter().flatten().collect()),
    };
    Ok(Picture {
        name: String::new(),
        height,
        width,
        content,
        notes,
    })
}

/// Positions of the channels R, G and B, or of the one that is depth.
fn channels(image: &FlatExr) -> Result<Vec<usize>, String> {
    let [r, g, b, z] = ["R", "G", "B", "Z"].map(|name| image.position(name));
    match (r, g, b, z, image.channels.len()) {
        (Some(r), Some(g), Some(b), _, _) => Ok(vec![r, g, b]),
        (_, _, _, Some(z), _) => Ok(vec![z]),
        (_, _, _, _, 1) => Ok(vec![0]),
        _ => Err(format!(
            "its channels are {}; colours need R, G and B, depth needs Z",
            image.channels.join(", ")
        )),
    }
}

fn read_arrays(path: &Path) -> Result<Vec<Picture>, PictureError> {
    let file = ArrayFile::open(path)?;
    let mut pictures = Vec::new();
    for name in file.names() {
        let array = file.need(&[&name])?;
        if array.shape.len() > 1 {
            pictures.extend(split(array).map_err(|what| PictureError::wrong(path, what))?);
        }
    }
    if pictures.is_empty() {
        let what = format!("it has no array of images; it has: {}", file.names().join(", "));
        return Err(PictureError::wrong(path, what));
    }
    Ok(pictures)
}

/// The pictures of one array.
fn split(array: Array) -> Result<Vec<Picture>, String> {
    let named_depth = array.name.starts_with("depth");
    let (times, height, width, colours) = match *array.shape.as_slice() {
        [height, width, 3] if !named_depth => (None, height, width, true),
        [times, height, width, 3] if !named_depth => (Some(times), height, width, true),
        [height, width] | [height, width, 1] => (None, height, width, false),
        [times, height, width] | [times, height, width, 1] => (Some(times), height, width, false),
        _ => {
            return Err(format!(
                "array `{}` has shape {:?}; colours are [H, W, 3] or [T, H, W, 3], depth is [H, W] or [T, H, W]",
                array.name, array.shape
            ));
        }
    };
    let Array { name, values, shape } = array;
    let size = height * width * if colours { 3 } else { 1 };
    if size == 0 {
        return Err(format!("array `{name}` is empty"));
    }
    let contents: Vec<Content> = match values {
        Values::Bytes(values) if colours => {
            (values.chunks_exact(size).map(|part| Content::Bytes(part.to_vec()))).collect()
        }
        Values::Bytes(_) => {
            return Err(format!(
                "array `{name}` of shape {:?} holds bytes, and depth has more steps; colours are [H, W, 3]",
                shape
            ));
        }
        Values::Floats(values) => {
            let kind = if colours { Content::Unit } else { Content::Depth };
            values.chunks_exact(size).map(|part| kind(part.to_vec())).collect()
        }
    };
    let picture = |(index, content)| Picture {
        name: times.map_or_else(|| name.clone(), |_| format!("{name}[{index}]")),
        height,
        width,
        content,
        notes: Vec::new(),
    };
    Ok(contents.into_iter().enumerate().map(picture).collect())
}
