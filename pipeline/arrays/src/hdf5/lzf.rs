//! The LZF packing of h5py's filter 32000: runs of literals, and copies from what was unpacked before.

/// Unpacks a chunk; at most `limit` bytes come out.
pub(super) fn unpack(packed: &[u8], limit: usize) -> Result<Vec<u8>, String> {
    let cut = || "an LZF chunk is cut off".to_owned();
    let mut out: Vec<u8> = Vec::new();
    let mut rest = packed;
    while let [control, behind @ ..] = rest {
        rest = behind;
        if *control < 32 {
            let length = usize::from(*control) + 1;
            let (run, behind) = rest.split_at_checked(length).ok_or_else(cut)?;
            out.extend_from_slice(run);
            rest = behind;
        } else {
            let mut next = || {
                let (first, behind) = rest.split_first().ok_or_else(cut)?;
                rest = behind;
                Ok::<usize, String>(usize::from(*first))
            };
            let mut length = usize::from(control >> 5);
            if length == 7 {
                length += next()?;
            }
            let back = (usize::from(control & 31) << 8) + next()? + 1;
            let before = "an LZF chunk copies from before its beginning";
            let from = out.len().checked_sub(back).ok_or(before)?;
            // Source and destination may overlap: the bytes are copied one by one.
            for index in from..from + length + 2 {
                out.push(out[index]);
            }
        }
        if out.len() > limit {
            return Err(format!("an LZF chunk unpacks to more than {limit} bytes"));
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn literals_and_copies_are_unpacked() {
        assert_eq!(unpack(&[2, 7, 8, 9], 10).unwrap(), [7, 8, 9]);
        // `ab`, then five bytes from two back.
        assert_eq!(unpack(&[1, b'a', b'b', 3 << 5, 1], 10).unwrap(), b"abababa");
        // A long copy: 7 + 3 + 2 bytes from one back.
        assert_eq!(unpack(&[0, b'x', 7 << 5, 3, 0], 20).unwrap(), [b'x'; 13]);
    }

    #[test]
    fn damaged_chunks_are_refused() {
        for (packed, why) in [
            (&[4, 1, 2][..], "cut off"),
            (&[0, 1, 1 << 5], "cut off"),
            (&[0, 1, 1 << 5, 1], "before its beginning"),
            (&[0, 1, 7 << 5, 255, 0], "more than 20"),
        ] {
            assert!(unpack(packed, 20).unwrap_err().contains(why), "{packed:?}");
        }
    }
}
