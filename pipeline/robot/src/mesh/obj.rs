//! Wavefront OBJ: positions and faces; everything else is skipped.

use super::{MAX_TRIANGLES, Mesh, Parsed, fan};

pub(super) fn parse(bytes: &[u8]) -> Parsed<Mesh> {
    let mut mesh = Mesh::default();
    let mut polygon = Vec::new();
    for (number, line) in bytes.split(|&byte| byte == b'\n').enumerate() {
        let refuse = |what: &str| format!("line {}: {what}", number + 1);
        let is_data =
            line.starts_with(b"v ") || line.starts_with(b"v\t") || line.starts_with(b"f ") || line.starts_with(b"f\t");
        if !is_data {
            continue;
        }
        let line = std::str::from_utf8(line).map_err(|_| refuse("not UTF-8"))?;
        let mut words = line.split_ascii_whitespace();
        if words.next() == Some("v") {
            let mut position = [0.0f32; 3];
            for value in &mut position {
                *value = words
                    .next()
                    .and_then(|word| word.parse().ok())
                    .ok_or_else(|| refuse("a vertex needs three numbers"))?;
            }
            mesh.positions.push(position);
        } else {
            polygon.clear();
            for word in words {
                polygon.push(corner(word, mesh.positions.len()).ok_or_else(|| refuse(&format!("no vertex `{word}`")))?);
            }
            if polygon.len() < 3 {
                return Err(refuse("a face needs three corners"));
            }
            fan(&polygon, &mut mesh.triangles);
            if mesh.triangles.len() > MAX_TRIANGLES {
                return Err(refuse("too many triangles"));
            }
        }
    }
    Ok(mesh)
}

/// `3`, `3/1`, `3//2`, `3/1/2`; negative numbers count back from the last vertex.
fn corner(word: &str, count: usize) -> Option<u32> {
    let index: i64 = word.split('/').next()?.parse().ok()?;
    let zero_based = if index < 0 { count as i64 + index } else { index - 1 };
    (0..count as i64).contains(&zero_based).then_some(zero_based as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_of_all_spellings() {
        let text = b"# a quad\nv 0 0 0\nv 1 0 0\nv 1 1 0 1.0\nv 0 1 0\nvn 0 0 1\nf 1/1/1 2//1 3/1 4\r\nf -4 -3 -2\n";
        let mesh = parse(text).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
    }

    #[test]
    fn damaged_files_name_the_line() {
        for (text, expected) in [
            ("v 0 0\n", "line 1: a vertex"),
            ("v 0 0 0\nf 1 2 3\n", "line 2: no vertex `2`"),
            ("v 0 0 0\nf 1 0 1\n", "no vertex `0`"),
            ("v 0 0 0\nf 1 -2 1\n", "no vertex `-2`"),
            ("v 0 0 0\nf 1 1\n", "three corners"),
            ("v a b c\n", "line 1"),
        ] {
            assert!(parse(text.as_bytes()).unwrap_err().contains(expected), "{text}");
        }
    }
}
