//! The device: which adapter, its memory, and the building blocks that several passes use.

use std::sync::OnceLock;

use cubecl::prelude::*;
use cubecl::server::Handle;
use cubecl::wgpu::{AutoGraphicsApi, RuntimeOptions, WgpuDevice, try_init_setup};

use crate::error::{Result, SplatError};

use super::kernels::{WIDE, project, scan, sort};

/// A GPU, or what the system offers as one (Mesa's software Vulkan, for example).
#[derive(Clone)]
pub struct GpuDevice {
    pub(crate) client: Client,
    name: String,
    /// Largest buffer, bytes.
    largest: usize,
}

impl std::fmt::Debug for GpuDevice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("GpuDevice").field("name", &self.name).finish()
    }
}

static DEVICE: OnceLock<std::result::Result<GpuDevice, String>> = OnceLock::new();

impl GpuDevice {
    /// The system's preferred adapter; the same device in every call.
    ///
    /// # Errors
    /// When there is no adapter, or it cannot be opened.
    pub fn open() -> Result<Self> {
        DEVICE.get_or_init(first_adapter).clone().map_err(SplatError::gpu)
    }

    /// Name of the adapter, the interface it is reached through and the driver.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Uses no buffer larger than this, so that views are taken in smaller groups and memory is left to others.
    #[must_use]
    pub fn with_buffers_up_to(mut self, bytes: usize) -> Self {
        self.largest = self.largest.min(bytes);
        self
    }

    /// Largest number of 4-byte words of one array.
    pub(crate) fn most_words(&self) -> usize {
        (self.largest / 4).min(1 << 30)
    }

    /// Refuses an array that the device cannot hold in one piece.
    pub(crate) fn check_words(&self, what: &'static str, words: usize) -> Result<()> {
        if words > self.most_words() {
            return Err(SplatError::gpu(format!(
                "{what} take {words} words, more than the {} of one buffer of `{}`; render fewer or smaller views at once",
                self.most_words(),
                self.name
            )));
        }
        Ok(())
    }

    pub(crate) fn upload(&self, values: &[f32]) -> Buffer {
        self.upload_bytes(bytemuck::cast_slice(values), values.len())
    }

    pub(crate) fn upload_u32(&self, values: &[u32]) -> Buffer {
        self.upload_bytes(bytemuck::cast_slice(values), values.len())
    }

    fn upload_bytes(&self, bytes: &[u8], len: usize) -> Buffer {
        // There are no empty buffers.
        let handle = if bytes.is_empty() {
            self.client.create_from_slice(&[0; 4])
        } else {
            self.client.create_from_slice(bytes)
        };
        Buffer {
            handle,
            len: len.max(1),
        }
    }

    /// Words that hold anything.
    pub(crate) fn empty(&self, len: usize) -> Buffer {
        let len = len.max(1);
        Buffer {
            handle: self.client.empty(4 * len),
            len,
        }
    }

    pub(crate) fn zeros(&self, len: usize) -> Buffer {
        let buffer = self.empty(len);
        project::clear::launch(
            &self.client,
            grid(buffer.len.div_ceil(WIDE)),
            cube(WIDE),
            buffer.arg(),
            buffer.len as u32,
        );
        buffer
    }

    /// Waits for the buffers' contents.
    pub(crate) fn read(&self, buffers: &[&Buffer]) -> Result<Vec<Vec<f32>>> {
        let handles = buffers.iter().map(|b| b.handle.clone()).collect();
        let bytes = self.client.read(handles).map_err(|e| self.broken(&e))?;
        Ok(bytes
            .iter()
            .zip(buffers)
            .map(|(bytes, buffer)| bytemuck::pod_collect_to_vec(&bytes[..4 * buffer.len]))
            .collect())
    }

    pub(crate) fn read_u32(&self, buffer: &Buffer) -> Result<Vec<u32>> {
        let bytes = self
            .client
            .read_one(buffer.handle.clone())
            .map_err(|e| self.broken(&e))?;
        Ok(bytemuck::pod_collect_to_vec(&bytes[..4 * buffer.len]))
    }

    fn broken(&self, error: &dyn std::fmt::Debug) -> SplatError {
        SplatError::gpu(format!("`{}` failed: {error:?}", self.name))
    }

    /// Exclusive prefix sums of the first `count` words, and behind them the total: `[count + 1]`.
    pub(crate) fn scan(&self, input: &Buffer, count: usize) -> Buffer {
        let length = count + 1;
        let output = self.empty(length);
        let blocks = length.div_ceil(scan::BLOCK);
        let sums = self.empty(blocks);
        scan::blocks::launch(
            &self.client,
            grid(blocks),
            cube(WIDE),
            input.arg(),
            output.arg(),
            sums.arg(),
            length as u32,
            count as u32,
        );
        if blocks > 1 {
            let before = self.scan(&sums, blocks);
            scan::add::launch(
                &self.client,
                grid(blocks),
                cube(WIDE),
                output.arg(),
                before.arg(),
                length as u32,
            );
        }
        output
    }

    /// One word, after waiting for it.
    pub(crate) fn pick(&self, buffer: &Buffer, index: usize) -> Result<u32> {
        let out = self.empty(1);
        scan::pick::launch(&self.client, grid(1), cube(1), buffer.arg(), out.arg(), index as u32);
        Ok(self.read_u32(&out)?.first().copied().unwrap_or(0))
    }

    /// Stable sort of the first `count` pairs by the low `bits` of the keys.
    pub(crate) fn sort(&self, keys: Buffer, values: Buffer, count: usize, bits: u32) -> (Buffer, Buffer) {
        let (mut keys, mut values) = (keys, values);
        if count < 2 {
            return (keys, values);
        }
        let blocks = count.div_ceil(sort::BLOCK);
        let (mut other_keys, mut other_values) = (self.empty(count), self.empty(count));
        let histogram = self.empty(sort::DIGITS * blocks);
        for shift in (0..bits).step_by(sort::BITS as usize) {
            sort::histogram::launch(
                &self.client,
                grid(blocks),
                cube(WIDE),
                keys.arg(),
                histogram.arg(),
                count as u32,
                blocks as u32,
                shift,
            );
            let offsets = self.scan(&histogram, sort::DIGITS * blocks);
            sort::scatter::launch(
                &self.client,
                grid(blocks),
                cube(WIDE),
                keys.arg(),
                values.arg(),
                offsets.arg(),
                other_keys.arg(),
                other_values.arg(),
                count as u32,
                blocks as u32,
                shift,
            );
            std::mem::swap(&mut keys, &mut other_keys);
            std::mem::swap(&mut values, &mut other_values);
        }
        (keys, values)
    }
}

fn first_adapter() -> std::result::Result<GpuDevice, String> {
    let options = RuntimeOptions::try_default().map_err(|e| e.to_string())?;
    let device = WgpuDevice::default();
    let setup = try_init_setup::<AutoGraphicsApi>(&device, options).map_err(|error| {
        format!(
            "no graphics adapter can be used; a Vulkan driver must be installed (Mesa's mesa-vulkan-drivers has one in \
             software): {error}"
        )
    })?;
    let info = setup.adapter.get_info();
    let client = cubecl::Device::Wgpu(device).client();
    let largest = client.properties().memory.max_page_size as usize;
    Ok(GpuDevice {
        client,
        name: format!("{} ({:?}, {})", info.name, info.backend, info.driver_info),
        largest,
    })
}

/// An array of 4-byte words on the device.
#[derive(Clone)]
pub(crate) struct Buffer {
    handle: Handle,
    pub(crate) len: usize,
}

impl Buffer {
    /// As an argument of a kernel.
    #[allow(unsafe_code)] // the kernel language has no other way to name an array
    pub(crate) fn arg(&self) -> BufferArg {
        // SAFETY: the handle was made for `len` words, and every kernel argument is an array of 4-byte words.
        unsafe { BufferArg::from_raw_parts(self.handle.clone(), self.len) }
    }
}

/// A number of cubes, in two dimensions where one would be too long.
pub(crate) fn grid(cubes: usize) -> CubeCount {
    const LONGEST: usize = 32_768;
    if cubes <= LONGEST {
        CubeCount::Static(cubes.max(1) as u32, 1, 1)
    } else {
        CubeCount::Static(LONGEST as u32, cubes.div_ceil(LONGEST) as u32, 1)
    }
}

pub(crate) fn cube(units: usize) -> CubeDim {
    CubeDim::new_1d(units as u32)
}
