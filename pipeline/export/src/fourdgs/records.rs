//! Bytes of records and of attribute streams.

/// Level of the compression of streams.
const LEVEL: u8 = 6;
/// How a stream codes its symbols: as they are, as differences to the element before, or one for all.
const RAW: u8 = 0;
const DIFFERENCES: u8 = 1;
const CONSTANT: u8 = 2;
/// zlib streams.
const DEFLATE: u8 = 0;

/// Little-endian bytes.
#[derive(Debug, Default)]
pub(super) struct Bytes(Vec<u8>);

impl Bytes {
    pub(super) fn put(&mut self, bytes: &[u8]) -> &mut Self {
        self.0.extend_from_slice(bytes);
        self
    }

    pub(super) fn u8(&mut self, value: u8) -> &mut Self {
        self.put(&[value])
    }

    pub(super) fn u16(&mut self, value: u16) -> &mut Self {
        self.put(&value.to_le_bytes())
    }

    pub(super) fn u32(&mut self, value: u32) -> &mut Self {
        self.put(&value.to_le_bytes())
    }

    pub(super) fn u64(&mut self, value: u64) -> &mut Self {
        self.put(&value.to_le_bytes())
    }

    pub(super) fn f64(&mut self, value: f64) -> &mut Self {
        self.put(&value.to_le_bytes())
    }

    /// Text behind its length.
    pub(super) fn text(&mut self, text: &str) -> &mut Self {
        self.u32(text.len() as u32).put(text.as_bytes())
    }

    /// Bytes behind their length.
    pub(super) fn blob(&mut self, bytes: &[u8]) -> &mut Self {
        self.u64(bytes.len() as u64).put(bytes)
    }

    /// Pairs of texts behind their length.
    pub(super) fn map(&mut self, pairs: &[(&str, &str)]) -> &mut Self {
        let mut inner = Self::default();
        for (key, value) in pairs {
            inner.text(key).text(value);
        }
        self.u32(inner.len() as u32).put(&inner.0)
    }

    /// A record; gives where its content begins.
    pub(super) fn record(&mut self, opcode: u8, fill: impl FnOnce(&mut Self)) -> usize {
        let mut content = Self::default();
        fill(&mut content);
        self.u8(opcode).u64(content.len() as u64);
        let start = self.len();
        self.put(&content.0);
        start
    }

    /// Writes over bytes that are there.
    pub(super) fn overwrite(&mut self, at: usize, bytes: &[u8]) {
        self.0[at..at + bytes.len()].copy_from_slice(bytes);
    }

    pub(super) fn len(&self) -> usize {
        self.0.len()
    }

    pub(super) fn bytes(&self) -> &[u8] {
        &self.0
    }

    pub(super) fn into_bytes(self) -> Vec<u8> {
        self.0
    }
}

/// An attribute stream: symbols of one attribute, so many channels an element.
pub(super) fn stream(attribute: u8, values: &[i32], channels: usize) -> Vec<u8> {
    let elements = values.len() / channels;
    let constant = elements > 1 && values.chunks_exact(channels).all(|row| row == &values[..channels]);
    let (mode, symbols) = if constant {
        (
            CONSTANT,
            values[..channels].iter().map(|value| zigzag(*value)).collect(),
        )
    } else {
        shorter(values, channels)
    };
    let largest = symbols.iter().copied().max().unwrap_or(0);
    let width = match largest {
        0..=0xff => 1,
        0x100..=0xffff => 2,
        _ => 4,
    };
    let mut planes = Vec::with_capacity(width * symbols.len());
    for plane in 0..width {
        planes.extend(symbols.iter().map(|symbol| (symbol >> (8 * plane)) as u8));
    }
    let payload = miniz_oxide::deflate::compress_to_vec_zlib(&planes, LEVEL);
    let mut out = Bytes::default();
    out.u8(attribute)
        .u8(width as u8)
        .u8(mode)
        .u8(DEFLATE)
        .u8(channels as u8);
    out.u32(elements as u32).blob(&payload);
    out.into_bytes()
}

/// The symbols as they are or as differences, whichever have fewer bits in all.
fn shorter(values: &[i32], channels: usize) -> (u8, Vec<u32>) {
    let raw: Vec<u32> = values.iter().map(|value| zigzag(*value)).collect();
    let before = |index: usize| index.checked_sub(channels).map_or(0, |before| values[before]);
    let differences: Vec<u32> = (values.iter().enumerate())
        .map(|(index, value)| zigzag(value.wrapping_sub(before(index))))
        .collect();
    let bits = |symbols: &[u32]| {
        symbols
            .iter()
            .map(|symbol| u64::from(32 - symbol.leading_zeros()))
            .sum::<u64>()
    };
    if bits(&differences) < bits(&raw) {
        (DIFFERENCES, differences)
    } else {
        (RAW, raw)
    }
}

fn zigzag(value: i32) -> u32 {
    ((value << 1) ^ (value >> 31)) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn symbols_lie_in_planes_and_the_shorter_code_wins() {
        assert_eq!(
            [0, -1, 1, -2, i32::MAX, i32::MIN].map(zigzag),
            [0, 1, 2, 3, u32::MAX - 1, u32::MAX]
        );
        let decoded = |bytes: &[u8]| miniz_oxide::inflate::decompress_to_vec_zlib(&bytes[17..]).unwrap();
        let ramp: Vec<i32> = (0..300).collect();
        let bytes = stream(13, &ramp, 1);
        assert_eq!(bytes[..5], [13, 1, DIFFERENCES, DEFLATE, 1]);
        assert_eq!(decoded(&bytes)[..3], [0, 2, 2]);
        let bytes = stream(5, &[400, 7, 400, 7], 2);
        assert_eq!(bytes[..5], [5, 2, CONSTANT, DEFLATE, 2]);
        assert_eq!(decoded(&bytes), [0x20, 14, 3, 0]);
        assert_eq!(stream(5, &[3, -3, 3, -3], 1)[2], RAW);
    }

    #[test]
    fn a_record_says_where_its_content_begins() {
        let mut out = Bytes::default();
        let start = out.record(7, |out| {
            out.text("ab").map(&[("k", "v")]);
        });
        assert_eq!(start, 9);
        assert_eq!(out.len(), 9 + 6 + 4 + 10);
        out.overwrite(start + 4, b"xy");
        assert_eq!(&out.bytes()[13..15], b"xy");
    }
}
