//! The only place that prints: results to standard output, messages to standard error.

use std::io::Write as _;

use serde::Serialize;

/// Prints one JSON value, indented.
pub(crate) fn json<T: Serialize>(value: &T) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    serde_json::to_writer_pretty(&mut out, value)?;
    out.write_all(b"\n")?;
    out.flush()?;
    Ok(())
}

/// Prints text and a line end where it lacks one.
pub(crate) fn text(text: &str) -> anyhow::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())?;
    if !text.ends_with('\n') {
        out.write_all(b"\n")?;
    }
    out.flush()?;
    Ok(())
}

/// Prints a note for the person who waits.
pub(crate) fn note(text: &str) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Prints an error with its causes, one a line.
pub(crate) fn error(error: &anyhow::Error) {
    let mut err = std::io::stderr().lock();
    let mut said = error.to_string();
    let _ = writeln!(err, "error: {said}");
    for cause in error.chain().skip(1) {
        // Many errors end with their cause already.
        let cause = cause.to_string();
        if !said.ends_with(&cause) {
            let _ = writeln!(err, "  caused by: {cause}");
            said = cause;
        }
    }
    if let Some(hint) = error
        .downcast_ref::<rogs_orchestrator::Error>()
        .and_then(rogs_orchestrator::Error::hint)
    {
        let _ = writeln!(err, "hint: {hint}");
    }
}

/// True when whoever read our output went away, which is not an error.
pub(crate) fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let io = cause.downcast_ref::<std::io::Error>().map(std::io::Error::kind);
        let json = cause
            .downcast_ref::<serde_json::Error>()
            .and_then(serde_json::Error::io_error_kind);
        io.or(json) == Some(std::io::ErrorKind::BrokenPipe)
    })
}
