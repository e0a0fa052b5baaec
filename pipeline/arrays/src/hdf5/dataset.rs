//! Data sets of an HDF5 file.

use std::collections::BTreeMap;
use std::ops::Range;

use hdf5_reader::{Datatype, SliceInfo, SliceInfoElem, VarLenKind};

use super::attribute::{Hdf5Value, TextType, text};
use super::element::{Cell, Hdf5Element, Stored};
use super::file::{Hdf5File, found, values_of};
use crate::error::{Error, Result};
use crate::shape;

/// A data set of an open HDF5 file.
pub struct Hdf5Dataset<'a> {
    file: &'a Hdf5File,
    /// Where it is in the file, for messages.
    at: String,
    inner: hdf5_reader::Dataset,
    shape: Vec<usize>,
}

impl Hdf5File {
    /// A data set by its path in the file, if it is there.
    ///
    /// # Errors
    /// When the file is damaged on the way to it.
    pub fn dataset(&self, at: &str) -> Result<Option<Hdf5Dataset<'_>>> {
        let dataset = found(self.file.dataset(at)).map_err(|error| self.failed(at, error))?;
        dataset.map(|dataset| Hdf5Dataset::new(self, at, dataset)).transpose()
    }

    /// The same for a data set that must be there.
    ///
    /// # Errors
    /// When it is not there, too; the message says what the nearest group holds.
    pub fn need(&self, at: &str) -> Result<Hdf5Dataset<'_>> {
        match self.dataset(at)? {
            Some(dataset) => Ok(dataset),
            None => Err(Error::wrong(self.path(), self.missing(at))),
        }
    }

    /// All attributes of a group or data set (`""` is the root) by name.
    ///
    /// # Errors
    /// When there is no such object, or they are damaged.
    pub fn attributes(&self, at: &str) -> Result<BTreeMap<String, Hdf5Value>> {
        let Some(group) = found(self.file.group(at)).map_err(|error| self.failed(at, error))? else {
            return self.need(at)?.attributes();
        };
        let raw = group.raw_attributes().map_err(|error| self.failed(at, error))?;
        let reference = 8 + usize::from(group.offset_size());
        values_of(self, at, raw, reference, |bytes| {
            group.resolve_vlen_reference_bytes(bytes, 1)
        })
    }
}

impl<'a> Hdf5Dataset<'a> {
    pub(super) fn new(file: &'a Hdf5File, at: &str, inner: hdf5_reader::Dataset) -> Result<Self> {
        let shape: Option<Vec<usize>> = inner.shape().iter().map(|&dim| usize::try_from(dim).ok()).collect();
        let shape = shape.ok_or_else(|| file.wrong(at, "its shape is impossible"))?;
        Ok(Self {
            file,
            at: at.to_owned(),
            inner,
            shape,
        })
    }

    /// Lengths of the dimensions; none for a single value.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Where it is in the file: `observation/robot_state/joint_positions`.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.at
    }

    /// Whether it holds integers or truth values.
    #[must_use]
    pub fn is_whole(&self) -> bool {
        use crate::dtype::Dtype::{F16, F32, F64};
        Stored::of(self.inner.dtype()).is_some_and(|stored| !matches!(stored.dtype, F16 | F32 | F64))
    }

    /// Demands a shape; [`ANY`](crate::ANY) stands for any length.
    ///
    /// # Errors
    /// When it has another one.
    pub fn expect_shape(&self, expected: &[usize]) -> Result<()> {
        shape::mismatch(&self.shape, &[expected]).map_or(Ok(()), |what| Err(self.wrong(&what)))
    }

    /// All values, row-major.
    ///
    /// # Errors
    /// When the data are damaged, cut off, packed by an unknown filter, of another type, or larger than the file can hold.
    pub fn read<T: Hdf5Element>(&self) -> Result<Vec<T>> {
        self.bound(1, self.shape.iter().copied())?;
        let array = self.inner.read_array::<Cell<T>>().map_err(|error| self.failed(error))?;
        Ok(array.into_iter().map(|cell| cell.0).collect())
    }

    /// The values of some entries along the first axis, row-major; chunks of other entries are not read.
    ///
    /// # Errors
    /// As for [`read`](Self::read), and when there are no such entries.
    pub fn read_rows<T: Hdf5Element>(&self, rows: Range<usize>) -> Result<Vec<T>> {
        let Some((&count, rest)) = self.shape.split_first() else {
            return Err(self.wrong("it is a single value and has no rows"));
        };
        if rows.start > rows.end || rows.end > count {
            return Err(self.wrong(&format!("there are no rows {} to {} in {count}", rows.start, rows.end)));
        }
        if rows.is_empty() {
            return Ok(Vec::new());
        }
        self.bound(rows.len(), rest.iter().copied())?;
        let slice = |start: usize, end: usize| SliceInfoElem::Slice {
            start: start as u64,
            end: end as u64,
            step: 1,
        };
        let selections = std::iter::once(slice(rows.start, rows.end)).chain(rest.iter().map(|&end| slice(0, end)));
        let selection = SliceInfo {
            selections: selections.collect(),
        };
        let array = self
            .inner
            .read_slice::<Cell<T>>(&selection)
            .map_err(|error| self.failed(error))?;
        Ok(array.into_iter().map(|cell| cell.0).collect())
    }

    /// The texts of a data set of texts.
    ///
    /// # Errors
    /// As for [`read`](Self::read).
    pub fn texts(&self) -> Result<Vec<String>> {
        let kind = TextType::of(self.inner.dtype()).ok_or_else(|| self.wrong("its values are no texts"))?;
        let raw = self.inner.read_raw_bytes().map_err(|error| self.failed(error))?;
        Ok(match kind {
            TextType::Fixed(0, _) => return Err(self.wrong("its texts have no length")),
            TextType::Fixed(length, padding) => raw.chunks_exact(length).map(|bytes| text(bytes, padding)).collect(),
            TextType::Variable(padding) => self.resolve(&raw)?.iter().map(|bytes| text(bytes, padding)).collect(),
        })
    }

    /// The byte strings of a data set whose entries are byte strings of any length (images in files, say).
    ///
    /// # Errors
    /// As for [`read`](Self::read).
    pub fn byte_strings(&self) -> Result<Vec<Vec<u8>>> {
        let bytes = match self.inner.dtype() {
            Datatype::VarLen {
                base,
                kind: VarLenKind::Sequence,
                ..
            } => Stored::of(base).is_some_and(|stored| stored.dtype.size() == 1),
            _ => false,
        };
        if !bytes {
            return Err(self.wrong("its values are no byte strings of any length"));
        }
        let raw = self.inner.read_raw_bytes().map_err(|error| self.failed(error))?;
        self.resolve(&raw)
    }

    /// All attributes by name.
    ///
    /// # Errors
    /// When they are damaged.
    pub fn attributes(&self) -> Result<BTreeMap<String, Hdf5Value>> {
        let raw = self.inner.raw_attributes().map_err(|error| self.failed(error))?;
        let resolve = |reference: &[u8]| self.inner.resolve_vlen_reference_bytes(reference, 1);
        values_of(self.file, &self.at, raw, self.inner.vlen_reference_size(), resolve)
    }

    /// What references to the heap refer to. The same bytes may be referred to again and again: the sum is bounded.
    fn resolve(&self, raw: &[u8]) -> Result<Vec<Vec<u8>>> {
        let (mut found, mut sum) = (Vec::new(), 0);
        for reference in raw.chunks_exact(self.inner.vlen_reference_size()) {
            let bytes = self.inner.resolve_vlen_reference_bytes(reference, 1);
            let bytes = bytes.map_err(|error| self.failed(error))?;
            sum += bytes.len() as u64;
            if sum > self.file.limit() {
                return Err(self.wrong("it is larger than a file of this length can hold"));
            }
            found.push(bytes);
        }
        Ok(found)
    }

    /// Refuses a read that the file cannot hold.
    fn bound(&self, rows: usize, rest: impl Iterator<Item = usize>) -> Result<()> {
        let stored = Stored::of(self.inner.dtype()).ok_or_else(|| self.wrong("its values are no numbers"))?;
        let count = rest.fold(rows, usize::saturating_mul);
        let bytes = count.saturating_mul(stored.dtype.size());
        if bytes as u64 > self.file.limit() {
            return Err(self.wrong(&format!(
                "{bytes} bytes are more than a file of this length can hold, or than is read at once"
            )));
        }
        Ok(())
    }

    fn wrong(&self, what: &str) -> Error {
        self.file.wrong(&self.at, what)
    }

    fn failed(&self, error: hdf5_reader::error::Error) -> Error {
        self.file.failed(&self.at, error)
    }
}
