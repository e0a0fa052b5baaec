//! Latents of a video tokenizer in place of RGB tokens (`docs/spec/latents.md`).
//!
//! A clip's latents are a safetensors file with metadata (all of them text): `rogs.kind` = `latents`, `episode_id`,
//! `stride` (8 or 16 pixels per latent), `temporal_stride` (4), `normalised` (`true` or `false`), `layout` (`concat_view` or
//! `per_camera`) and, for `concat_view`, `content` (`[rows, columns]` of the composite video without its padding). Tensors:
//! `latents` `[48, times, h, w]` of the composite (first source camera on top at full size, the other two below at half
//! size), or one `latents.CAMERA` for every source camera. Latent time `k` belongs to clip frame `temporal_stride * k`.

use std::path::Path;

use burn::tensor::{Device, Tensor};
use rogs_schemas::CameraIndex;
use rogs_stage1::Stage1;
use rogs_stage1::adapter::{LATENT_CHANNELS, LatentAdapter, to_token_cells};
use rogs_tensors::parameters::resident;
use rogs_tensors::parameters::{Parameters, from_host};
use rogs_weights::ParameterSource;
use rogs_weights::{KIND, TensorFile};
use rogs_worker::{StageError, StageResult};

use crate::source::Source;
use crate::{LiftParams, stage_error};

/// Kind of a latents file in its metadata.
pub const LATENTS: &str = "latents";

/// Means of the channels of the Wan2.2 tokenizer's latents; normalised latents are `(mu - mean) / deviation`.
const MEAN: [f32; LATENT_CHANNELS] = [
    -0.2289, -0.0052, -0.1323, -0.2339, -0.2799, 0.0174, 0.1838, 0.1557, -0.1382, 0.0542, 0.2813, 0.0891, 0.157,
    -0.0098, 0.0375, -0.1825, -0.2246, -0.1207, -0.0698, 0.5109, 0.2665, -0.2108, -0.2158, 0.2502, -0.2055, -0.0322,
    0.1109, 0.1567, -0.0729, 0.0899, -0.2799, -0.123, -0.0313, -0.1649, 0.0117, 0.0723, -0.2839, -0.2083, -0.052,
    0.3748, 0.0152, 0.1957, 0.1433, -0.2944, 0.3573, -0.0548, -0.1681, -0.0667,
];
/// Deviations of the channels.
const DEVIATION: [f32; LATENT_CHANNELS] = [
    0.4765, 1.0364, 0.4514, 1.1677, 0.5313, 0.499, 0.4818, 0.5013, 0.8158, 1.0344, 0.5894, 1.0901, 0.6885, 0.6165,
    0.8454, 0.4978, 0.5759, 0.3523, 0.7135, 0.6804, 0.5833, 1.4146, 0.8986, 0.5659, 0.7069, 0.5338, 0.4889, 0.4917,
    0.4069, 0.4999, 0.6866, 0.4093, 0.5709, 0.6065, 0.6415, 0.4944, 0.5726, 1.2042, 0.5458, 1.6887, 0.3971, 1.06,
    0.3943, 0.5537, 0.5444, 0.4089, 0.7468, 0.7744,
];

/// One camera's latents. `[48, times, rows, columns]`
struct Region {
    values: Vec<f32>,
    times: usize,
    rows: usize,
    columns: usize,
}

/// Where the numbers of a latents file lie.
struct LatentFile {
    file: TensorFile,
    name: String,
    stride: usize,
    temporal_stride: u32,
    normalised: bool,
}

/// The adapter's weights.
///
/// # Errors
/// When the file cannot be read or holds no adapter.
pub fn open_adapter(path: &Path, device: &Device) -> StageResult<Parameters> {
    let file = TensorFile::open(path).map_err(stage_error)?;
    if file.shape("adapter.patch_embed.proj.weight").is_none() {
        return Err(StageError::bad_input(format!(
            "`{}` holds no latent adapter (no tensor `adapter.patch_embed.proj.weight`)",
            path.display()
        )));
    }
    resident(&file, device).map_err(stage_error)
}

/// Patch tokens of the source views of a clip, from its latents. `[S, N, C]`
///
/// # Errors
/// When the file does not fit the clip, its regions do not fit the token grid, or the adapter does not fit the network.
pub(crate) fn tokens(
    path: &Path,
    adapter: &Parameters,
    network: &Stage1,
    source: &Source<'_>,
    params: &LiftParams,
) -> StageResult<Tensor<3>> {
    let cells = cells(path, network, source, params, network.parameters.device())?;
    let adapter = LatentAdapter::new(adapter.scope("adapter"), network.config.width, network.config.heads);
    adapter.forward(cells).map_err(stage_error)
}

/// Latents of the source views of a clip on the grid of 2 x 2 cells per token of the network. `[S, 48, 2 rows, 2 columns]`
///
/// # Errors
/// When the file does not fit the clip, or its regions do not fit the token grid.
pub(crate) fn cells(
    path: &Path,
    network: &Stage1,
    source: &Source<'_>,
    params: &LiftParams,
    device: &Device,
) -> StageResult<Tensor<4>> {
    let file = LatentFile::open(path, source, params)?;
    let (height, width) = (source.clip.height as usize, source.clip.width as usize);
    let grid = network.config.grid(height, width).map_err(stage_error)?;
    let mut cells = Vec::with_capacity(source.views.len());
    let mut region: Option<(CameraIndex, Region)> = None;
    for view in &source.views {
        let camera = view.view.camera;
        if region.as_ref().is_none_or(|(known, _)| *known != camera) {
            region = Some((camera, file.region(source, camera)?));
        }
        let Some((_, region)) = &region else { continue };
        let frame = view.view.frame;
        let time = (frame.0 / file.temporal_stride) as usize;
        if !frame.0.is_multiple_of(file.temporal_stride) || time >= region.times {
            return Err(file.bad(format!(
                "source frame {frame} has no latent: the file has {} times, one every {} frames",
                region.times, file.temporal_stride
            )));
        }
        let area = region.rows * region.columns;
        let values = (0..LATENT_CHANNELS)
            .flat_map(|channel| &region.values[(channel * region.times + time) * area..][..area])
            .copied()
            .collect();
        let one = from_host::<4>(values, [1, LATENT_CHANNELS, region.rows, region.columns], device);
        cells.push(to_token_cells(one, grid).map_err(|error| {
            file.bad(format!(
                "camera `{}`, stride {}: {error}",
                source.clip.cameras[camera.at()].id,
                file.stride
            ))
        })?);
    }
    Ok(Tensor::cat(cells, 0))
}

impl LatentFile {
    fn open(path: &Path, source: &Source<'_>, params: &LiftParams) -> StageResult<Self> {
        let file = TensorFile::open(path).map_err(stage_error)?;
        let mut opened = Self {
            name: path.display().to_string(),
            file,
            stride: 0,
            temporal_stride: 0,
            normalised: false,
        };
        if opened.text(KIND)? != LATENTS {
            return Err(opened.bad("its `rogs.kind` is not `latents`".into()));
        }
        let episode = opened.text("episode_id")?;
        if episode != source.clip.episode_id {
            return Err(opened.bad(format!(
                "it belongs to episode `{episode}`, the clip to `{}`",
                source.clip.episode_id
            )));
        }
        opened.stride = opened.number("stride")?;
        if ![8, 16].contains(&opened.stride) {
            return Err(opened.bad(format!("its stride is {}; 8 and 16 are supported", opened.stride)));
        }
        if let Some(asked) = params.latent_stride.filter(|&asked| asked as usize != opened.stride) {
            return Err(opened.bad(format!(
                "its stride is {}, `latent_stride` asks for {asked}",
                opened.stride
            )));
        }
        opened.temporal_stride = opened.number("temporal_stride")? as u32;
        if opened.temporal_stride == 0 {
            return Err(opened.bad("its temporal stride is 0".into()));
        }
        opened.normalised = match opened.text("normalised")? {
            "true" => true,
            "false" => false,
            other => return Err(opened.bad(format!("`normalised` must be true or false: `{other}`"))),
        };
        Ok(opened)
    }

    /// The latents of one camera, normalised.
    fn region(&self, source: &Source<'_>, camera: CameraIndex) -> StageResult<Region> {
        let mut region = match self.text("layout")? {
            "per_camera" => {
                let name = format!("latents.{}", source.clip.cameras[camera.at()].id);
                let (values, [times, rows, columns]) = self.tensor(&name)?;
                Region {
                    values,
                    times,
                    rows,
                    columns,
                }
            }
            "concat_view" => self.crop(source, camera)?,
            other => {
                return Err(self.bad(format!(
                    "its layout is `{other}`; `concat_view` and `per_camera` are supported"
                )));
            }
        };
        if !self.normalised {
            let size = region.times * region.rows * region.columns;
            for (channel, values) in region.values.chunks_exact_mut(size).enumerate() {
                for value in values {
                    *value = (*value - MEAN[channel]) / DEVIATION[channel];
                }
            }
        }
        if region.values.iter().any(|value| !value.is_finite()) {
            return Err(self.bad("it holds numbers that are not finite".into()));
        }
        Ok(region)
    }

    /// The part of a composite that shows one camera (`docs/spec/latents.md` section 2).
    fn crop(&self, source: &Source<'_>, camera: CameraIndex) -> StageResult<Region> {
        let cameras = source.clip.source_cameras();
        let place = cameras.iter().position(|&known| known == camera);
        let (Some(place), 3) = (place, cameras.len()) else {
            return Err(self.bad(format!(
                "a composite shows three cameras, the clip has {}",
                cameras.len()
            )));
        };
        let content: [usize; 2] = serde_json::from_str(self.text("content")?)
            .map_err(|error| self.bad(format!("`content` must be `[rows, columns]`: {error}")))?;
        let [tall, wide] = content;
        let (small_rows, small_columns) = (tall / 3, wide / 2);
        let (top, left, rows, columns) = match place {
            0 => (0, 0, tall - small_rows, wide),
            1 => (tall - small_rows, 0, small_rows, small_columns),
            _ => (tall - small_rows, small_columns, small_rows, small_columns),
        };
        let whole = tall.is_multiple_of(3) && wide.is_multiple_of(2);
        if !whole
            || [top, left, rows, columns]
                .iter()
                .any(|side| !side.is_multiple_of(self.stride))
        {
            return Err(self.bad(format!(
                "the borders between the cameras of a {tall} x {wide} composite do not lie between latents of stride {}",
                self.stride
            )));
        }
        let [top, left, rows, columns] = [top, left, rows, columns].map(|side| side / self.stride);
        let (values, [times, all_rows, all_columns]) = self.tensor("latents")?;
        if top + rows > all_rows || left + columns > all_columns {
            return Err(self.bad(format!(
                "its {all_rows} x {all_columns} latents are fewer than a {tall} x {wide} composite has at stride {}",
                self.stride
            )));
        }
        let mut cropped = Vec::with_capacity(LATENT_CHANNELS * times * rows * columns);
        for plane in values.chunks_exact(all_rows * all_columns) {
            for line in plane.chunks_exact(all_columns).skip(top).take(rows) {
                cropped.extend_from_slice(&line[left..left + columns]);
            }
        }
        Ok(Region {
            values: cropped,
            times,
            rows,
            columns,
        })
    }

    /// Values and sizes (times, rows, columns) of a tensor of latents.
    fn tensor(&self, name: &str) -> StageResult<(Vec<f32>, [usize; 3])> {
        match self.file.shape(name) {
            Some(&[LATENT_CHANNELS, times, rows, columns]) if times * rows * columns > 0 => {
                Ok((self.file.values(name).map_err(stage_error)?, [times, rows, columns]))
            }
            Some(shape) => Err(self.bad(format!("`{name}` is {shape:?}, expected [48, times, rows, columns]"))),
            None => Err(self.bad(format!("it has no tensor `{name}`"))),
        }
    }

    fn text(&self, key: &str) -> StageResult<&str> {
        let value = self.file.metadata().get(key).map(String::as_str);
        value.ok_or_else(|| self.bad(format!("its metadata has no `{key}`")))
    }

    fn number(&self, key: &str) -> StageResult<usize> {
        let text = self.text(key)?;
        text.parse()
            .map_err(|_| self.bad(format!("invalid number `{text}` in `{key}`")))
    }

    fn bad(&self, what: String) -> StageError {
        StageError::bad_input(format!("latents `{}`: {what}", self.name))
            .with_hint("docs/latents-format.md says what such a file holds")
    }
}
