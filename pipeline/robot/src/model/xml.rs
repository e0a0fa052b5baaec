//! XML of strangers: its encoding, its bounds, its names, and where in it something stands.

use std::borrow::Cow;
use std::fmt::Write as _;

use roxmltree::{Document, Node, ParsingOptions};

use super::guard::{XmlLimits, check_xml};

/// Message of a reader; the caller knows the path.
pub(crate) type Parsed<T> = Result<T, String>;

/// Most prefixes without a declaration that are declared for the file.
const MAX_UNDECLARED: usize = 16;

/// The text of an XML file: UTF-8 or UTF-16 with a byte-order mark, or the encoding that the declaration names, of which
/// the one-byte ones of western languages are read. A document type declaration that defines nothing is blanked out.
///
/// # Errors
/// When the bytes are no text of a known encoding.
pub(crate) fn text_of(bytes: &[u8]) -> Parsed<Cow<'_, str>> {
    let text = match bytes {
        [0xff, 0xfe, rest @ ..] => Cow::Owned(utf16(rest, u16::from_le_bytes)?),
        [0xfe, 0xff, rest @ ..] => Cow::Owned(utf16(rest, u16::from_be_bytes)?),
        _ => match std::str::from_utf8(bytes) {
            Ok(text) => Cow::Borrowed(text.trim_start_matches('\u{feff}')),
            Err(error) => Cow::Owned(one_byte(bytes, error.valid_up_to())?),
        },
    };
    Ok(without_doctype(text))
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> Parsed<String> {
    let units = bytes.chunks_exact(2).map(|pair| unit([pair[0], pair[1]]));
    char::decode_utf16(units)
        .collect::<Result<String, _>>()
        .map_err(|_| "it begins like UTF-16 text but is none; save it as UTF-8".to_owned())
}

/// A text in Latin-1 where the XML declaration says so. Of the bytes above 0x7f only comments and names of materials are
/// made in practice, so the few signs in which Windows-1252 differs do not matter.
fn one_byte(bytes: &[u8], wrong_at: usize) -> Parsed<String> {
    let head = String::from_utf8_lossy(&bytes[..bytes.len().min(200)]).to_lowercase();
    let declared = head.split_once("encoding").and_then(|(_, rest)| {
        let quoted = rest.trim_start().strip_prefix('=')?.trim_start();
        quoted.get(1..)?.split(['"', '\'']).next()
    });
    match declared {
        Some(
            "iso-8859-1" | "iso-8859-15" | "latin1" | "latin-1" | "windows-1252" | "cp1252" | "us-ascii" | "ascii",
        ) => Ok(bytes.iter().map(|&byte| char::from(byte)).collect()),
        Some(other) if !other.starts_with("utf") => {
            Err(format!("its encoding `{other}` is not read; save it as UTF-8"))
        }
        _ => {
            let line = 1 + bytes[..wrong_at].iter().filter(|&&byte| byte == b'\n').count();
            Err(format!("line {line}: not UTF-8 text; save the file as UTF-8"))
        }
    }
}

/// Blanks out a document type declaration without an inner part; one that could define entities stays, to be refused.
fn without_doctype(text: Cow<'_, str>) -> Cow<'_, str> {
    let Some(start) = text.find("<!DOCTYPE") else {
        return text;
    };
    // Before it come only the declaration, comments and blanks.
    let inside_comment = text[..start]
        .rfind("<!--")
        .is_some_and(|open| !text[open..start].contains("-->"));
    let Some(length) = text[start..].find('>').map(|end| end + 1) else {
        return text;
    };
    let declaration = &text[start..start + length];
    if inside_comment || declaration.contains(['[', ']']) {
        return text;
    }
    let blank: String = declaration
        .chars()
        .map(|c| if c == '\n' { '\n' } else { ' ' })
        .collect();
    Cow::Owned(format!("{}{blank}{}", &text[..start], &text[start + length..]))
}

/// Reads an XML text within bounds and hands the root element to `read`. Prefixes that no namespace declares are let
/// pass, as the XML readers below the ROS tools do.
///
/// # Errors
/// When a bound is exceeded or the text is not well-formed, with the line; what `read` returns.
pub(crate) fn with_root<T>(text: &str, limits: XmlLimits, read: impl FnOnce(Node<'_, '_>) -> Parsed<T>) -> Parsed<T> {
    check_xml(text, limits)?;
    let mut text = Cow::Borrowed(text);
    for _ in 0..=MAX_UNDECLARED {
        let options = ParsingOptions {
            allow_dtd: false,
            nodes_limit: u32::try_from(limits.elements).unwrap_or(u32::MAX).saturating_mul(3),
            ..ParsingOptions::default()
        };
        let error = match Document::parse_with_options(&text, options) {
            Ok(document) => return read(document.root_element()),
            Err(error) => error,
        };
        let declared = match &error {
            roxmltree::Error::UnknownNamespace(prefix, _) => declare(&text, prefix),
            _ => None,
        };
        text = match declared {
            Some(declared) => Cow::Owned(declared),
            None => {
                let at = error.pos();
                return Err(format!("line {}, column {}: broken XML ({error})", at.row, at.col));
            }
        };
    }
    Err("it uses too many prefixes that no `xmlns` declares".to_owned())
}

/// The text with a declaration of a prefix in its root element.
fn declare(text: &str, prefix: &str) -> Option<String> {
    let mut at = 0;
    loop {
        at += text[at..].find('<')?;
        let rest = &text[at..];
        at += match rest.as_bytes().get(1)? {
            b'?' => rest.find("?>")?,
            b'!' => rest.find("-->")?,
            _ => break,
        };
    }
    let name_end = at + text[at..].find(|c: char| c.is_ascii_whitespace() || matches!(c, '>' | '/'))?;
    let mut declared = text[..name_end].to_owned();
    write!(declared, " xmlns:{prefix}=\"urn:undeclared:{prefix}\"").ok()?;
    declared.push_str(&text[name_end..]);
    Some(declared)
}

/// The line in which a node begins, counted from 1.
pub(crate) fn line(node: Node<'_, '_>) -> u32 {
    node.document().text_pos_at(node.range().start).row
}

/// The first child element with a name, of any namespace.
pub(crate) fn child<'a, 'i>(node: Node<'a, 'i>, name: &str) -> Option<Node<'a, 'i>> {
    node.children().find(|node| is(*node, name))
}

/// True for an element with this local name. Namespaces carry versions in practice; only the name counts.
pub(crate) fn is(node: Node<'_, '_>, name: &str) -> bool {
    node.is_element() && node.tag_name().name() == name
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: XmlLimits = XmlLimits {
        depth: 8,
        attributes: 8,
        elements: 100,
    };

    #[test]
    fn texts_of_the_usual_encodings_are_read() {
        let text = "<?xml version='1.0' encoding='ISO-8859-1'?><a b='é'/>";
        let latin: Vec<u8> = text.chars().map(|c| c as u8).collect();
        assert_eq!(text_of(&latin).unwrap(), text);
        let with_mark =
            |unit: fn(u16) -> [u8; 2]| -> Vec<u8> { "\u{feff}<a b='é'/>".encode_utf16().flat_map(unit).collect() };
        assert_eq!(text_of(&with_mark(u16::to_le_bytes)).unwrap(), "<a b='é'/>");
        assert_eq!(text_of(&with_mark(u16::to_be_bytes)).unwrap(), "<a b='é'/>");
        assert_eq!(text_of("\u{feff}<a/>".as_bytes()).unwrap(), "<a/>");
        assert!(text_of(b"<a>\n\xe9</a>").unwrap_err().contains("line 2: not UTF-8"));
        assert!(
            text_of(b"<?xml encoding=\"Shift_JIS\"?>\xe9")
                .unwrap_err()
                .contains("`shift_jis`")
        );
    }

    #[test]
    fn a_document_type_that_defines_nothing_is_let_be() {
        let text = text_of(b"<!DOCTYPE robot\nSYSTEM 'x.dtd'>\n<a/>").unwrap();
        assert_eq!(text.lines().count(), 3);
        assert!(with_root(&text, LIMITS, |root| Ok(line(root))).is_ok_and(|line| line == 3));
        let entities = text_of(b"<!DOCTYPE a [<!ENTITY b 'c'>]><a/>").unwrap();
        assert!(
            with_root(&entities, LIMITS, |_| Ok(()))
                .unwrap_err()
                .contains("document type")
        );
    }

    #[test]
    fn prefixes_need_no_declaration() {
        let text = "<?xml version='1.0'?><!-- <b> --><a><c:d e:f='1'/></a>";
        let names = |root: Node<'_, '_>| Ok(child(root, "d").map(|node| node.tag_name().name().to_owned()));
        assert_eq!(with_root(text, LIMITS, names), Ok(Some("d".to_owned())));
    }

    #[test]
    fn broken_text_names_the_line() {
        let message = with_root("<a>\n<b>\n</a>", LIMITS, |_| Ok(())).unwrap_err();
        assert!(message.starts_with("line 3, column"), "{message}");
    }
}
