#![allow(clippy::disallowed_methods, reason = "files of tests may be left half-written")]
use std::io::{BufRead as _, BufReader, Write as _};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

use super::*;

/// What a request asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Asked {
    method: String,
    from: Option<usize>,
    if_range: Option<String>,
}

/// What the server does with one.
struct Answer {
    status: &'static str,
    headers: Vec<(&'static str, String)>,
    body: Vec<u8>,
    /// Close the connection after so many bytes of the body, though more were announced.
    cut: Option<usize>,
}

/// A server for one test: answers every request with a function of it and of the number of requests before.
struct Server {
    address: String,
    asked: Arc<Mutex<Vec<Asked>>>,
}

impl Server {
    fn start(answer: impl Fn(&Asked, usize) -> Answer + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = format!("http://{}/weights.bin", listener.local_addr().unwrap());
        let asked = Arc::new(Mutex::new(Vec::new()));
        let log = asked.clone();
        std::thread::spawn(move || {
            for stream in listener.incoming() {
                let Ok(stream) = stream else { return };
                let request = read(&stream);
                let before = log.lock().unwrap().len();
                log.lock().unwrap().push(request.clone());
                write(stream, answer(&request, before), request.method == "HEAD");
            }
        });
        Self { address, asked }
    }

    fn asked(&self) -> Vec<Asked> {
        self.asked.lock().unwrap().clone()
    }
}

fn read(stream: &TcpStream) -> Asked {
    let mut lines = BufReader::new(stream)
        .lines()
        .map_while(Result::ok)
        .take_while(|line| !line.is_empty());
    let method = lines
        .next()
        .unwrap_or_default()
        .split(' ')
        .next()
        .unwrap_or_default()
        .to_owned();
    let mut asked = Asked {
        method,
        from: None,
        if_range: None,
    };
    for line in lines {
        let Some((name, value)) = line.split_once(": ") else {
            continue;
        };
        match name.to_ascii_lowercase().as_str() {
            "range" => asked.from = value.trim_start_matches("bytes=").trim_end_matches('-').parse().ok(),
            "if-range" => asked.if_range = Some(value.to_owned()),
            _ => {}
        }
    }
    asked
}

fn write(mut stream: TcpStream, answer: Answer, head: bool) {
    let mut text = format!(
        "HTTP/1.1 {}\r\nContent-Length: {}\r\nConnection: close\r\n",
        answer.status,
        answer.body.len()
    );
    for (name, value) in &answer.headers {
        text.push_str(&format!("{name}: {value}\r\n"));
    }
    text.push_str("\r\n");
    let body = &answer.body[..answer.cut.unwrap_or(answer.body.len())];
    // A client that has seen enough closes first; that is not a failure of the server.
    let _ = stream.write_all(text.as_bytes());
    if !head {
        let _ = stream.write_all(body);
    }
    let _ = stream.flush();
}

/// A file that no compression would shorten.
fn content() -> Vec<u8> {
    (0..300_000u32)
        .map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8)
        .collect()
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A well-behaved server of a file: honours ranges of the entity `"one"`; the first `broken` replies are cut.
fn well_behaved(content: Vec<u8>, broken: usize) -> Server {
    Server::start(move |asked, before| {
        let from = asked
            .from
            .filter(|_| asked.if_range.as_deref().is_none_or(|tag| tag == "\"one\""));
        let start = from.unwrap_or(0);
        let mut headers = vec![("ETag", "\"one\"".to_owned())];
        if from.is_some() {
            headers.push((
                "Content-Range",
                format!("bytes {start}-{}/{}", content.len() - 1, content.len()),
            ));
        }
        Answer {
            status: if from.is_some() {
                "206 Partial Content"
            } else {
                "200 OK"
            },
            headers,
            body: content[start..].to_vec(),
            cut: (before < broken).then_some(100_000),
        }
    })
}

fn download(server: &Server, folder: &Path, expected: Expected) -> Download {
    Download {
        url: server.address.clone(),
        destination: folder.join("deep/weights.bin"),
        expected,
        attempts: 3,
        pause: Duration::ZERO,
    }
}

fn run(download: &Download) -> anyhow::Result<Fetched> {
    download.run(&client(), &mut |_| {})
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder.join("deep")).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

#[test]
fn a_file_is_kept_under_its_name_when_its_hash_is_right() {
    let (folder, content) = (tempfile::tempdir().unwrap(), content());
    let server = well_behaved(content.clone(), 0);
    let download = download(&server, folder.path(), Expected::digits(&sha256(&content)).unwrap());
    let fetched = run(&download).unwrap();
    assert_eq!((fetched.bytes, fetched.resumed_from), (300_000, 0));
    assert_eq!(std::fs::read(&download.destination).unwrap(), content);
    assert_eq!(names(folder.path()), ["weights.bin"]);
    // Once it is there and right, nobody is asked.
    assert_eq!(run(&download).unwrap().resumed_from, 300_000);
    assert_eq!(server.asked().len(), 1);
    std::fs::write(&download.destination, b"other").unwrap();
    let error = run(&download).unwrap_err().to_string();
    assert!(error.contains("is another file") && error.contains("--out"), "{error}");
}

#[test]
fn an_interrupted_download_goes_on_where_it_broke_off() {
    let (folder, content) = (tempfile::tempdir().unwrap(), content());
    let server = well_behaved(content.clone(), 1);
    let download = download(
        &server,
        folder.path(),
        Expected::digits(&sha256(&content)[..8]).unwrap(),
    );
    let mut retries = 0;
    let fetched = download.run(&client(), &mut |event| {
        retries += usize::from(matches!(event, Event::Retry(_)))
    });
    assert_eq!(fetched.unwrap().bytes, 300_000);
    assert_eq!(retries, 1);
    assert_eq!(std::fs::read(&download.destination).unwrap(), content);
    let asked = server.asked();
    assert_eq!((asked[0].from, asked.len()), (None, 2));
    assert_eq!(
        (asked[1].from, asked[1].if_range.as_deref()),
        (Some(100_000), Some("\"one\""))
    );
}

#[test]
fn what_came_stays_when_the_attempts_are_used_up_and_the_next_run_goes_on() {
    let (folder, content) = (tempfile::tempdir().unwrap(), content());
    let server = well_behaved(content.clone(), 1);
    let mut download = download(&server, folder.path(), Expected::digits(&sha256(&content)).unwrap());
    download.attempts = 1;
    let error = run(&download).unwrap_err().to_string();
    assert!(
        error.contains("broke off at byte 100000") && error.contains("resumes there"),
        "{error}"
    );
    assert_eq!(names(folder.path()), ["weights.bin.part", "weights.bin.part.tag"]);
    let fetched = run(&download).unwrap();
    assert_eq!((fetched.resumed_from, fetched.bytes), (100_000, 300_000));
    assert_eq!(std::fs::read(&download.destination).unwrap(), content);
}

#[test]
fn a_file_that_changed_meanwhile_or_a_server_without_ranges_starts_again() {
    let (folder, content) = (tempfile::tempdir().unwrap(), content());
    let server = well_behaved(content.clone(), 0);
    let download = download(&server, folder.path(), Expected::digits(&sha256(&content)).unwrap());
    let part = folder.path().join("deep/weights.bin.part");
    std::fs::create_dir(folder.path().join("deep")).unwrap();
    // Bytes of another entity: the server answers with the whole of the new one.
    std::fs::write(&part, [7; 5_000]).unwrap();
    std::fs::write(folder.path().join("deep/weights.bin.part.tag"), "\"older\"").unwrap();
    assert_eq!(run(&download).unwrap().bytes, 300_000);
    assert_eq!(std::fs::read(&download.destination).unwrap(), content);
    // More than there is: begun anew after the server said so.
    std::fs::remove_file(&download.destination).unwrap();
    std::fs::write(&part, vec![7; 300_001]).unwrap();
    let whole = content.clone();
    let server = Server::start(move |asked, _| match asked.from {
        Some(_) => Answer {
            status: "416 Range Not Satisfiable",
            headers: vec![("Content-Range", format!("bytes */{}", whole.len()))],
            body: Vec::new(),
            cut: None,
        },
        None => Answer {
            status: "200 OK",
            headers: Vec::new(),
            body: whole.clone(),
            cut: None,
        },
    });
    let download = Download {
        url: server.address.clone(),
        ..download
    };
    assert_eq!(run(&download).unwrap().bytes, 300_000);
    // All of it there, but not yet named: nothing more is asked for than the end.
    std::fs::rename(&download.destination, &part).unwrap();
    assert_eq!(run(&download).unwrap().resumed_from, 300_000);
}

#[test]
fn a_wrong_hash_keeps_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let server = well_behaved(content(), 0);
    let download = download(
        &server,
        folder.path(),
        Expected::digits(&sha256(b"another file")).unwrap(),
    );
    let error = run(&download).unwrap_err().to_string();
    for part in [sha256(&content()), sha256(b"another file"), "was not kept".to_owned()] {
        assert!(error.contains(&part), "{error}");
    }
    assert_eq!(names(folder.path()), Vec::<String>::new());
}

#[test]
fn a_refusal_is_final_and_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(|_, _| Answer {
        status: "404 Not Found",
        headers: Vec::new(),
        body: b"no such file".to_vec(),
        cut: None,
    });
    let error = run(&download(&server, folder.path(), Expected::Anything))
        .unwrap_err()
        .to_string();
    assert!(error.contains("404") && error.contains(&server.address), "{error}");
    assert_eq!(server.asked().len(), 1);
}

#[test]
fn the_servers_own_statement_of_a_hash_is_heard() {
    let digits = sha256(b"weights");
    let stated = digits.clone();
    let server = Server::start(move |_, _| Answer {
        status: "302 Found",
        headers: vec![
            ("Location", "http://127.0.0.1:9/elsewhere".to_owned()),
            ("X-Linked-ETag", format!("\"{stated}\"")),
        ],
        body: Vec::new(),
        cut: None,
    });
    assert_eq!(stated_sha256(&client(), &server.address), Some(digits));
    assert_eq!(server.asked()[0].method, "HEAD");
    let silent = well_behaved(content(), 0);
    assert_eq!(
        stated_sha256(&client(), &silent.address),
        None,
        "an entity tag is not a hash"
    );
}

#[test]
fn hashes_are_hexadecimal_digits() {
    assert!(Expected::digits("B90D1B53").is_ok());
    for wrong in ["", "b90d1b5", "not a hash", &"0".repeat(65)] {
        assert!(Expected::digits(wrong).is_err(), "{wrong}");
    }
}
