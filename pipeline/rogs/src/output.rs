//! The only place that prints: results to standard output, messages to standard error.
//!
//! Names in them are shown as `rogs_schemas::shown` does. Whoever reads may have gone away, which is no error; a result that
//! the machine refuses to print is one, but never changes the exit code of work that is done.

use std::fmt;
use std::io::{ErrorKind, Write as _};
use std::sync::OnceLock;

use rogs_orchestrator::colour;
use rogs_orchestrator::executor::ProgressMode;
use rogs_schemas::shown;
use schemars::JsonSchema;
use serde::Serialize;

/// Standard output refused a result.
#[derive(Debug)]
pub(crate) struct CannotPrint(std::io::Error);

impl fmt::Display for CannotPrint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "cannot print the result: {}", self.0)
    }
}

impl std::error::Error for CannotPrint {}

/// A value that a command prints with `--json`. `commands/formats.rs` gives each its name and version.
#[diagnostic::on_unimplemented(
    message = "`{Self}` has no name among the JSON outputs",
    note = "give it a line in `commands/formats.rs`, and derive `Serialize` and `JsonSchema`"
)]
pub(crate) trait Format: Serialize + JsonSchema {
    /// Its name, which `rogs schema` takes.
    const NAME: &'static str;
    /// Its version: goes up when something that was there changes or goes, not when something is added.
    const VERSION: u32;

    /// What the entry `format` of the value says: `rogs.status/1`.
    fn format() -> String {
        format!("rogs.{}/{}", Self::NAME, Self::VERSION)
    }
}

/// Values of one kind, where there may be any number of them.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Items<T> {
    /// The values.
    pub(crate) items: Vec<T>,
}

/// A value behind what it is.
#[derive(Serialize)]
struct Labelled<'a, T> {
    format: String,
    #[serde(flatten)]
    value: &'a T,
}

/// Prints one JSON value, indented, with its format.
pub(crate) fn json<T: Format>(value: &T) -> anyhow::Result<()> {
    let format = T::format();
    print(&shown::json(&serde_json::to_string_pretty(&Labelled {
        format,
        value,
    })?))
}

/// Prints what [`json`] would print of [`Items`], item by item: they need not fit into memory.
pub(crate) fn json_items<T: Serialize>(values: impl Iterator<Item = anyhow::Result<T>>) -> anyhow::Result<()>
where
    Items<T>: Format,
{
    let mut out = Indented(std::io::BufWriter::new(std::io::stdout().lock()));
    let head = format!("{{\n  \"format\": \"{}\",\n  \"items\": [", Items::<T>::format());
    let (mut separator, mut end) = (format!("{head}\n    "), format!("{head}]\n}}\n"));
    for value in values {
        let value = value?;
        let written = out.0.write_all(separator.as_bytes());
        let written =
            written.and_then(|()| serde_json::to_writer_pretty(&mut out, &value).map_err(std::io::Error::from));
        if !ended(written)? {
            return Ok(());
        }
        (separator, end) = (",\n    ".to_owned(), "\n  ]\n}\n".to_owned());
    }
    ended(out.0.write_all(end.as_bytes()).and_then(|()| out.flush())).map(|_| ())
}

/// Writes JSON as [`shown::json`] has it, two levels deep. The pieces that the serialiser writes are whole characters.
struct Indented<W>(W);

impl<W: std::io::Write> std::io::Write for Indented<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        // Numbers and most names pass at once.
        let is_plain = bytes.iter().all(|byte| (b' '..=b'~').contains(byte));
        match std::str::from_utf8(bytes) {
            Ok(text) if !is_plain => {
                let shown = shown::json(text).replace('\n', "\n    ");
                self.0.write_all(shown.as_bytes())?;
            }
            _ => self.0.write_all(bytes)?,
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.0.flush()
    }
}

/// Prints a JSON schema, which says itself what it is.
pub(crate) fn schema(schema: &serde_json::Value) -> anyhow::Result<()> {
    print(&shown::json(&serde_json::to_string_pretty(schema)?))
}

/// Prints text and a line end where it lacks one.
pub(crate) fn text(text: &str) -> anyhow::Result<()> {
    print(&colour::painted(&shown::text(text), &std::io::stdout()))
}

fn print(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    let end = if text.ends_with('\n') { "" } else { "\n" };
    let written = out
        .write_all(text.as_bytes())
        .and_then(|()| out.write_all(end.as_bytes()))
        .and_then(|()| out.flush());
    ended(written).map(|_| ())
}

/// False when whoever reads went away; an error when the machine refuses.
fn ended(written: std::io::Result<()>) -> anyhow::Result<bool> {
    match written {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(CannotPrint(error).into()),
    }
}

/// The end of a command whose exit code says how its work ended: a result that cannot be printed is only said.
pub(crate) fn after_work(printed: anyhow::Result<()>) -> anyhow::Result<()> {
    match printed {
        Err(refused) if refused.is::<CannotPrint>() => {
            warning(&refused.to_string());
            Ok(())
        }
        other => other,
    }
}

/// How much is told on standard error.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Voice {
    /// Failures and warnings.
    Quiet,
    /// Progress and notes as well.
    Usual,
    /// Every step.
    Detailed,
}

static VOICE: OnceLock<Voice> = OnceLock::new();

/// Says, once and before anything else, how much is told.
pub(crate) fn set_voice(voice: Voice) {
    // A second call changes nothing.
    let _ = VOICE.set(voice);
}

fn voice() -> Voice {
    VOICE.get().copied().unwrap_or(Voice::Usual)
}

/// What a run shows.
pub(crate) fn progress() -> ProgressMode {
    match voice() {
        Voice::Quiet => ProgressMode::Quiet,
        Voice::Usual => ProgressMode::for_stderr(),
        Voice::Detailed => ProgressMode::Details,
    }
}

/// Prints a note for the person who waits, unless they want it quiet.
pub(crate) fn note(text: &str) {
    if voice() != Voice::Quiet {
        tell(text);
    }
}

/// Prints a warning.
pub(crate) fn warning(text: &str) {
    tell(&format!("warning: {text}"));
}

fn tell(text: &str) {
    let mut err = std::io::stderr().lock();
    let text = shown::text(text);
    let _ = writeln!(err, "{}", colour::painted(&text, &std::io::stderr()));
}

/// Prints an error with its causes, one a line.
pub(crate) fn error(error: &anyhow::Error) {
    let mut said = error.to_string();
    tell(&format!("error: {}", shown::line(&said)));
    for cause in error.chain().skip(1) {
        // Many errors end with their cause already.
        let cause = cause.to_string();
        if !said.ends_with(&cause) {
            tell(&format!("  caused by: {}", shown::line(&cause)));
            said = cause;
        }
    }
    if let Some(hint) = hint(error) {
        tell(&format!("hint: {}", shown::line(&hint)));
    }
}

/// What to do about an error, where something is known.
fn hint(error: &anyhow::Error) -> Option<String> {
    let known = error.downcast_ref::<rogs_orchestrator::Error>();
    known.and_then(rogs_orchestrator::Error::hint).or_else(|| {
        let refused = error.chain().filter_map(|cause| cause.downcast_ref::<std::io::Error>());
        refused.filter_map(rogs_files::hint).map(str::to_owned).next()
    })
}

/// True when whoever read our output went away, which is not an error.
pub(crate) fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let io = cause.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
        let json = cause
            .downcast_ref::<serde_json::Error>()
            .and_then(serde_json::Error::io_error_kind);
        io.or(json) == Some(ErrorKind::BrokenPipe)
    })
}
