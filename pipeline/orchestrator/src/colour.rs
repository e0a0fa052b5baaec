//! Colours on terminals: where they are wanted, and which words have some.

use std::borrow::Cow;
use std::io::IsTerminal;

/// Variables of the environment that are asked, in this order: `NO_COLOR` with any value switches colours off,
/// `CLICOLOR_FORCE` other than 0 on, also where nobody sees a terminal, and `CLICOLOR=0` off.
pub const VARIABLES: [&str; 3] = ["NO_COLOR", "CLICOLOR_FORCE", "CLICOLOR"];

/// Words that lines begin with, and their colours as numbers of terminals: red for what is wrong, yellow for what may be,
/// green for what is right, cyan for what to do.
const WORDS: [(&str, &str); 11] = [
    ("error:", "31"),
    ("failed:", "31"),
    ("bad:", "31"),
    ("problem  ", "31"),
    ("warning:", "33"),
    ("missing:", "33"),
    ("differs:", "33"),
    ("note  ", "33"),
    ("ok  ", "32"),
    ("hint:", "36"),
    ("→", "36"),
];

/// The text as this stream should get it.
#[must_use]
pub fn painted<'a>(text: &'a str, stream: &impl IsTerminal) -> Cow<'a, str> {
    let variable = |name: &str| std::env::var(name).ok();
    if wanted(variable, stream.is_terminal()) {
        Cow::Owned(paint(text))
    } else {
        Cow::Borrowed(text)
    }
}

fn wanted(variable: impl Fn(&str) -> Option<String>, terminal: bool) -> bool {
    let [no, forced, usual] = VARIABLES.map(|name| variable(name).filter(|value| !value.is_empty()));
    if no.is_some() {
        return false;
    }
    if forced.is_some_and(|value| value != "0") {
        return true;
    }
    let dumb = variable("TERM").is_some_and(|term| term == "dumb");
    terminal && !dumb && usual.is_none_or(|value| value != "0")
}

/// Colours the word of [`WORDS`] that a line begins with, after spaces or a count in brackets such as `[3/7]`.
fn paint(text: &str) -> String {
    text.split_inclusive('\n').map(line).collect()
}

fn line(text: &str) -> Cow<'_, str> {
    let inside = text.trim_start();
    let counted = inside.strip_prefix('[').and_then(|rest| Some(rest.split_once("] ")?.1));
    let begin = counted.unwrap_or(inside);
    let Some((word, colour)) = WORDS.iter().find(|(word, _)| begin.starts_with(word)) else {
        return Cow::Borrowed(text);
    };
    let (before, (word, after)) = (&text[..text.len() - begin.len()], begin.split_at(word.trim_end().len()));
    Cow::Owned(format!("{before}\u{1b}[{colour}m{word}\u{1b}[0m{after}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_for_terminals_unless_the_environment_says_otherwise() {
        let of = |set: &[(&str, &str)], terminal: bool| {
            let variable = |name: &str| {
                set.iter()
                    .find(|(own, _)| *own == name)
                    .map(|(_, value)| (*value).to_owned())
            };
            wanted(variable, terminal)
        };
        assert!(of(&[], true) && !of(&[], false));
        assert!(!of(&[("NO_COLOR", "1")], true) && of(&[("NO_COLOR", "")], true));
        assert!(of(&[("CLICOLOR_FORCE", "1")], false) && !of(&[("CLICOLOR_FORCE", "0")], false));
        assert!(!of(&[("NO_COLOR", "1"), ("CLICOLOR_FORCE", "1")], true));
        assert!(!of(&[("CLICOLOR", "0")], true) && of(&[("CLICOLOR", "1")], true) && !of(&[("CLICOLOR", "1")], false));
        assert!(!of(&[("TERM", "dumb")], true));
    }

    #[test]
    fn the_first_word_of_a_line_alone_is_coloured() {
        assert_eq!(
            paint("error: x\n  hint: y"),
            "\u{1b}[31merror:\u{1b}[0m x\n  \u{1b}[36mhint:\u{1b}[0m y"
        );
        assert_eq!(paint("[3/7] failed: x"), "[3/7] \u{1b}[31mfailed:\u{1b}[0m x");
        assert_eq!(
            paint("ok       version    1\n"),
            "\u{1b}[32mok\u{1b}[0m       version    1\n"
        );
        for plain in ["ok then", "an error: x", "[1, 2]\n", ""] {
            assert_eq!(paint(plain), plain);
        }
    }
}
