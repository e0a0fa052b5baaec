//! A small writer of HDF5 files in the oldest form of the format, which every reader knows: superblock 0, groups with
//! symbol tables, contiguous data, attributes. Written from the HDF5 File Format Specification, version 3.0.

use std::collections::BTreeMap;

/// Address of what is not there.
const UNDEFINED: u64 = u64::MAX;
/// Symbols of a leaf, half of what one may hold.
const LEAF_K: usize = 32;
/// Leaves of a group, half of what one may have.
const INTERNAL_K: usize = 16;
/// Bytes of the superblock.
const SUPERBLOCK: usize = 96;

/// A group: what is in it and what is said of it.
#[derive(Debug, Clone, Default)]
pub struct Hdf5Group {
    attributes: Vec<(String, Attribute)>,
    groups: BTreeMap<String, Self>,
    datasets: BTreeMap<String, Dataset>,
}

#[derive(Debug, Clone)]
struct Dataset {
    shape: Vec<usize>,
    kind: Hdf5Kind,
    bytes: Vec<u8>,
    attributes: Vec<(String, Attribute)>,
}

/// Type of the numbers of a data set, little endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Hdf5Kind {
    /// Truth values as h5py keeps them: an enumeration of bytes.
    Truth,
    /// Unsigned, 16 bit.
    U16,
    /// Signed, 64 bit.
    I64,
    /// Half precision.
    F16,
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

/// Value of an attribute.
#[derive(Debug, Clone)]
enum Attribute {
    Truth(bool),
    Integer(i64),
    Text(String),
}

impl Hdf5Group {
    /// Says something true or false of it.
    pub fn truth(&mut self, name: &str, value: bool) -> &mut Self {
        self.set(name, Attribute::Truth(value))
    }

    /// Gives it a number.
    pub fn integer(&mut self, name: &str, value: i64) -> &mut Self {
        self.set(name, Attribute::Integer(value))
    }

    /// Gives it a text.
    pub fn text(&mut self, name: &str, value: &str) -> &mut Self {
        self.set(name, Attribute::Text(value.to_owned()))
    }

    fn set(&mut self, name: &str, value: Attribute) -> &mut Self {
        self.attributes.retain(|(own, _)| own != name);
        self.attributes.push((name.to_owned(), value));
        self
    }

    /// The group of a name in it, made when it is not there.
    pub fn group(&mut self, name: &str) -> &mut Self {
        self.groups.entry(name.to_owned()).or_default()
    }

    /// Adds a data set, row-major, with its flag `write_complete`; `None` leaves the flag out. One of that name is replaced;
    /// a group and a data set cannot have the same name.
    pub fn dataset(&mut self, name: &str, shape: &[usize], kind: Hdf5Kind, bytes: Vec<u8>, complete: Option<bool>) {
        let flag = complete.map(|flag| ("write_complete".to_owned(), Attribute::Truth(flag)));
        let dataset = Dataset {
            shape: shape.to_vec(),
            kind,
            bytes,
            attributes: flag.into_iter().collect(),
        };
        self.datasets.insert(name.to_owned(), dataset);
    }

    /// The file whose root this group is.
    #[must_use]
    pub fn file(&self) -> Vec<u8> {
        let mut out = vec![0; SUPERBLOCK];
        let root = write_group(&mut out, self);
        let mut block = Vec::with_capacity(SUPERBLOCK);
        block.extend(b"\x89HDF\r\n\x1a\n");
        block.extend([0, 0, 0, 0, 0, 8, 8, 0]);
        block.extend((LEAF_K as u16).to_le_bytes());
        block.extend((INTERNAL_K as u16).to_le_bytes());
        block.extend(0_u32.to_le_bytes());
        for address in [0, UNDEFINED, out.len() as u64, UNDEFINED] {
            block.extend(address.to_le_bytes());
        }
        block.extend(root.entry(0));
        out[..SUPERBLOCK].copy_from_slice(&block);
        out
    }
}

/// Where an object lies; groups also say where their tree and their names lie.
#[derive(Debug, Clone, Copy)]
struct Place {
    header: u64,
    table: Option<(u64, u64)>,
}

impl Place {
    /// Symbol table entry under a name at this offset of the heap.
    fn entry(self, name: u64) -> Vec<u8> {
        let (tree, heap) = self.table.unwrap_or_default();
        let mut entry = Vec::with_capacity(40);
        entry.extend(name.to_le_bytes());
        entry.extend(self.header.to_le_bytes());
        entry.extend(u32::from(self.table.is_some()).to_le_bytes());
        entry.extend(0_u32.to_le_bytes());
        entry.extend(tree.to_le_bytes());
        entry.extend(heap.to_le_bytes());
        entry
    }
}

/// Puts bytes at the next address that eight divides.
fn put(out: &mut Vec<u8>, bytes: &[u8]) -> u64 {
    out.resize(out.len().next_multiple_of(8), 0);
    let address = out.len() as u64;
    out.extend(bytes);
    address
}

fn write_group(out: &mut Vec<u8>, group: &Hdf5Group) -> Place {
    let mut names = vec![0_u8; 8];
    let mut entries = Vec::new();
    let mut members: BTreeMap<&str, Place> = BTreeMap::new();
    for (name, group) in &group.groups {
        members.insert(name, write_group(out, group));
    }
    for (name, dataset) in &group.datasets {
        members.insert(name, write_dataset(out, dataset));
    }
    for (name, place) in members {
        let offset = names.len() as u64;
        names.extend(name.as_bytes());
        names.push(0);
        names.resize(names.len().next_multiple_of(8), 0);
        entries.push((offset, place.entry(offset)));
    }
    let data = put(out, &names);
    let mut heap = b"HEAP\0\0\0\0".to_vec();
    heap.extend((names.len() as u64).to_le_bytes());
    heap.extend(1_u64.to_le_bytes()); // no free blocks
    heap.extend(data.to_le_bytes());
    let heap = put(out, &heap);

    let mut tree = b"TREE\0\0".to_vec();
    let leaves: Vec<&[(u64, Vec<u8>)]> = entries.chunks(2 * LEAF_K).collect();
    tree.extend((leaves.len() as u16).to_le_bytes());
    tree.extend(UNDEFINED.to_le_bytes());
    tree.extend(UNDEFINED.to_le_bytes());
    tree.extend(0_u64.to_le_bytes());
    for leaf in leaves {
        let mut node = b"SNOD\x01\0".to_vec();
        node.extend((leaf.len() as u16).to_le_bytes());
        node.extend(leaf.iter().flat_map(|(_, entry)| entry));
        node.resize(8 + 2 * LEAF_K * 40, 0);
        let last = leaf.last().map_or(0, |(name, _)| *name);
        tree.extend(put(out, &node).to_le_bytes());
        tree.extend(last.to_le_bytes());
    }
    tree.resize(24 + (4 * INTERNAL_K + 1) * 8, 0);
    let tree = put(out, &tree);
    let mut table = tree.to_le_bytes().to_vec();
    table.extend(heap.to_le_bytes());
    let mut messages = vec![(0x11, table)];
    messages.extend(group.attributes.iter().map(|own| (0x0c, attribute(own))));
    Place {
        header: header(out, &messages),
        table: Some((tree, heap)),
    }
}

fn write_dataset(out: &mut Vec<u8>, dataset: &Dataset) -> Place {
    let data = match dataset.bytes.is_empty() {
        true => UNDEFINED,
        false => put(out, &dataset.bytes),
    };
    let mut layout = vec![3, 1];
    layout.extend(data.to_le_bytes());
    layout.extend((dataset.bytes.len() as u64).to_le_bytes());
    let mut messages = vec![
        (0x01, dataspace(&dataset.shape)),
        (0x03, datatype(dataset.kind)),
        (0x05, vec![2, 2, 2, 1, 0, 0, 0, 0]),
        (0x08, layout),
    ];
    messages.extend(dataset.attributes.iter().map(|own| (0x0c, attribute(own))));
    Place {
        header: header(out, &messages),
        table: None,
    }
}

/// Object header of version 1.
fn header(out: &mut Vec<u8>, messages: &[(u16, Vec<u8>)]) -> u64 {
    let mut body = Vec::new();
    for (kind, data) in messages {
        let length = data.len().next_multiple_of(8);
        body.extend(kind.to_le_bytes());
        body.extend((length as u16).to_le_bytes());
        body.extend([0; 4]);
        body.extend(data);
        body.resize(body.len() + length - data.len(), 0);
    }
    let mut header = vec![1, 0];
    header.extend((messages.len() as u16).to_le_bytes());
    header.extend(1_u32.to_le_bytes());
    header.extend((body.len() as u32).to_le_bytes());
    header.extend([0; 4]);
    header.extend(body);
    put(out, &header)
}

/// Dataspace of version 1; no dimensions for a single value.
fn dataspace(shape: &[usize]) -> Vec<u8> {
    let mut space = vec![1, shape.len() as u8, 0, 0, 0, 0, 0, 0];
    space.extend(shape.iter().flat_map(|&side| (side as u64).to_le_bytes()));
    space
}

fn datatype(kind: Hdf5Kind) -> Vec<u8> {
    let integer = |size: u8, signed: bool| {
        let mut kind = vec![0x10, u8::from(signed) << 3, 0, 0, size, 0, 0, 0];
        kind.extend([0, 0, 8 * size, 0]);
        kind
    };
    // Sign and exponent location, sizes of exponent and mantissa, bias.
    let float = |size: u8, exponent: u8, mantissa: u8, bias: u32| {
        let mut kind = vec![0x11, 0x20, 8 * size - 1, 0, size, 0, 0, 0];
        kind.extend([0, 0, 8 * size, 0, mantissa, exponent, 0, mantissa]);
        kind.extend(bias.to_le_bytes());
        kind
    };
    match kind {
        Hdf5Kind::U16 => integer(2, false),
        Hdf5Kind::I64 => integer(8, true),
        Hdf5Kind::F16 => float(2, 5, 10, 15),
        Hdf5Kind::F32 => float(4, 8, 23, 127),
        Hdf5Kind::F64 => float(8, 11, 52, 1023),
        Hdf5Kind::Truth => {
            let mut kind = vec![0x18, 2, 0, 0, 1, 0, 0, 0];
            kind.extend(integer(1, true));
            kind.extend(b"FALSE\0\0\0TRUE\0\0\0\0");
            kind.extend([0, 1]);
            kind
        }
    }
}

/// Attribute message of version 1.
fn attribute((name, value): &(String, Attribute)) -> Vec<u8> {
    let (kind, data) = match value {
        Attribute::Truth(truth) => (datatype(Hdf5Kind::Truth), vec![u8::from(*truth)]),
        Attribute::Integer(integer) => (datatype(Hdf5Kind::I64), integer.to_le_bytes().to_vec()),
        Attribute::Text(text) => {
            let mut bytes = text.clone().into_bytes();
            bytes.push(0);
            let mut kind = vec![0x13, 0x10, 0, 0];
            kind.extend((bytes.len() as u32).to_le_bytes());
            (kind, bytes)
        }
    };
    let (mut title, space) = (name.clone().into_bytes(), dataspace(&[]));
    title.push(0);
    let mut message = vec![1, 0];
    for part in [&title, &kind, &space] {
        message.extend((part.len() as u16).to_le_bytes());
    }
    for part in [title, kind, space] {
        message.extend(&part);
        message.resize(message.len() + part.len().next_multiple_of(8) - part.len(), 0);
    }
    message.extend(data);
    message
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use rogs_arrays::{Hdf5File, Hdf5Value, le_bytes};

    use super::*;

    #[test]
    fn what_is_written_is_read_back() {
        let mut root = Hdf5Group::default();
        root.text("uuid", "LAB+a")
            .integer("count", -3)
            .truth("write_complete", true);
        // More members than one leaf holds.
        for index in 0..150 {
            let group = root.group(&format!("{index}:{}", index + 11));
            group.dataset(
                "x",
                &[2, 2],
                Hdf5Kind::F64,
                le_bytes(&[0.5, 1.0, f64::from(index), -2.0]),
                Some(true),
            );
        }
        let inner = root.group("a").group("b");
        inner.dataset("half", &[3], Hdf5Kind::F16, vec![0, 0x3c, 0, 0xc0, 0, 0x38], None);
        inner.dataset("flags", &[2], Hdf5Kind::Truth, vec![0, 1], Some(false));
        inner.dataset("none", &[0, 3], Hdf5Kind::F32, vec![], Some(true));
        inner.dataset("u16", &[1, 2], Hdf5Kind::U16, vec![7, 0, 255, 255], Some(true));
        let file = Hdf5File::from_bytes(Path::new("made.h5"), root.file()).unwrap();
        assert_eq!(file.groups("").unwrap().len(), 151);
        let attributes = file.attributes("").unwrap();
        assert_eq!(attributes["uuid"].text(), Some("LAB+a"));
        assert_eq!(
            (&attributes["count"], attributes["write_complete"].truth()),
            (&Hdf5Value::Integer(-3), Some(true))
        );
        let numbers = |at: &str| file.need(at).unwrap().read::<f64>().unwrap();
        assert_eq!(numbers("149:160/x"), [0.5, 1.0, 149.0, -2.0]);
        assert_eq!(numbers("a/b/half"), [1.0, -2.0, 0.5]);
        assert_eq!(numbers("a/b/flags"), [0.0, 1.0]);
        assert_eq!(numbers("a/b/u16"), [7.0, 65535.0]);
        assert_eq!(file.need("a/b/none").unwrap().shape(), [0, 3]);
        let flag = |at: &str| {
            file.need(at)
                .unwrap()
                .attributes()
                .unwrap()
                .get("write_complete")
                .cloned()
        };
        assert_eq!(flag("a/b/flags").unwrap().truth(), Some(false));
        assert_eq!(flag("a/b/half"), None);
    }
}
