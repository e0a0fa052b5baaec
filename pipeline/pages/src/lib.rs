//! Parts of self-contained HTML pages, for the report of a run of the pipeline and of one of training: no scripts, nothing
//! from outside.

mod plots;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

pub use plots::{Plot, PlotPoint, Series, svg};

/// Escapes text for HTML content and attribute values.
#[must_use]
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            other => out.push(other),
        }
    }
    out
}

/// The address of a file that the page itself carries, for `src` of a picture.
#[must_use]
pub fn inlined(media_type: &str, bytes: &[u8]) -> String {
    format!("data:{media_type};base64,{}", STANDARD.encode(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_text() {
        assert_eq!(
            escape(r#"<a href="x">'&'"#),
            "&lt;a href=&quot;x&quot;&gt;&#39;&amp;&#39;"
        );
    }

    #[test]
    fn a_file_is_carried_whole() {
        assert_eq!(inlined("image/png", b"\x89PNG"), "data:image/png;base64,iVBORw==");
    }
}
