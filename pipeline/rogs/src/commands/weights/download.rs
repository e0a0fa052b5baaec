//! Downloading one large file: resumed where it broke off, kept only when its SHA-256 is the expected one.
//!
//! Bytes go to `FILE.part` beside the destination. A later attempt, also one of another day, asks the server for the rest
//! (`Range`), on condition that the file there is still the same one (`If-Range`, with the entity tag noted in
//! `FILE.part.tag`). When all bytes are there they are read back and hashed; then the file gets its name.

use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context as _, bail, ensure};
use sha2::{Digest as _, Sha256};

/// Largest file that is accepted, whatever a server says.
const MOST_BYTES: u64 = 64 << 30;
/// Progress of an attempt that makes its failure not count.
const WORTHWHILE_BYTES: u64 = 1 << 20;

/// What the SHA-256 of a file must be.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Expected {
    /// It begins with these hexadecimal digits (64 of them: all of it).
    Digits(String),
    /// Nothing is known and the user said that this is fine.
    Anything,
}

/// A download.
#[derive(Debug, Clone)]
pub(super) struct Download {
    /// Address.
    pub(super) url: String,
    /// Where the file goes.
    pub(super) destination: PathBuf,
    /// Its hash.
    pub(super) expected: Expected,
    /// Attempts without progress before giving up.
    pub(super) attempts: u32,
    /// Pause before the second attempt; doubles with each further one.
    pub(super) pause: Duration,
}

/// What came of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Fetched {
    /// Size.
    pub(super) bytes: u64,
    /// SHA-256 in hexadecimal digits.
    pub(super) sha256: String,
    /// Bytes that were there before this run.
    pub(super) resumed_from: u64,
}

/// What happens meanwhile, for people.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Event {
    /// Bytes there, and in all if known.
    Progress(u64, Option<u64>),
    /// An attempt broke off.
    Retry(String),
    /// The bytes are being read back and hashed.
    Hashing,
}

/// The client: certificates of the web's authorities are built in; every attempt ends after ten minutes at most (and is
/// then resumed), so that a stalled connection does not hang forever.
pub(super) fn client() -> ureq::Agent {
    ureq::Agent::config_builder()
        .user_agent(concat!("rogs/", env!("CARGO_PKG_VERSION")))
        .timeout_connect(Some(Duration::from_secs(30)))
        .timeout_recv_response(Some(Duration::from_secs(60)))
        .timeout_recv_body(Some(Duration::from_secs(600)))
        .max_redirects(8)
        .http_status_as_error(false)
        .build()
        .into()
}

/// The SHA-256 that the server itself states for a file, if it does: model repositories give it as `X-Linked-ETag` of the
/// redirect to their storage.
pub(super) fn stated_sha256(client: &ureq::Agent, url: &str) -> Option<String> {
    let request = client
        .head(url)
        .config()
        .max_redirects(0)
        .max_redirects_will_error(false)
        .build();
    let response = request.call().ok()?;
    let tag = header(&response, "x-linked-etag")?;
    let digits = tag.trim_start_matches("W/").trim_matches('"').to_ascii_lowercase();
    (digits.len() == 64 && digits.bytes().all(|digit| digit.is_ascii_hexdigit())).then_some(digits)
}

impl Download {
    /// Runs the download.
    ///
    /// # Errors
    /// When the destination holds another file, the server does not deliver, the disk fails, or the hash is wrong (nothing
    /// is kept then). After an interruption what came so far stays, and the next run resumes there.
    pub(super) fn run(&self, client: &ureq::Agent, report: &mut dyn FnMut(Event)) -> anyhow::Result<Fetched> {
        let part = with_suffix(&self.destination, ".part");
        let tag = with_suffix(&self.destination, ".part.tag");
        if self.destination.exists() {
            return self.existing(report);
        }
        if let Some(folder) = self
            .destination
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
        {
            std::fs::create_dir_all(folder).with_context(|| format!("making `{}`", folder.display()))?;
        }
        let resumed_from = length(&part);
        let (mut failures, mut pause) = (0, self.pause);
        loop {
            let before = length(&part);
            match self.attempt(client, &part, &tag, report) {
                Ok(()) => break,
                Err(Failure::Final(error)) => return Err(error),
                Err(Failure::Broken(error)) => {
                    if length(&part).saturating_sub(before) >= WORTHWHILE_BYTES {
                        (failures, pause) = (0, self.pause);
                    }
                    failures += 1;
                    if failures >= self.attempts {
                        let there = length(&part);
                        return Err(error.context(format!(
                            "the download of `{}` broke off at byte {there}; the same command resumes there",
                            self.url
                        )));
                    }
                    report(Event::Retry(format!("{error:#}")));
                    std::thread::sleep(pause);
                    pause *= 2;
                }
            }
        }
        report(Event::Hashing);
        let sha256 = hash(&part)?;
        if !self.expected.matches(&sha256) {
            for file in [&part, &tag] {
                // Best effort: the hash is what the user must know.
                let _ = std::fs::remove_file(file);
            }
            bail!(
                "`{}` has the SHA-256 {sha256}, expected is {}; it was damaged on the way or is another file, and was not kept",
                self.url,
                self.expected
            );
        }
        let bytes = length(&part);
        rogs_files::rename(&part, &self.destination)?;
        let _ = std::fs::remove_file(&tag);
        Ok(Fetched {
            bytes,
            sha256,
            resumed_from,
        })
    }

    /// Checks a file that is there already.
    fn existing(&self, report: &mut dyn FnMut(Event)) -> anyhow::Result<Fetched> {
        report(Event::Hashing);
        let (shown, sha256) = (self.destination.display(), hash(&self.destination)?);
        ensure!(
            self.expected.matches(&sha256),
            "`{shown}` is there already and is another file: its SHA-256 is {sha256}, expected is {}; remove it or choose another \
             place with `--out`",
            self.expected
        );
        let bytes = length(&self.destination);
        Ok(Fetched {
            bytes,
            sha256,
            resumed_from: bytes,
        })
    }

    /// One request for what is missing, written to the part file as it comes.
    fn attempt(
        &self,
        client: &ureq::Agent,
        part: &Path,
        tag: &Path,
        report: &mut dyn FnMut(Event),
    ) -> Result<(), Failure> {
        let mut there = length(part);
        let noted = rogs_files::read_to_string(tag).unwrap_or_default();
        if there > 0 && noted.is_empty() && self.expected == Expected::Anything {
            // Nothing would notice that the file on the server is another one by now.
            there = 0;
        }
        let mut request = client.get(&self.url);
        if there > 0 {
            request = request.header("Range", format!("bytes={there}-"));
            if !noted.is_empty() {
                request = request.header("If-Range", noted);
            }
        }
        let response = request.call().map_err(|error| match error {
            ureq::Error::BadUri(_) | ureq::Error::Http(_) => Failure::Final(error.into()),
            error => Failure::Broken(error.into()),
        })?;
        let (status, total) = (response.status().as_u16(), total(&response));
        match status {
            200 => there = 0,
            206 => {
                let start = content_range(&response).map(|(start, _)| start);
                if start != Some(there) {
                    return Err(Failure::Final(anyhow::anyhow!(
                        "the server of `{}` answered with bytes from {start:?}, asked for were those from {there}",
                        self.url
                    )));
                }
            }
            // Nothing is missing, or the file there is shorter than what we have: then start again.
            416 if there > 0 && total == Some(there) => return Ok(()),
            416 if there > 0 => {
                let _ = std::fs::remove_file(part);
                return Err(Failure::Broken(anyhow::anyhow!(
                    "what was there is longer than the file; starting again"
                )));
            }
            408 | 429 | 500..=599 => {
                return Err(Failure::Broken(anyhow::anyhow!(
                    "the server of `{}` answered {status}",
                    self.url
                )));
            }
            _ => {
                return Err(Failure::Final(anyhow::anyhow!(
                    "the server of `{}` answered {status}: {}",
                    self.url,
                    response.status().canonical_reason().unwrap_or("no reason given")
                )));
            }
        }
        if let Some(total) = total.filter(|&total| total > MOST_BYTES) {
            return Err(Failure::Final(anyhow::anyhow!(
                "`{}` has {total} bytes, more than any weights file that this program knows",
                self.url
            )));
        }
        let strong = header(&response, "etag")
            .filter(|tag| !tag.starts_with("W/"))
            .unwrap_or_default();
        let file = || -> std::io::Result<File> {
            rogs_files::write_bytes(tag, strong.as_bytes())?;
            let file = OpenOptions::new().create(true).append(true).open(part)?;
            file.set_len(there)?;
            Ok(file)
        };
        let mut file = file()
            .with_context(|| format!("writing `{}`", part.display()))
            .map_err(Failure::Final)?;
        let mut body = response.into_body().into_reader();
        let mut buffer = vec![0; 1 << 18];
        report(Event::Progress(there, total));
        loop {
            let count = match body.read(&mut buffer) {
                Ok(0) => break,
                Ok(count) => count,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
                Err(error) => return Err(Failure::Broken(error.into())),
            };
            there += count as u64;
            if there > total.unwrap_or(MOST_BYTES) {
                return Err(Failure::Final(anyhow::anyhow!(
                    "the server of `{}` sends more than it announced",
                    self.url
                )));
            }
            let written = file.write_all(&buffer[..count]);
            written
                .with_context(|| format!("writing `{}`", part.display()))
                .map_err(Failure::Final)?;
            report(Event::Progress(there, total));
        }
        if let Some(total) = total.filter(|&total| total != there) {
            return Err(Failure::Broken(anyhow::anyhow!("{there} of {total} bytes came")));
        }
        file.sync_all()
            .with_context(|| format!("writing `{}`", part.display()))
            .map_err(Failure::Final)
    }
}

/// Why an attempt ended early.
enum Failure {
    /// Another attempt may do better.
    Broken(anyhow::Error),
    /// It will not.
    Final(anyhow::Error),
}

impl Expected {
    /// From digits that a person or a server gave.
    ///
    /// # Errors
    /// When these are not hexadecimal digits, or too few to tell files apart.
    pub(super) fn digits(digits: &str) -> anyhow::Result<Self> {
        let digits = digits.trim().to_ascii_lowercase();
        ensure!(
            (8..=64).contains(&digits.len()) && digits.bytes().all(|digit| digit.is_ascii_hexdigit()),
            "a SHA-256 has 64 hexadecimal digits, of which at least the first 8 are needed: `{digits}`"
        );
        Ok(Self::Digits(digits))
    }

    fn matches(&self, sha256: &str) -> bool {
        match self {
            Self::Digits(digits) => sha256.starts_with(digits.as_str()),
            Self::Anything => true,
        }
    }
}

impl std::fmt::Display for Expected {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Digits(digits) if digits.len() < 64 => write!(f, "{digits}..."),
            Self::Digits(digits) => f.write_str(digits),
            Self::Anything => f.write_str("any"),
        }
    }
}

/// SHA-256 of a file in hexadecimal digits.
pub(super) fn hash(path: &Path) -> anyhow::Result<String> {
    let reading = || format!("reading `{}`", path.display());
    let mut file = rogs_files::open(path).with_context(reading)?;
    let (mut hasher, mut buffer) = (Sha256::new(), vec![0; 1 << 18]);
    loop {
        let count = file.read(&mut buffer).with_context(reading)?;
        if count == 0 {
            break;
        }
        hasher.update(&buffer[..count]);
    }
    Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
}

fn length(path: &Path) -> u64 {
    std::fs::metadata(path).map_or(0, |metadata| metadata.len())
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(suffix);
    path.with_file_name(name)
}

type Response = ureq::http::Response<ureq::Body>;

fn header(response: &Response, name: &str) -> Option<String> {
    response.headers().get(name)?.to_str().ok().map(str::to_owned)
}

/// First byte (if any) and size of the whole, of `bytes 5-9/10` or `bytes */10`.
fn content_range(response: &Response) -> Option<(u64, u64)> {
    let text = header(response, "content-range")?;
    let (range, total) = text.strip_prefix("bytes ")?.split_once('/')?;
    let start = range
        .split_once('-')
        .and_then(|(start, _)| start.trim().parse().ok())
        .unwrap_or(0);
    Some((start, total.trim().parse().ok()?))
}

/// Size of the whole file, as the server says.
fn total(response: &Response) -> Option<u64> {
    content_range(response)
        .map(|(_, total)| total)
        .or_else(|| (response.status() == 200).then(|| header(response, "content-length")?.parse().ok())?)
}

#[cfg(test)]
#[path = "download_tests.rs"]
mod tests;
