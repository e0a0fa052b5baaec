//! Parts of self-contained HTML pages: the page itself, pictures that it carries, plots.
//!
//! The report of a run of the pipeline and the report of a training have these in common and nothing else, which is why
//! they are a crate: training knows no orchestrator. Everything is [`Markup`]: text is escaped where it goes in.

mod axis;
mod bars;
pub mod colours;
mod plot;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};

pub use bars::Bars;
pub use plot::{Plot, PlotPoint, Series};

/// What a page may do: show what it carries, and nothing else. No script, nothing from outside.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'";

/// A whole page: `title` in the head and as the first heading, `style` as its style sheet.
#[must_use]
pub fn page(title: &str, style: &str, body: &Markup) -> Markup {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width";
                title { (title) }
                style { (PreEscaped(style)) }
            }
            body {
                h1 { (title) }
                (body)
            }
        }
    }
}

/// A picture that the page carries in itself. `media_type` is that of `bytes`, for example `image/png`.
#[must_use]
pub fn picture(alternative: &str, media_type: &str, bytes: &[u8]) -> Markup {
    let address = format!("data:{media_type};base64,{}", STANDARD.encode(bytes));
    html! { img alt=(alternative) src=(address); }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_text() {
        let text = r#"<a href="x">'&'"#;
        let page = page(text, "p > b { margin: 0 }", &html! { p title=(text) { (text) } }).into_string();
        assert!(
            !page.contains("<a ") && page.matches("&lt;a href=&quot;x&quot;&gt;'&amp;'").count() == 4,
            "{page}"
        );
        assert!(page.contains("<style>p > b { margin: 0 }</style>"), "{page}");
    }

    #[test]
    fn a_picture_is_carried_whole() {
        let picture = picture("a \"b\"", "image/png", b"\x89PNG").into_string();
        assert_eq!(
            picture,
            r#"<img alt="a &quot;b&quot;" src="data:image/png;base64,iVBORw==">"#
        );
    }
}
