//! A look over an XML text before any parser sees it.
//!
//! XML readers recurse into nested elements and compare attributes pairwise (as RUSTSEC-2026-0194 and -0195 tell). This
//! scan bounds depth, attributes and elements, and refuses document type declarations, so that no entity
//! can be defined.

/// Bounds of an XML text.
#[derive(Debug, Clone, Copy)]
pub(crate) struct XmlLimits {
    pub(crate) depth: usize,
    pub(crate) attributes: usize,
    pub(crate) elements: usize,
}

/// Checks a text against the bounds; the message of an error says what is exceeded and in which line.
pub(crate) fn check_xml(text: &str, limits: XmlLimits) -> Result<(), String> {
    let bytes = text.as_bytes();
    let (mut at, mut depth, mut elements) = (0usize, 0usize, 0usize);
    let line = |at: usize| {
        1 + bytes[..at.min(bytes.len())]
            .iter()
            .filter(|&&byte| byte == b'\n')
            .count()
    };
    while let Some(offset) = find(&bytes[at..], b"<") {
        at += offset;
        let rest = &bytes[at..];
        let skip = |end: &[u8]| find(rest, end).map(|found| found + end.len());
        let special = if rest.starts_with(b"<!--") {
            Some(skip(b"-->"))
        } else if rest.starts_with(b"<![CDATA[") {
            Some(skip(b"]]>"))
        } else if rest.starts_with(b"<?") {
            Some(skip(b"?>"))
        } else if rest.starts_with(b"<!") {
            return Err(format!("line {}: document type declarations are not allowed", line(at)));
        } else {
            None
        };
        if let Some(length) = special {
            at += length.ok_or_else(|| format!("line {}: a comment or section does not end", line(at)))?;
            continue;
        }
        let tag = scan_tag(rest).ok_or_else(|| format!("line {}: a tag does not end", line(at)))?;
        if tag.attributes > limits.attributes {
            return Err(format!(
                "line {}: more than {} attributes in one tag",
                line(at),
                limits.attributes
            ));
        }
        match tag.kind {
            TagKind::Open => depth += 1,
            TagKind::Close => depth = depth.saturating_sub(1),
            TagKind::Empty => {}
        }
        elements += usize::from(!matches!(tag.kind, TagKind::Close));
        if depth > limits.depth {
            return Err(format!(
                "line {}: elements are nested deeper than {}",
                line(at),
                limits.depth
            ));
        }
        if elements > limits.elements {
            return Err(format!("line {}: more than {} elements", line(at), limits.elements));
        }
        at += tag.length;
    }
    Ok(())
}

enum TagKind {
    Open,
    Close,
    Empty,
}

struct Tag {
    kind: TagKind,
    attributes: usize,
    length: usize,
}

/// The tag at the start of `bytes`; every `=` outside quotes counts as an attribute.
fn scan_tag(bytes: &[u8]) -> Option<Tag> {
    let mut quote = None;
    let mut attributes = 0;
    for (index, &byte) in bytes.iter().enumerate() {
        match quote {
            Some(open) => {
                if byte == open {
                    quote = None;
                }
            }
            None => match byte {
                b'"' | b'\'' => quote = Some(byte),
                b'=' => attributes += 1,
                b'>' => {
                    let kind = if bytes.get(1) == Some(&b'/') {
                        TagKind::Close
                    } else if bytes[index - 1] == b'/' {
                        TagKind::Empty
                    } else {
                        TagKind::Open
                    };
                    return Some(Tag {
                        kind,
                        attributes,
                        length: index + 1,
                    });
                }
                _ => {}
            },
        }
    }
    None
}

fn find(haystack: &[u8], needle: &[u8]) -> Option<usize> {
    haystack.windows(needle.len()).position(|window| window == needle)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: XmlLimits = XmlLimits {
        depth: 3,
        attributes: 2,
        elements: 6,
    };

    #[test]
    fn ordinary_text_passes() {
        let text = "<?xml version='1.0'?><!-- <a b='>'> --><a x='<'><b/><b y=\"=\" z='>'/><![CDATA[<c>]]></a>";
        assert_eq!(check_xml(text, LIMITS), Ok(()));
    }

    #[test]
    fn each_bound_is_held() {
        let over = |text: &str| check_xml(text, LIMITS).unwrap_err();
        assert!(over("<a>\n<a><a><a/><a></a></a></a></a>").contains("line 2"));
        assert!(over("<a b='' c='' d=''/>").contains("attributes"));
        assert!(over(&"<a/>".repeat(7)).contains("elements"));
        assert!(over("<!DOCTYPE a [<!ENTITY b 'c'>]><a/>").contains("document type"));
        assert!(over("<a").contains("does not end"));
        assert!(over("<!-- ").contains("does not end"));
    }
}
