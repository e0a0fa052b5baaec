//! Any `.r4c` file: what is in it, and its streams as bytes.

use std::path::PathBuf;

use numpy::PyArray1;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use rogs_r4c::{Dtype, Frame, Reader, Unit};

use crate::error::read;

/// An open container: its index is read and checked, chunks are when they are asked for.
#[pyclass(frozen, module = "rogs._rogs")]
pub(crate) struct Container {
    reader: Reader,
    path: PathBuf,
}

/// Name, numpy type, shape of an element, unit, frame, what a NaN or 0 means.
type Stream = (String, &'static str, Vec<u32>, &'static str, &'static str, String);

#[pymethods]
impl Container {
    #[new]
    fn new(path: PathBuf) -> PyResult<Self> {
        let reader = Reader::open(&path).map_err(read)?;
        Ok(Self { reader, path })
    }

    #[getter]
    fn schema(&self) -> String {
        self.reader.header().schema
    }

    #[getter]
    fn version(&self) -> (u16, u16) {
        self.reader.header().version
    }

    #[getter]
    fn key(&self) -> String {
        self.reader.header().key.to_string()
    }

    #[getter]
    fn content(&self) -> String {
        self.reader.content_hash().to_string()
    }

    /// Canonical JSON.
    fn provenance(&self) -> String {
        serde_json::to_string(self.reader.provenance()).unwrap_or_default()
    }

    fn streams(&self) -> Vec<Stream> {
        let described = |stream: &rogs_r4c::StreamInfo| {
            (
                stream.name.clone(),
                dtype(stream.dtype),
                stream.shape.clone(),
                unit(stream.unit),
                frame(stream.frame),
                stream.fill.clone(),
            )
        };
        self.reader.streams().iter().map(described).collect()
    }

    /// Coordinates and numbers of elements of the chunks of a stream.
    fn chunks(&self, name: &str) -> PyResult<Vec<([u32; 4], u32)>> {
        self.known(name)?;
        self.reader.chunks(name).map_err(read)
    }

    /// A whole stream, bytes.
    fn read<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArray1<u8>>> {
        self.known(name)?;
        let bytes = py.detach(|| self.reader.stream_bytes(name)).map_err(read)?;
        Ok(PyArray1::from_vec(py, bytes))
    }

    /// A chunk of a stream, bytes.
    fn read_chunk<'py>(&self, py: Python<'py>, name: &str, at: [u32; 4]) -> PyResult<Bound<'py, PyArray1<u8>>> {
        let chunks = self.chunks(name)?;
        let Some(ordinal) = chunks.iter().position(|(coordinates, _)| *coordinates == at) else {
            return Err(PyKeyError::new_err(format!(
                "`{}`: stream `{name}` has no chunk {at:?}",
                self.path.display()
            )));
        };
        let bytes = py.detach(|| self.reader.chunk_bytes(name, ordinal)).map_err(read)?;
        Ok(PyArray1::from_vec(py, bytes))
    }
}

impl Container {
    fn known(&self, name: &str) -> PyResult<()> {
        if self.reader.has(name) {
            return Ok(());
        }
        let names: Vec<&str> = self
            .reader
            .streams()
            .iter()
            .map(|stream| stream.name.as_str())
            .collect();
        Err(PyKeyError::new_err(format!(
            "`{}` has no stream `{name}` (streams: {})",
            self.path.display(),
            names.join(", ")
        )))
    }
}

fn dtype(dtype: Dtype) -> &'static str {
    match dtype {
        Dtype::U8 => "u1",
        Dtype::U16 => "<u2",
        Dtype::U32 => "<u4",
        Dtype::I32 => "<i4",
        Dtype::F16 => "<f2",
        Dtype::F32 => "<f4",
        Dtype::F64 => "<f8",
    }
}

fn unit(unit: Unit) -> &'static str {
    match unit {
        Unit::One => "1",
        Unit::Metre => "m",
        Unit::InternalUnit => "iu",
        Unit::Radian => "rad",
        Unit::Pixel => "px",
        Unit::Second => "s",
    }
}

fn frame(frame: Frame) -> &'static str {
    match frame {
        Frame::None => "none",
        Frame::Recon => "recon",
        Frame::RobotBase => "robot_base",
        Frame::Camera => "camera",
    }
}
