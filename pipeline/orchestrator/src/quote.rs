//! Text for other programs. Nobody else puts a word into the language of a shell or of Slurm.

use std::path::Path;

use crate::error::{Error, Result};

/// A path as a word of a command line that is written down.
///
/// # Errors
/// When it is not UTF-8, or has a line end or another control character, which neither job scripts nor lists of commands
/// can hold.
pub fn path_word(path: &Path) -> Result<String> {
    let word = path.to_str().ok_or_else(|| {
        Error::usage(format!("the path `{}` is not UTF-8", path.display())).with_hint("rename the folder")
    })?;
    check_word(word)?;
    Ok(word.to_owned())
}

/// Checks a word of a command line that is written down.
///
/// # Errors
/// When it has a line end or another control character.
pub fn check_word(word: &str) -> Result<()> {
    if word.contains(char::is_control) {
        let error = Error::usage(format!("`{word}` has a line end or another control character"));
        return Err(error.with_hint("job scripts and lists of commands cannot hold it; rename the file or folder"));
    }
    Ok(())
}

/// Words as one line for a POSIX shell.
#[must_use]
pub fn shell_line(words: &[String]) -> String {
    words.iter().map(|word| shell_word(word)).collect::<Vec<_>>().join(" ")
}

/// A word that a POSIX shell takes as it is.
#[must_use]
pub fn shell_word(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+=:,@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// An option as a word of a line `#SBATCH ...`: Slurm splits at blanks, takes what follows `#` for a comment, and knows
/// quotes and backslashes.
///
/// # Errors
/// See [`check_word`].
pub(crate) fn sbatch_word(option: &str) -> Result<String> {
    check_word(option)?;
    let plain = |c: char| !c.is_whitespace() && !"\"'\\#".contains(c);
    Ok(if option.chars().all(plain) {
        option.to_owned()
    } else {
        format!("\"{}\"", option.replace('\\', "\\\\").replace('"', "\\\""))
    })
}

/// A folder in the name of a job's output, in which Slurm replaces `%` and a letter.
///
/// # Errors
/// See [`path_word`]; also when it has a backslash, which turns the replacement off.
pub(crate) fn sbatch_pattern(folder: &Path) -> Result<String> {
    let word = path_word(folder)?;
    if word.contains('\\') {
        let error = Error::usage(format!(
            "the path `{word}` has a backslash, which Slurm takes for a sign of its own"
        ));
        return Err(error.with_hint("use another `out` in [run]"));
    }
    Ok(word.replace('%', "%%"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Names that languages of others take for something else.
    const NAMES: [&str; 9] = [
        "plain/a-b",
        "a b",
        "it's",
        "100%u",
        "a#b",
        "say \"x\"",
        "$HOME`id`",
        "Küche",
        "back\\slash",
    ];

    #[test]
    fn words_survive_a_shell() {
        assert_eq!(shell_word("/a/b-c"), "/a/b-c");
        assert_eq!(shell_word("it's a $HOME"), "'it'\\''s a $HOME'");
        assert_eq!(shell_word(""), "''");
        for name in NAMES {
            let line = format!("printf %s {}", shell_word(name));
            let said = std::process::Command::new("sh").args(["-c", &line]).output().unwrap();
            assert_eq!(String::from_utf8(said.stdout).unwrap(), name);
        }
    }

    /// The words of a line `#SBATCH` by the rules of Slurm's own reader.
    fn words_of(line: &str) -> Vec<String> {
        let (mut words, mut word) = (Vec::new(), None::<String>);
        let (mut quote, mut escaped) = (None, false);
        for c in line.chars() {
            match c {
                c if escaped => {
                    word.get_or_insert_default().push(c);
                    escaped = false;
                }
                '\\' => escaped = true,
                c if quote == Some(c) => quote = None,
                '"' | '\'' if quote.is_none() => {
                    quote = Some(c);
                    word.get_or_insert_default();
                }
                '#' if quote.is_none() => break,
                c if c.is_whitespace() && quote.is_none() => words.extend(word.take()),
                c => word.get_or_insert_default().push(c),
            }
        }
        words.extend(word);
        words
    }

    #[test]
    fn options_survive_slurm() {
        for name in NAMES {
            let option = format!("--output={name}");
            assert_eq!(words_of(&sbatch_word(&option).unwrap()), [option]);
        }
        assert_eq!(sbatch_word("--mem=4096M").unwrap(), "--mem=4096M");
        assert_eq!(sbatch_pattern(Path::new("/a/100%u")).unwrap(), "/a/100%%u");
        sbatch_pattern(Path::new("/a\\b")).unwrap_err();
    }

    #[test]
    fn what_no_line_can_hold_is_refused() {
        use std::os::unix::ffi::OsStrExt as _;
        for name in [&b"a\nb"[..], b"a\x1bb", b"\xff"] {
            let path = Path::new(std::ffi::OsStr::from_bytes(name));
            let error = path_word(path).unwrap_err();
            assert!(error.hint().is_some_and(|hint| hint.contains("rename")), "{error}");
        }
    }
}
