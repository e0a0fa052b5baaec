//! STL, binary and text.

use super::{MAX_TRIANGLES, Mesh, Parsed};

const HEADER: usize = 84;
const RECORD: usize = 50;

pub(super) fn parse(bytes: &[u8]) -> Parsed<Mesh> {
    let declared = bytes
        .get(80..HEADER)
        .map(|field| u32::from_le_bytes([field[0], field[1], field[2], field[3]]) as usize);
    let whole = declared.is_some_and(|count| bytes.len() == HEADER + RECORD * count);
    // Binary files may begin with `solid` too; only the size tells.
    let begins = bytes.trim_ascii_start().get(..5);
    if !whole && begins.is_some_and(|begins| begins.eq_ignore_ascii_case(b"solid")) {
        return parse_text(bytes);
    }
    let Some(count) = declared else {
        return Err(format!("{} bytes are too few for an STL file", bytes.len()));
    };
    let records = &bytes[HEADER..];
    if records.len() / RECORD < count {
        return Err(format!(
            "it declares {count} triangles, its size allows {}",
            records.len() / RECORD
        ));
    }
    if count > MAX_TRIANGLES {
        return Err(format!("it has {count} triangles, at most {MAX_TRIANGLES} are read"));
    }
    let mut mesh = Mesh {
        positions: Vec::with_capacity(3 * count),
        triangles: Vec::with_capacity(count),
    };
    for (index, record) in records.chunks_exact(RECORD).take(count).enumerate() {
        // A normal (12 bytes) comes before the three corners.
        for corner in record[12..48].chunks_exact(12) {
            let value = |at: usize| f32::from_le_bytes([corner[at], corner[at + 1], corner[at + 2], corner[at + 3]]);
            mesh.positions.push([value(0), value(4), value(8)]);
        }
        let first = 3 * index as u32;
        mesh.triangles.push([first, first + 1, first + 2]);
    }
    Ok(mesh)
}

fn parse_text(bytes: &[u8]) -> Parsed<Mesh> {
    let text = std::str::from_utf8(bytes).map_err(|_| "it starts like a text file but is not UTF-8".to_owned())?;
    let mut mesh = Mesh::default();
    let mut corners = 0u32;
    for (number, line) in text.lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        match words.next().map(str::to_ascii_lowercase).as_deref() {
            Some("vertex") => {
                let mut position = [0.0f32; 3];
                for value in &mut position {
                    let word = words.next().and_then(|word| word.parse().ok());
                    *value = word.ok_or_else(|| format!("line {}: a vertex needs three numbers", number + 1))?;
                }
                mesh.positions.push(position);
                corners += 1;
            }
            Some("endfacet") => {
                if corners != 3 {
                    return Err(format!("line {}: a facet with {corners} corners", number + 1));
                }
                let last = mesh.positions.len() as u32;
                mesh.triangles.push([last - 3, last - 2, last - 1]);
                corners = 0;
            }
            Some("facet") if corners != 0 => return Err(format!("line {}: a facet begins inside another", number + 1)),
            _ => {}
        }
    }
    if corners != 0 {
        return Err("the last facet does not end".into());
    }
    Ok(mesh)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn binary(count: u32, triangles: usize) -> Vec<u8> {
        let mut bytes = vec![b' '; 80];
        bytes.extend(count.to_le_bytes());
        for triangle in 0..triangles {
            bytes.extend([0; 12]);
            for value in 0..9 {
                bytes.extend(((triangle * 9 + value) as f32).to_le_bytes());
            }
            bytes.extend([0; 2]);
        }
        bytes
    }

    #[test]
    fn binary_and_text_agree() {
        let text = "solid a\nfacet normal 0 0 0\nouter loop\nvertex 0 1 2\nvertex 3 4 5\nvertex 6 7 8\nendloop\nendfacet\nendsolid";
        let mesh = parse(&binary(1, 1)).unwrap();
        assert_eq!(mesh, parse(text.as_bytes()).unwrap());
        assert_eq!(mesh.positions[2], [6.0, 7.0, 8.0]);
    }

    #[test]
    fn a_binary_file_may_begin_with_solid() {
        let mut bytes = binary(2, 2);
        bytes[..5].copy_from_slice(b"solid");
        assert_eq!(parse(&bytes).unwrap().triangles.len(), 2);
    }

    #[test]
    fn damaged_files_say_what_is_wrong() {
        assert!(parse(&binary(u32::MAX, 1)).unwrap_err().contains("declares 4294967295"));
        assert!(parse(b"short").unwrap_err().contains("too few"));
        assert!(parse(b"solid a\nfacet\nvertex 0 1").unwrap_err().contains("line 3"));
        assert!(
            parse(b"solid a\nfacet\nvertex 0 1 2\nendfacet")
                .unwrap_err()
                .contains("1 corners")
        );
        assert!(
            parse(b"solid a\nfacet\nvertex 0 1 2\n")
                .unwrap_err()
                .contains("does not end")
        );
    }
}
