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
use sha2::{Digest as _, Sha256};

pub use bars::Bars;
pub use plot::{Plot, PlotPoint, Series};

/// What a page may do: show what it carries, and nothing else. No script but one that is named, nothing from outside.
const POLICY: &str = "default-src 'none'; img-src data:; style-src 'unsafe-inline'";

/// A whole page: `title` in the head and as the first heading, `style` as its style sheet.
#[must_use]
pub fn page(title: &str, style: &str, body: &Markup) -> Markup {
    whole(title, style, body, None)
}

/// A script of ours in a page.
#[derive(Debug, Clone, Copy)]
pub struct Script<'a> {
    /// A classic script, which must not hold its own end tag.
    pub text: &'a str,
    /// Whether it may ask the server that the page came from.
    pub connects: bool,
}

/// A page as [`page`] makes it, with a script at its end. No other script runs but what this one loads: the policy of the
/// page names it by its hash.
#[must_use]
pub fn page_with_script(title: &str, style: &str, body: &Markup, script: Script<'_>) -> Markup {
    whole(title, style, body, Some(script))
}

fn whole(title: &str, style: &str, body: &Markup, script: Option<Script<'_>>) -> Markup {
    let policy = script.map_or(POLICY.to_owned(), |script| {
        let hash = STANDARD.encode(Sha256::digest(script.text));
        let connect = if script.connects { "; connect-src 'self'" } else { "" };
        format!("{POLICY}; script-src 'strict-dynamic' 'sha256-{hash}'{connect}")
    });
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(policy);
                meta name="viewport" content="width=device-width";
                title { (title) }
                style { (PreEscaped(style)) }
            }
            body {
                h1 { (title) }
                (body)
                @if let Some(script) = script { script { (PreEscaped(script.text)) } }
            }
        }
    }
}

/// A picture that the page carries in itself. `media_type` is that of `bytes`, for example `image/png`.
#[must_use]
pub fn picture(alternative: &str, media_type: &str, bytes: &[u8]) -> Markup {
    let address = format!("data:{media_type};base64,{}", STANDARD.encode(bytes));
    html! { img alt=(alternative) loading="lazy" src=(address); }
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
    fn a_script_is_named_by_its_hash_and_no_other_one_runs() {
        let script = Script {
            text: "let x = 1 < 2;",
            connects: false,
        };
        let page = page_with_script("<i>", "", &html! {}, script).into_string();
        assert!(page.contains("<script>let x = 1 < 2;</script></body>"), "{page}");
        // By `printf 'let x = 1 < 2;' | openssl dgst -sha256 -binary | base64`.
        let hash = "PDkPTHk/rals6wkB9INpTmZsCrgwzrubCzdpa28TIo8=";
        assert!(
            page.contains(&format!("script-src 'strict-dynamic' 'sha256-{hash}'\"")),
            "{page}"
        );
        assert!(!page.contains("connect-src"));
    }

    #[test]
    fn a_picture_is_carried_whole() {
        let picture = picture("a \"b\"", "image/png", b"\x89PNG").into_string();
        assert_eq!(
            picture,
            r#"<img alt="a &quot;b&quot;" loading="lazy" src="data:image/png;base64,iVBORw==">"#
        );
    }
}
