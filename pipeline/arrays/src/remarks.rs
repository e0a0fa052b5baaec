//! What PNG and JPEG files say beside their pixels. This is the one list of it: each entry is honoured, refused or told.
//!
//! | what | PNG | JPEG | |
//! |---|---|---|---|
//! | orientation of Exif | `eXIf` | APP1 | pixels are turned, as viewers show them, and it is told |
//! | aspect of pixels | `pHYs` | APP0 (JFIF) | told: pixels are taken as stored |
//! | animation | `acTL` | | told: the first picture is read |
//! | colours of another space | `iCCP`, `cICP`, `cHRM` | APP2 (ICC) | told where they are not those of sRGB |
//! | linear and other gamma | `gAMA` | | told where it is not that of sRGB |
//! | CMYK | | four components | refused |
//!
//! `sRGB` goes before `gAMA` and `cHRM`. Times, texts, previews, backgrounds, histograms and significant bits (`tIME`,
//! `tEXt`, `bKGD`, `hIST`, `sBIT`, APP13, COM and the like) say nothing about which pixel is where or what it means.

use std::io::{Read, Result, Seek, SeekFrom};

use image::DynamicImage;
use image::metadata::Orientation;

/// Segments that are looked at: more stand before no picture.
const MAX_SEGMENTS: usize = 4096;
/// Bytes of a segment that are looked at.
const MAX_BYTES: u64 = 1 << 16;

/// What a file says of its pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct Remarks {
    orientation: Orientation,
    /// What a person should know, one statement each.
    pub notes: Vec<String>,
    /// Why the pixels cannot be used, if they cannot.
    pub fault: Option<&'static str>,
}

impl Remarks {
    /// Reads those of a PNG or JPEG file, told by how it begins; other files have none. The file stands at its beginning
    /// afterwards.
    ///
    /// # Errors
    /// Those of the operating system. A file that ends early has the remarks up to there: whoever decodes it tells.
    pub fn read(file: &mut (impl Read + Seek)) -> Result<Self> {
        let mut found = Found::default();
        file.rewind()?;
        let mut begin = [0; 8];
        let read = file.read(&mut begin)?;
        if begin == *b"\x89PNG\r\n\x1a\n" {
            found.png(file)?;
        } else if read >= 2 && begin[..2] == [0xff, 0xd8] {
            file.seek(SeekFrom::Start(2))?;
            found.jpeg(file)?;
        }
        file.rewind()?;
        Ok(found.remarks())
    }

    /// Width and height of the turned image from those of the stored one.
    #[must_use]
    pub fn size(&self, (width, height): (u32, u32)) -> (u32, u32) {
        use Orientation::{Rotate90, Rotate90FlipH, Rotate270, Rotate270FlipH};
        match self.orientation {
            Rotate90 | Rotate270 | Rotate90FlipH | Rotate270FlipH => (height, width),
            _ => (width, height),
        }
    }

    /// Turns a decoded image as the file says.
    pub fn turn(&self, image: &mut DynamicImage) {
        image.apply_orientation(self.orientation);
    }
}

/// What was found in a file.
#[derive(Default)]
struct Found {
    orientation: Option<Orientation>,
    /// Pixels a unit along x and y.
    density: Option<(u64, u64)>,
    animated: bool,
    /// A profile of colours that is not sRGB.
    profile: bool,
    srgb: bool,
    gamma: Option<f64>,
    primaries: Option<[f64; 8]>,
    components: Option<u8>,
}

impl Found {
    /// Chunks up to the pixels.
    fn png(&mut self, file: &mut (impl Read + Seek)) -> Result<()> {
        for _ in 0..MAX_SEGMENTS {
            let mut head = [0; 8];
            if !filled(file, &mut head)? {
                return Ok(());
            }
            let [a, b, c, d, kind @ ..] = head;
            let length = u64::from(u32::from_be_bytes([a, b, c, d]));
            let text: &[u8] = match &kind {
                b"IDAT" | b"IEND" => return Ok(()),
                b"eXIf" | b"pHYs" | b"iCCP" | b"cICP" | b"cHRM" | b"gAMA" | b"sRGB" | b"acTL" => {
                    &bytes_of(file, length.min(MAX_BYTES))?
                }
                _ => &[],
            };
            self.chunk(&kind, text);
            // What was not looked at, and the checksum.
            let rest = length - text.len() as u64 + 4;
            file.seek(SeekFrom::Current(rest as i64))?;
        }
        Ok(())
    }

    fn chunk(&mut self, kind: &[u8; 4], bytes: &[u8]) {
        let number = |at: usize| {
            let bytes = bytes.get(at..at + 4)?;
            Some(u64::from(u32::from_be_bytes(bytes.try_into().ok()?)))
        };
        let scaled = |at: usize| Some(number(at)? as f64 / 100_000.0);
        match kind {
            b"eXIf" => self.orientation = Orientation::from_exif_chunk(bytes),
            b"pHYs" => self.density = number(0).zip(number(4)),
            b"acTL" => self.animated = true,
            b"sRGB" => self.srgb = true,
            b"iCCP" => self.profile |= !is_srgb(bytes.split(|&byte| byte == 0).next().unwrap_or_default()),
            // Primaries and transfer of sRGB are 1 and 13.
            b"cICP" => self.profile |= !matches!(bytes, [1, 13, ..]),
            b"gAMA" => self.gamma = scaled(0),
            b"cHRM" => {
                let all: Option<Vec<f64>> = (0..8).map(|index| scaled(4 * index)).collect();
                self.primaries = all.and_then(|all| all.try_into().ok());
            }
            _ => {}
        }
    }

    /// Segments up to the pixels.
    fn jpeg(&mut self, file: &mut (impl Read + Seek)) -> Result<()> {
        for _ in 0..MAX_SEGMENTS {
            let mut marker = [0; 2];
            if !filled(file, &mut marker)? || marker[0] != 0xff {
                return Ok(());
            }
            match marker[1] {
                // Filling.
                0xff => {
                    file.seek(SeekFrom::Current(-1))?;
                    continue;
                }
                0x01 | 0xd0..=0xd8 => continue,
                0xd9 | 0xda => return Ok(()),
                _ => {}
            }
            let mut length = [0; 2];
            if !filled(file, &mut length)? {
                return Ok(());
            }
            let Some(length) = u64::from(u16::from_be_bytes(length)).checked_sub(2) else {
                return Ok(());
            };
            let bytes = bytes_of(file, length)?;
            self.segment(marker[1], &bytes);
        }
        Ok(())
    }

    fn segment(&mut self, marker: u8, bytes: &[u8]) {
        match (marker, bytes) {
            (0xe0, [b'J', b'F', b'I', b'F', 0, _, _, _, x, xx, y, yy, ..]) => {
                let of = |high, low| u64::from(u16::from_be_bytes([high, low]));
                self.density = Some((of(*x, *xx), of(*y, *yy)));
            }
            (0xe1, [b'E', b'x', b'i', b'f', 0, 0, exif @ ..]) => self.orientation = Orientation::from_exif_chunk(exif),
            (0xe2, rest) => {
                if let Some(profile) = rest.strip_prefix(b"ICC_PROFILE\0") {
                    self.profile |= profile.first() == Some(&1) && !is_srgb(profile);
                }
            }
            // Frames: precision, two sides of two bytes, components.
            (0xc0..=0xcf, [_, _, _, _, _, components, ..]) if !matches!(marker, 0xc4 | 0xc8 | 0xcc) => {
                self.components = Some(*components);
            }
            _ => {}
        }
    }

    fn remarks(self) -> Remarks {
        let mut notes = Vec::new();
        let orientation = self.orientation.unwrap_or(Orientation::NoTransforms);
        if orientation != Orientation::NoTransforms {
            notes.push(format!(
                "its Exif data say how it is to be turned (orientation {}): it is read turned, as viewers show it",
                orientation.to_exif()
            ));
        }
        if let Some((x, y)) = self.density.filter(|(x, y)| x != y && *x > 0 && *y > 0) {
            notes.push(format!(
                "its pixels have the aspect {y}:{x}: images are read as stored, intrinsics must be those of stored pixels"
            ));
        }
        if self.animated {
            notes.push("it is animated: its first picture is read".to_owned());
        }
        /// Red, green and blue of sRGB behind its white.
        const SRGB: [f64; 8] = [0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06];
        let near = |own: [f64; 8]| own.iter().zip(SRGB).all(|(own, srgb)| (own - srgb).abs() < 0.005);
        if self.profile || (!self.srgb && self.primaries.is_some_and(|own| !near(own))) {
            let note =
                "its profile or primaries may be those of another space than sRGB: colours are taken as they are";
            notes.push(note.to_owned());
        }
        if let Some(gamma) = self.gamma.filter(|gamma| !self.srgb && (gamma - 0.454_55).abs() > 0.01) {
            notes.push(format!(
                "its gamma is {gamma}, that of sRGB 0.45455: pixels are taken as they are"
            ));
        }
        let fault = "its colours are those of printers (four components); save it as RGB";
        Remarks {
            orientation,
            notes,
            fault: (self.components == Some(4)).then_some(fault),
        }
    }
}

/// Whether the name or the text of a profile says sRGB, in letters of one byte or two.
fn is_srgb(bytes: &[u8]) -> bool {
    let has = |words: &[u8]| bytes.windows(words.len()).any(|window| window == words);
    has(b"sRGB") || has(b"s\0R\0G\0B")
}

/// Fills a buffer; `false` where the file ends before.
fn filled(file: &mut impl Read, buffer: &mut [u8]) -> Result<bool> {
    match file.read_exact(buffer) {
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof => Ok(false),
        other => other.map(|()| true),
    }
}

/// So many bytes, or those that there are.
fn bytes_of(file: &mut impl Read, count: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    file.take(count).read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    /// A PNG up to its pixels, with a chunk.
    fn png(kind: &[u8; 4], bytes: &[u8]) -> Remarks {
        let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
        for (kind, bytes) in [(b"IHDR", &[0; 13][..]), (kind, bytes), (b"IDAT", &[])] {
            file.extend((bytes.len() as u32).to_be_bytes());
            file.extend(kind);
            file.extend(bytes);
            file.extend([0; 4]);
        }
        Remarks::read(&mut Cursor::new(file)).unwrap()
    }

    /// A JPEG up to its pixels, with a segment.
    fn jpeg(marker: u8, bytes: &[u8]) -> Remarks {
        let mut file = vec![0xff, 0xd8, 0xff, 0xff, marker];
        file.extend((bytes.len() as u16 + 2).to_be_bytes());
        file.extend(bytes);
        file.extend([0xff, 0xda, 0, 2]);
        Remarks::read(&mut Cursor::new(file)).unwrap()
    }

    /// The data of Exif with nothing but an orientation.
    fn exif(orientation: u8) -> Vec<u8> {
        let mut bytes = b"MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0".to_vec();
        bytes.extend([orientation, 0, 0, 0, 0, 0, 0]);
        bytes
    }

    #[test]
    fn pixels_are_turned_as_exif_says() {
        let in_jpeg = |orientation| jpeg(0xe1, &[b"Exif\0\0".to_vec(), exif(orientation)].concat());
        for of in [&|orientation| png(b"eXIf", &exif(orientation)), &in_jpeg] as [&dyn Fn(u8) -> Remarks; 2] {
            let plain = of(1);
            assert!(plain.notes.is_empty() && plain.size((3, 2)) == (3, 2));
            for (orientation, size, first) in [(3, (3, 2), 5), (6, (2, 3), 3), (8, (2, 3), 2), (2, (3, 2), 2)] {
                let remarks = of(orientation);
                assert!(
                    remarks.notes[0].contains(&format!("orientation {orientation}")),
                    "{remarks:?}"
                );
                assert_eq!(remarks.size((3, 2)), size, "{orientation}");
                let grey = image::GrayImage::from_raw(3, 2, vec![0, 1, 2, 3, 4, 5]).unwrap();
                let mut image = DynamicImage::ImageLuma8(grey);
                remarks.turn(&mut image);
                assert_eq!((image.width(), image.height()), size);
                assert_eq!(image.as_bytes()[0], first, "{orientation}");
            }
        }
    }

    #[test]
    fn what_images_say_of_their_pixels_is_told() {
        let numbers = |numbers: &[u32]| {
            numbers
                .iter()
                .flat_map(|number| number.to_be_bytes())
                .collect::<Vec<u8>>()
        };
        let primaries = [31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000];
        let mut wide = primaries;
        wide[4] = 21000;
        let profile = |name: &[u8]| [b"ICC_PROFILE\0\x01\x01".as_slice(), name].concat();
        for (remarks, words) in [
            (png(b"pHYs", &numbers(&[2835, 2835, 0])), ""),
            (png(b"pHYs", &numbers(&[3000, 1000, 0])), "aspect 1000:3000"),
            (png(b"acTL", &numbers(&[2, 0])), "animated"),
            (png(b"iCCP", b"sRGB IEC61966-2.1\0\0x"), ""),
            (png(b"iCCP", b"Display P3\0\0sRGB"), "another space than sRGB"),
            (png(b"cICP", &[1, 13, 0, 1]), ""),
            (png(b"cICP", &[12, 16, 0, 1]), "another space than sRGB"),
            (png(b"cHRM", &numbers(&primaries)), ""),
            (png(b"cHRM", &numbers(&wide)), "another space than sRGB"),
            (png(b"gAMA", &numbers(&[45455])), ""),
            (png(b"gAMA", &numbers(&[100_000])), "gamma is 1"),
            (png(b"tEXt", b"gamma\0of no matter"), ""),
            (jpeg(0xe0, b"JFIF\0\x01\x02\0\0\x01\0\x01\0\0"), ""),
            (jpeg(0xe0, b"JFIF\0\x01\x02\0\0\x02\0\x01\0\0"), "aspect 1:2"),
            (jpeg(0xe2, &profile(b"\0s\0R\0G\0B\0 ")), ""),
            (jpeg(0xe2, &profile(b"\0A\0d\0o\0b\0e")), "another space than sRGB"),
            (jpeg(0xfe, b"a comment"), ""),
        ] {
            assert_eq!(remarks.notes.is_empty(), words.is_empty(), "{words}: {remarks:?}");
            assert!(remarks.notes.concat().contains(words), "{words}: {remarks:?}");
            assert_eq!(remarks.fault, None);
        }
    }

    #[test]
    fn colours_of_printers_are_refused() {
        let of = |marker, components| jpeg(marker, &[8, 0, 1, 0, 1, components]).fault;
        assert_eq!((of(0xc0, 3), of(0xc0, 1), of(0xc4, 4)), (None, None, None));
        assert!(of(0xc0, 4).is_some() && of(0xc2, 4).is_some());
    }

    #[test]
    fn damaged_files_have_the_remarks_up_to_the_damage() {
        let mut whole = vec![0xff, 0xd8, 0xff, 0xe1, 0, 40];
        whole.extend(b"Exif\0\0");
        whole.extend(exif(6));
        for length in 0..whole.len() {
            Remarks::read(&mut Cursor::new(&whole[..length])).unwrap();
        }
        // Lengths that lead behind the end, or before the beginning.
        let long = png(b"zzzz", &[]);
        assert!(long.notes.is_empty());
        for length in [[0xff; 4], [0x7f, 0xff, 0xff, 0xff]] {
            let file = [b"\x89PNG\r\n\x1a\n".as_slice(), &length, b"pHYs"].concat();
            Remarks::read(&mut Cursor::new(file)).unwrap();
        }
        Remarks::read(&mut Cursor::new([0xff, 0xd8, 0xff, 0xe0, 0, 1])).unwrap();
    }
}
