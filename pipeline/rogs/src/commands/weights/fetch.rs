//! `rogs weights fetch`: public weight files, by name.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail, ensure};
use rogs_schemas::ids::suggestion;

use super::catalogue::{PUBLIC_FILES, PublicFile};
use super::download::{Download, Event, Expected, client, stated_sha256};
use super::told::Fetched;
use crate::output::{self, Items};

/// What to fetch.
#[derive(Debug, clap::Args)]
pub(super) struct Args {
    /// One of the public files; without a name they are listed and nothing is fetched.
    name: Option<String>,
    /// Where it goes; by default the current folder, under the name that its authors gave it.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Fetch it from this address (a mirror) instead of its authors'.
    #[arg(long, value_name = "ADDRESS")]
    url: Option<String>,
    /// SHA-256 that it must have (hexadecimal, at least the first 8 digits).
    #[arg(long, value_name = "DIGITS")]
    sha256: Option<String>,
    /// Accept a file whose SHA-256 is unknown.
    #[arg(long, conflicts_with = "sha256")]
    unverified: bool,
    /// Print one JSON value.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn run(args: &Args) -> anyhow::Result<ExitCode> {
    let Some(name) = &args.name else {
        list(args.json)?;
        return Ok(ExitCode::SUCCESS);
    };
    let Some(file) = PublicFile::by_name(name) else {
        let known = PUBLIC_FILES.iter().map(|file| file.name);
        bail!("there is no public file `{name}`{}", suggestion(name, known));
    };
    let url = args.url.clone().unwrap_or_else(|| file.url.to_owned());
    ensure!(
        url.starts_with("https://") || url.starts_with("http://"),
        "an address begins with https:// or http://: `{url}`"
    );
    ensure!(
        url.starts_with("https://") || args.sha256.is_some() || !file.sha256.is_empty(),
        "over http:// anybody on the way could change the file; give its SHA-256 with `--sha256`"
    );
    let destination = args
        .out
        .clone()
        .unwrap_or_else(|| Path::new(file.file_name()).to_owned());
    output::note(&format!(
        "{}: {}\n  from {url}\n  to   {}\n  licence: {}",
        file.name,
        file.what,
        destination.display(),
        file.licence
    ));
    let client = client();
    let (expected, whose) = expected(args, &file, || stated_sha256(&client, &url))?;
    output::note(&format!("  SHA-256 {expected} ({whose})"));
    let download = Download {
        url,
        destination: destination.clone(),
        expected,
        attempts: 5,
        pause: Duration::from_secs(2),
    };
    let mut last = Instant::now();
    let fetched = download.run(&client, &mut |event| match event {
        Event::Progress(done, total) => {
            if last.elapsed() > Duration::from_secs(5) {
                last = Instant::now();
                output::note(&progress(done, total));
            }
        }
        Event::Retry(why) => output::note(&format!("  connection lost ({why}); resuming")),
        Event::Hashing => output::note("  checking its SHA-256"),
    })?;
    if args.json {
        output::json(&Fetched {
            name: file.name,
            file: destination,
            bytes: fetched.bytes,
            sha256: fetched.sha256,
            sha256_from: whose,
            resumed_from: fetched.resumed_from,
        })?;
    } else {
        output::text(&format!(
            "`{}`: {} bytes, SHA-256 {}\nnext: {}",
            destination.display(),
            fetched.bytes,
            fetched.sha256,
            file.next.replace("FILE", &destination.display().to_string())
        ))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The hash that the file must have, and who says so.
fn expected(
    args: &Args,
    file: &PublicFile,
    stated: impl FnOnce() -> Option<String>,
) -> anyhow::Result<(Expected, &'static str)> {
    if let Some(digits) = &args.sha256 {
        return Ok((Expected::digits(digits)?, "given with --sha256"));
    }
    if !file.sha256.is_empty() {
        return Ok((Expected::digits(file.sha256)?, "published by its authors"));
    }
    if args.unverified {
        return Ok((Expected::Anything, "not verified"));
    }
    let digits = stated().with_context(|| {
        format!(
            "the SHA-256 of `{}` is unknown to this program and the server; give it with `--sha256`, or accept \
             any with `--unverified`",
            file.name
        )
    })?;
    Ok((Expected::digits(&digits)?, "stated by the server"))
}

fn progress(done: u64, total: Option<u64>) -> String {
    let mebibytes = |bytes: u64| bytes as f64 / f64::from(1 << 20);
    match total {
        Some(total) if total > 0 => format!(
            "  {:.0} of {:.0} MiB, {:.0} %",
            mebibytes(done),
            mebibytes(total),
            100.0 * done as f64 / total as f64
        ),
        _ => format!("  {:.0} MiB", mebibytes(done)),
    }
}

fn list(json: bool) -> anyhow::Result<()> {
    if json {
        let items = PUBLIC_FILES.to_vec();
        return output::json(&Items { items });
    }
    let mut text = String::new();
    for file in PUBLIC_FILES {
        text.push_str(&format!("{:<16}{}\n{:16}{}\n", file.name, file.what, "", file.url));
    }
    text.push_str("nothing was fetched; name one of them");
    output::text(&text)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(sha256: Option<&str>, unverified: bool) -> Args {
        Args {
            name: Some("movies".into()),
            out: None,
            url: None,
            sha256: sha256.map(str::to_owned),
            unverified,
            json: false,
        }
    }

    #[test]
    fn a_hash_is_the_users_the_authors_or_the_servers_and_never_missing_silently() {
        let file = |name: &str| PublicFile::by_name(name).unwrap();
        let none = || None;
        let known = expected(&args(None, false), &file("resplat-re10k"), none).unwrap();
        assert_eq!(
            known,
            (Expected::digits("b90d1b53").unwrap(), "published by its authors")
        );
        let given = expected(&args(Some("0123456789abcdef"), false), &file("resplat-re10k"), none).unwrap();
        assert_eq!(given.0, Expected::digits("0123456789abcdef").unwrap());
        let stated = expected(&args(None, false), &file("movies"), || Some("ab".repeat(32))).unwrap();
        assert_eq!(
            stated,
            (Expected::digits(&"ab".repeat(32)).unwrap(), "stated by the server")
        );
        let error = expected(&args(None, false), &file("movies"), none)
            .unwrap_err()
            .to_string();
        assert!(error.contains("--sha256") && error.contains("--unverified"), "{error}");
        assert_eq!(
            expected(&args(None, true), &file("movies"), none).unwrap().0,
            Expected::Anything
        );
    }

    #[test]
    fn unencrypted_addresses_need_a_hash_and_unknown_names_are_listed() {
        let mut plain = args(None, true);
        plain.url = Some("http://127.0.0.1:9/movies_ckpt.safetensors".into());
        assert!(run(&plain).unwrap_err().to_string().contains("--sha256"));
        plain.url = Some("ftp://example.org/x".into());
        assert!(run(&plain).unwrap_err().to_string().contains("https://"));
        plain.name = Some("gpt".into());
        assert!(run(&plain).unwrap_err().to_string().contains("resplat-re10k"));
    }
}
