//! Numpy's `.npy` format: versions 1 to 3, either order of axes and of bytes; written in C order, little endian.

use std::borrow::Cow;
use std::fs::File;
use std::io::{Read as _, Seek as _, SeekFrom};
use std::path::{Path, PathBuf};

use crate::dtype::{Dtype, Scalar, le_bytes};
use crate::error::{Error, Result};
use crate::shape;

/// What every file begins with.
const MAGIC: &[u8; 6] = b"\x93NUMPY";
/// Bytes from which magic, version and length of the header can be read.
const EDGE: usize = 12;
/// Longest header that is read, bytes.
const MAX_HEADER: usize = 1 << 16;
/// Most dimensions of an array.
const MAX_DIMENSIONS: usize = 8;

/// An open `.npy` file whose header is read and fits the length of the file.
#[derive(Debug)]
pub struct NpyFile {
    path: PathBuf,
    file: File,
    /// First byte of the numbers.
    start: usize,
    dtype: Dtype,
    layout: Layout,
    shape: Vec<usize>,
    /// All bytes of an array in Fortran order, turned to C order when they were first needed.
    turned: Option<Vec<u8>>,
}

/// How the numbers of an array lie.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
struct Layout {
    /// The highest byte of a number comes first.
    big_endian: bool,
    /// The first index runs fastest.
    fortran: bool,
}

impl Layout {
    /// Little-endian bytes in C order.
    fn plain(self, mut bytes: Vec<u8>, size: usize, shape: &[usize]) -> Vec<u8> {
        if self.big_endian {
            bytes.chunks_exact_mut(size).for_each(<[u8]>::reverse);
        }
        if self.fortran {
            bytes = c_order(&bytes, size, shape);
        }
        bytes
    }
}

/// Elements whose first index runs fastest, reordered so that the last one does.
fn c_order(bytes: &[u8], size: usize, shape: &[usize]) -> Vec<u8> {
    let strides: Vec<usize> = shape
        .iter()
        .scan(size, |next, &length| Some(std::mem::replace(next, *next * length)))
        .collect();
    let (mut index, mut at) = (vec![0; shape.len()], 0);
    let mut turned = Vec::with_capacity(bytes.len());
    while turned.len() < bytes.len() {
        turned.extend_from_slice(&bytes[at..at + size]);
        for axis in (0..shape.len()).rev() {
            index[axis] += 1;
            at += strides[axis];
            if index[axis] < shape[axis] {
                break;
            }
            at -= strides[axis] * shape[axis];
            index[axis] = 0;
        }
    }
    turned
}

impl NpyFile {
    /// Opens a file and reads its header.
    ///
    /// # Errors
    /// When the file cannot be read, is no `.npy` file, or is not as long as its shape says.
    pub fn open(path: &Path) -> Result<Self> {
        let io = |error| Error::io(path, error);
        let wrong = |what: String| Error::wrong(path, what);
        let mut file = rogs_files::open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let mut head = Vec::new();
        let read = |file: &mut File, head: &mut Vec<u8>, up_to: usize| {
            let missing = up_to.saturating_sub(head.len()) as u64;
            file.take(missing).read_to_end(head)
        };
        read(&mut file, &mut head, EDGE).map_err(io)?;
        let start = data_start(&head).map_err(wrong)?;
        read(&mut file, &mut head, start).map_err(io)?;
        let (dtype, layout, shape) = header(&head, start).map_err(wrong)?;
        if data_length(dtype, &shape).and_then(|bytes| bytes.checked_add(start)) != usize::try_from(length).ok() {
            let what = format!("the file has {length} bytes, which does not fit its shape {shape:?}");
            return Err(wrong(what));
        }
        Ok(Self {
            path: path.to_owned(),
            file,
            start,
            dtype,
            layout,
            shape,
            turned: None,
        })
    }

    /// Lengths of the dimensions.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Type of the numbers.
    #[must_use]
    pub fn dtype(&self) -> Dtype {
        self.dtype
    }

    /// Demands a shape; [`ANY`](crate::ANY) stands for any length.
    ///
    /// # Errors
    /// When it has another one.
    pub fn expect_shape(&self, expected: &[usize]) -> Result<()> {
        shape::mismatch(&self.shape, &[expected]).map_or(Ok(()), |what| Err(Error::wrong(&self.path, what)))
    }

    /// Demands floating-point values.
    ///
    /// # Errors
    /// When they are integers or halves.
    pub fn expect_floats(&self) -> Result<()> {
        match self.dtype {
            Dtype::F32 | Dtype::F64 => Ok(()),
            other => {
                let what = format!("the values are {other:?}, expected f32 or f64");
                Err(Error::wrong(&self.path, what))
            }
        }
    }

    /// All values of entry `index` along the first axis.
    ///
    /// # Errors
    /// When there is no such entry, or the file cannot be read.
    pub fn entry(&mut self, index: usize) -> Result<Vec<f64>> {
        let Some((_, rest)) = self.shape.split_first().filter(|(first, _)| index < **first) else {
            let what = format!("there is no entry {index} in shape {:?}", self.shape);
            return Err(Error::wrong(&self.path, what));
        };
        // The product with the first length, which is not 0, was found to be the file's.
        let length = rest.iter().product();
        self.read(index * length, length)
    }

    /// All values.
    ///
    /// # Errors
    /// When the file cannot be read.
    pub fn all(&mut self) -> Result<Vec<f64>> {
        let length = data_length(self.dtype, &self.shape).unwrap_or(0) / self.dtype.size();
        self.read(0, length)
    }

    fn read(&mut self, from: usize, count: usize) -> Result<Vec<f64>> {
        // The file is at least as long: its length was checked.
        let size = self.dtype.size();
        if !self.layout.fortran {
            let bytes = self.layout.plain(self.bytes(from, count)?, size, &[]);
            return Ok(self.dtype.doubles(&bytes));
        }
        let turned = match self.turned.take() {
            Some(turned) => turned,
            None => {
                let all = data_length(self.dtype, &self.shape).unwrap_or(0) / size;
                self.layout.plain(self.bytes(0, all)?, size, &self.shape)
            }
        };
        let values = self.dtype.doubles(&turned[from * size..(from + count) * size]);
        self.turned = Some(turned);
        Ok(values)
    }

    /// Bytes of some numbers as they lie in the file.
    fn bytes(&mut self, from: usize, count: usize) -> Result<Vec<u8>> {
        let size = self.dtype.size();
        let mut bytes = vec![0; count * size];
        let seek = self.file.seek(SeekFrom::Start((self.start + from * size) as u64));
        seek.and_then(|_| self.file.read_exact(&mut bytes))
            .map_err(|error| Error::io(&self.path, error))?;
        Ok(bytes)
    }
}

/// Shape and numbers, row-major, of a `.npy` file in memory: one that lies in an archive, say.
///
/// # Errors
/// A sentence that says what is wrong with it.
pub fn npy_numbers(bytes: &[u8]) -> std::result::Result<(Vec<usize>, Vec<f64>), String> {
    let (dtype, shape, data) = parse(bytes)?;
    Ok((shape, dtype.doubles(&data)))
}

/// Type, shape and bytes (little endian, C order).
type Parsed<'a> = (Dtype, Vec<usize>, Cow<'a, [u8]>);

/// What a `.npy` file in memory holds.
pub(crate) fn parse(bytes: &[u8]) -> std::result::Result<Parsed<'_>, String> {
    let start = data_start(bytes)?;
    let (dtype, layout, shape) = header(bytes, start)?;
    let data = &bytes[start..];
    if data_length(dtype, &shape) != Some(data.len()) {
        return Err(format!("shape {shape:?} does not fit its {} bytes", data.len()));
    }
    let data = if layout == Layout::default() {
        Cow::Borrowed(data)
    } else {
        Cow::Owned(layout.plain(data.to_vec(), dtype.size(), &shape))
    };
    Ok((dtype, shape, data))
}

/// Bytes of the numbers of an array; `None` on overflow.
fn data_length(dtype: Dtype, shape: &[usize]) -> Option<usize> {
    let count = |product: usize, &length: &usize| product.checked_mul(length);
    shape.iter().try_fold(1, count)?.checked_mul(dtype.size())
}

/// Where the numbers begin, by the first bytes of a file.
fn data_start(head: &[u8]) -> std::result::Result<usize, String> {
    let edge: [u8; EDGE] = head
        .first_chunk()
        .copied()
        .ok_or("it is cut off: too short for a .npy file")?;
    let (begin, length) = match (edge.starts_with(MAGIC), edge[6]) {
        (true, 1) => (10, usize::from(u16::from_le_bytes([edge[8], edge[9]]))),
        (true, 2 | 3) => (12, u32::from_le_bytes([edge[8], edge[9], edge[10], edge[11]]) as usize),
        (true, other) => return Err(format!("version {other} of the .npy format is not supported")),
        (false, _) if edge.starts_with(b"PK") => {
            return Err("it is an .npz archive, not a .npy file; save the array alone (`numpy.save`)".to_owned());
        }
        (false, _) => return Err("it is not a .npy file; save one with `numpy.save`".to_owned()),
    };
    if length > MAX_HEADER {
        return Err(format!("a header of {length} bytes is impossible"));
    }
    Ok(begin + length)
}

/// Type, layout and shape from the header that ends at `start`:
/// `{'descr': '<f4', 'fortran_order': False, 'shape': (3, 4), }`.
fn header(head: &[u8], start: usize) -> std::result::Result<(Dtype, Layout, Vec<usize>), String> {
    let header = head.get(10..start).ok_or("it is cut off in its header")?;
    let header = String::from_utf8_lossy(header);
    let after = |key: &str| {
        let (_, rest) = header
            .split_once(&format!("'{key}'"))
            .ok_or_else(|| format!("the header has no `{key}`"))?;
        let rest = rest
            .trim_start()
            .strip_prefix(':')
            .ok_or("the header is not a dictionary")?;
        Ok::<&str, String>(rest.trim_start())
    };
    let dtype = after("descr")?
        .strip_prefix('\'')
        .and_then(|rest| rest.split('\'').next())
        .ok_or("the value type is not plain")?;
    let little = dtype.strip_prefix('>').map(|rest| format!("<{rest}"));
    let big_endian = little.is_some();
    let dtype = Dtype::of_numpy(&little.unwrap_or_else(|| dtype.to_owned()))?;
    let fortran = !after("fortran_order")?.starts_with("False");
    let shape = after("shape")?
        .strip_prefix('(')
        .and_then(|rest| rest.split_once(')'))
        .ok_or("the header has no shape")?
        .0;
    // Python 2 wrote `3L`.
    let lengths = shape
        .split(',')
        .map(|text| text.trim().trim_end_matches('L'))
        .filter(|text| !text.is_empty());
    let lengths: std::result::Result<Vec<usize>, _> = lengths.map(str::parse).collect();
    let lengths = lengths.map_err(|_| format!("the shape ({shape}) is not a list of lengths"))?;
    if lengths.len() > MAX_DIMENSIONS {
        return Err(format!("{} dimensions are too many", lengths.len()));
    }
    Ok((dtype, Layout { big_endian, fortran }, lengths))
}

/// What comes before the numbers of an array of this type and shape: a header of version 1.0.
#[must_use]
pub fn npy_header<T: Scalar>(shape: &[usize]) -> Vec<u8> {
    let descr = T::DTYPE.numpy();
    let shape = spelled(shape);
    let mut text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}");
    // Magic, version and length take 10 bytes, the line break one; the numbers begin at a multiple of 64.
    let length = (10 + text.len() + 1).next_multiple_of(64) - 10;
    text.extend(std::iter::repeat_n(' ', length - 1 - text.len()));
    text.push('\n');
    let mut bytes = MAGIC.to_vec();
    bytes.extend([1, 0]);
    // A shape of at most a few numbers: far below 64 KiB.
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(text.as_bytes());
    bytes
}

/// A `.npy` file of an array, row-major.
#[must_use]
pub fn npy_bytes<T: Scalar>(shape: &[usize], values: &[T]) -> Vec<u8> {
    debug_assert_eq!(shape.iter().product::<usize>(), values.len(), "shape {shape:?}");
    let mut bytes = npy_header::<T>(shape);
    bytes.extend(le_bytes(values));
    bytes
}

/// A shape as Python writes a tuple: `()`, `(3,)`, `(2, 4, 5)`.
fn spelled(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        many => {
            let lengths: Vec<String> = many.iter().map(usize::to_string).collect();
            format!("({})", lengths.join(", "))
        }
    }
}

#[cfg(test)]
#[allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
mod tests {
    use super::*;
    use crate::ANY;

    /// A `.npy` of version 1.
    fn npy(header: &str, data: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(data);
        bytes
    }

    #[test]
    fn headers_of_numpy_are_understood() {
        let header = "{'descr': '<i2', 'fortran_order': False, 'shape': (2, 1), }   \n";
        let bytes = npy(header, &[1, 0, 255, 255]);
        let data = Cow::Borrowed([1, 0, 255, 255].as_slice());
        assert_eq!(parse(&bytes), Ok((Dtype::I16, vec![2, 1], data)));
        let scalar = npy("{'descr': '|b1', 'fortran_order': False, 'shape': (), }", &[1]);
        assert_eq!(parse(&scalar), Ok((Dtype::U8, vec![], Cow::Borrowed([1].as_slice()))));
        let of_python_2 = npy("{'descr': '|u1', 'fortran_order': False, 'shape': (2L, 1L), }", &[1, 2]);
        assert_eq!(parse(&of_python_2).unwrap().1, [2, 1]);
    }

    #[test]
    fn every_type_of_number_has_its_value() {
        for (descr, bytes, expected) in [
            ("|b1", vec![1], 1.0),
            ("|i1", vec![0xfe], -2.0),
            ("|u1", vec![0xfe], 254.0),
            ("<u2", vec![0x20, 0x03], 800.0),
            (">u2", vec![0x03, 0x20], 800.0),
            (">i4", vec![0xff, 0xff, 0xfc, 0xe0], -800.0),
            ("<u4", vec![0x20, 0x03, 0, 0], 800.0),
            ("<i8", vec![0x20, 0x03, 0, 0, 0, 0, 0, 0], 800.0),
            (">u8", vec![0, 0, 0, 0, 0, 0, 0x03, 0x20], 800.0),
            ("<f2", half::f16::from_f32(0.75).to_le_bytes().to_vec(), 0.75),
            (">f2", half::f16::from_f32(0.75).to_be_bytes().to_vec(), 0.75),
            (">f4", 0.75_f32.to_be_bytes().to_vec(), 0.75),
            (">f8", 0.75_f64.to_be_bytes().to_vec(), 0.75),
        ] {
            let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (1,), }}");
            assert_eq!(npy_numbers(&npy(&header, &bytes)).unwrap().1, [expected], "{descr}");
        }
        for descr in ["<V2", "<f16", "<c8", "|O", "<U4", "|S3", "<M8[ns]"] {
            let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (1,), }}");
            let why = npy_numbers(&npy(&header, &[0; 16])).unwrap_err();
            assert!(
                why.contains(&format!("`{descr}`")) && why.contains("use 32-bit floats"),
                "{why}"
            );
        }
    }

    /// `numpy.arange(6).reshape(2, 3)` in both orders of axes and of bytes, and with three axes.
    #[test]
    fn any_order_of_axes_and_of_bytes_gives_the_same_numbers() {
        let folder = tempfile::tempdir().unwrap();
        for (descr, order, shape, stored) in [
            ("<i2", "False", "(2, 3)", [0, 1, 2, 3, 4, 5]),
            ("<i2", "True", "(2, 3)", [0, 3, 1, 4, 2, 5]),
            (">i2", "True", "(2, 3)", [0, 3, 1, 4, 2, 5]),
            ("<i2", "True", "(3, 1, 2)", [0, 2, 4, 1, 3, 5]),
        ] {
            let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}");
            let data = stored.map(|value: i16| match descr.starts_with('>') {
                true => value.to_be_bytes(),
                false => value.to_le_bytes(),
            });
            let bytes = npy(&header, data.as_flattened());
            let expected = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
            assert_eq!(npy_numbers(&bytes).unwrap().1, expected, "{header}");
            let path = folder.path().join("a.npy");
            std::fs::write(&path, &bytes).unwrap();
            let mut file = NpyFile::open(&path).unwrap();
            let length = 6 / file.shape()[0];
            for entry in 0..file.shape()[0] {
                assert_eq!(
                    file.entry(entry).unwrap(),
                    expected[entry * length..][..length],
                    "{header}"
                );
            }
            assert_eq!(file.all().unwrap(), expected, "{header}");
        }
    }

    #[test]
    fn wrong_files_say_what_is_wrong() {
        let why = |header: &str, data: &[u8]| parse(&npy(header, data)).unwrap_err();
        let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (2,), }";
        let huge = header.replace("(2,)", "(99999999999, 99999999999)");
        assert!(why(&huge, &[0; 8]).contains("does not fit"));
        assert!(why(&header.replace("<f4", "|O"), &[0; 8]).contains("`|O`"));
        assert!(why("{                        }", &[0; 8]).contains("no `descr`"));
        assert!(parse(b"\x93NUMPY\x01\x00\xff\xff{}").unwrap_err().contains("cut off"));
        assert!(parse(b"PK0123456789").unwrap_err().contains(".npz archive"));
        assert!(parse(b"XX0123456789").unwrap_err().contains("not a .npy file"));
        assert!(parse(b"PK").unwrap_err().contains("too short"));
    }

    /// As `numpy.save` of numpy 2.4.6 writes them, but for the spare spaces that it leaves for growing arrays.
    #[test]
    fn headers_are_aligned_and_spell_shapes_as_numpy_does() {
        for (shape, text) in [
            (vec![], "()"),
            (vec![3], "(3,)"),
            (vec![2, 4], "(2, 4)"),
            (vec![2, 4, 5], "(2, 4, 5)"),
        ] {
            let bytes = npy_header::<f32>(&shape);
            assert_eq!(bytes.len() % 64, 0);
            let expected = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': {text}, }}");
            assert_eq!(String::from_utf8_lossy(&bytes[10..]).trim_end(), expected);
            assert_eq!(usize::from(u16::from_le_bytes([bytes[8], bytes[9]])), bytes.len() - 10);
        }
    }

    #[test]
    fn files_are_read_whole_and_by_entry() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        std::fs::write(&path, npy_bytes(&[2, 3], &[0_u32, 1, 2, 3, 4, 5])).unwrap();
        let mut file = NpyFile::open(&path).unwrap();
        file.expect_shape(&[ANY, 3]).unwrap();
        assert!(
            file.expect_shape(&[ANY])
                .unwrap_err()
                .to_string()
                .contains("expected [any]")
        );
        assert!(file.expect_floats().unwrap_err().to_string().contains("U32"));
        assert_eq!(file.entry(1).unwrap(), [3.0, 4.0, 5.0]);
        assert!(file.entry(2).unwrap_err().to_string().contains("no entry 2"));
        assert_eq!(file.all().unwrap(), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        let big = npy(
            "{'descr': '>i2', 'fortran_order': False, 'shape': (2,), }",
            &[0, 1, 255, 254],
        );
        std::fs::write(&path, big).unwrap();
        assert_eq!(NpyFile::open(&path).unwrap().all().unwrap(), [1.0, -2.0]);
        // No entries, whatever the other lengths.
        let empty = "{'descr': '<f4', 'fortran_order': False, 'shape': (0, 9999999999999, 9999999999999), }";
        std::fs::write(&path, npy(empty, &[])).unwrap();
        let mut file = NpyFile::open(&path).unwrap();
        assert!(file.entry(0).is_err());
        assert_eq!(file.all().unwrap(), [0.0; 0]);
        std::fs::write(&path, &npy(empty, &[])[..40]).unwrap();
        assert!(NpyFile::open(&path).unwrap_err().to_string().contains("cut off"));
    }
}
