//! Named arrays in a stream: shapes in the record's head, values in parts, one chunk per (array, part).

use rogs_schemas::records::check::count;
use rogs_schemas::records::field::{NamedArray, array_length};

use crate::error::Result;
use crate::reader::Reader;
use crate::stream::StreamSpec;
use crate::writer::Writer;

/// Values of one chunk.
const PART: usize = 1 << 20;

/// Name and shape, as a record's head keeps them.
pub(crate) type ArrayHead = (String, Vec<u32>);

/// The heads of some arrays.
pub(crate) fn heads(arrays: &[NamedArray]) -> Vec<ArrayHead> {
    arrays
        .iter()
        .map(|array| (array.name.clone(), array.shape.clone()))
        .collect()
}

/// Adds the arrays as one stream.
pub(crate) fn write(writer: &mut Writer, spec: &StreamSpec, arrays: &[NamedArray]) -> Result<()> {
    let mut chunks = Vec::new();
    for (array, number) in arrays.iter().zip(0u32..) {
        chunks.extend(
            array
                .data
                .chunks(PART)
                .zip(0u32..)
                .map(|(part, index)| ([number, index, 0, 0], part)),
        );
    }
    writer.stream(spec, &[], &chunks)
}

/// Reads the arrays of a stream.
pub(crate) fn read(reader: &Reader, spec: &StreamSpec, heads: Vec<ArrayHead>) -> Result<Vec<NamedArray>> {
    let values = reader.stream::<f32>(spec, &[])?;
    let mut rest = values.as_slice();
    let mut arrays = Vec::with_capacity(heads.len());
    for (name, shape) in heads {
        let length = array_length(&name, &shape).map_err(|what| reader.inconsistent(what))?;
        let (data, after) = rest
            .split_at_checked(length)
            .ok_or_else(|| reader.inconsistent(format!("array `{name}` {shape:?} has too few values")))?;
        rest = after;
        arrays.push(NamedArray {
            name,
            shape,
            data: data.to_vec(),
        });
    }
    count("values beyond the arrays", rest.len(), 0).map_err(|what| reader.inconsistent(what))?;
    Ok(arrays)
}
