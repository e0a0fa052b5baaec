//! `.npy` files, version 1.0, little endian, C order.

use std::io::Write;

/// Writes the header for an array of this type (`<f4`, `<u4`, `|u1`) and shape.
pub(crate) fn write_header(out: &mut impl Write, kind: &str, shape: &[usize]) -> std::io::Result<()> {
    let mut sizes: String = shape.iter().map(|n| format!("{n}, ")).collect();
    if shape.len() > 1 {
        sizes.truncate(sizes.len() - 2);
    } else {
        sizes.truncate(sizes.len() - 1);
    }
    let mut text = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({sizes}), }}");
    // Magic, version and length take 10 bytes; data start at a multiple of 64.
    let padded = (10 + text.len() + 1).next_multiple_of(64) - 10;
    while text.len() + 1 < padded {
        text.push(' ');
    }
    text.push('\n');
    out.write_all(b"\x93NUMPY\x01\x00")?;
    out.write_all(&(text.len() as u16).to_le_bytes())?;
    out.write_all(text.as_bytes())
}

/// Writes numbers as f32.
pub(crate) fn write_f32(out: &mut impl Write, values: &[f32]) -> std::io::Result<()> {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    out.write_all(&bytes)
}

/// Writes numbers as u32.
pub(crate) fn write_u32(out: &mut impl Write, values: &[u32]) -> std::io::Result<()> {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    out.write_all(&bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_are_aligned_and_spell_shapes_as_numpy_does() {
        for (shape, text) in [(vec![3], "(3,)"), (vec![2, 4, 5], "(2, 4, 5)")] {
            let mut bytes = Vec::new();
            write_header(&mut bytes, "<f4", &shape).unwrap();
            assert_eq!(bytes.len() % 64, 0);
            let header = String::from_utf8_lossy(&bytes[10..]).into_owned();
            assert!(header.contains(&format!("'shape': {text}, }}")), "{header}");
        }
    }
}
