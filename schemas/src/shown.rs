//! Names and messages as they are shown: whatever a file calls itself, it cannot steer a terminal, hide part of a line or
//! begin one of its own. What is stored and hashed stays as it is.

use std::borrow::Cow;
use std::fmt::Write as _;

/// Characters that change how what follows is shown: those that Unicode calls control characters, those that turn the
/// direction of writing, and those that end a line or a paragraph.
fn steers(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

/// One line: a name, a path, a message. Characters that would change how it is shown stand as Rust writes them, `\n`,
/// `\u{1b}`.
///
/// ```
/// assert_eq!(rogs_schemas::shown::line("gripper\u{1b}]0;x\u{7}\n"), r"gripper\u{1b}]0;x\u{7}\n");
/// ```
#[must_use]
pub fn line(text: &str) -> Cow<'_, str> {
    escaped(text, steers)
}

/// Several lines that are ours, with names in them: as [`line()`], but for line ends and tabs.
#[must_use]
pub fn text(text: &str) -> Cow<'_, str> {
    escaped(text, |c| steers(c) && c != '\n' && c != '\t')
}

/// JSON text: characters of strings that a terminal would obey and JSON leaves as they are stand as `\u009b`.
#[must_use]
pub fn json(text: &str) -> Cow<'_, str> {
    if !text.contains(|c| steers(c) && c != '\n') {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if steers(c) && c != '\n' {
            // All of them lie in the basic plane.
            let _ = write!(out, "\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

fn escaped(text: &str, steers: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&steers) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if steers(c) {
            out.extend(c.escape_default());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_steers_a_terminal_is_escaped_and_the_rest_stays() {
        for (name, shown) in [
            ("wrist camera 1", "wrist camera 1"),
            ("Küche/机器人", "Küche/机器人"),
            ("a\u{1b}[2Jb\r\n", r"a\u{1b}[2Jb\r\n"),
            ("\u{9b}31m", r"\u{9b}31m"),
            ("gpj\u{202e}.exe", r"gpj\u{202e}.exe"),
            ("two\u{2028}lines", r"two\u{2028}lines"),
        ] {
            assert_eq!(line(name), shown);
        }
        assert_eq!(text("one\n\ttwo\u{7}"), "one\n\ttwo\\u{7}");
    }

    #[test]
    fn json_says_the_same_after_it() {
        let value = serde_json::json!({"name\u{7f}": "a\u{9b}b\u{202e}\u{1b}\n"});
        let plain = serde_json::to_string_pretty(&value).unwrap();
        let shown = json(&plain);
        assert!(!shown.contains(|c| steers(c) && c != '\n'), "{shown:?}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&shown).unwrap(), value);
    }
}
