//! A server of one page and its scenes on the loopback address, for whoever knows its token.

use std::hash::{BuildHasher as _, RandomState};
use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use anyhow::Context as _;

use super::request::{LONGEST_HEAD, Request, end_of_head, parse, part};

/// How long a browser may take to say what it wants, and to take what it gets.
const PATIENCE: Duration = Duration::from_secs(20);
/// Most answers at a time.
const MOST_AT_ONCE: usize = 32;

/// What can be asked for.
pub(super) trait Content: Send + Sync {
    /// Media type and bytes of an address behind the token, which has no leading slash; none where there is nothing.
    fn get(&self, path: &str) -> Option<(&'static str, Arc<Vec<u8>>)>;
}

/// A server that listens.
pub(super) struct Server {
    listener: TcpListener,
    port: u16,
    token: String,
}

impl Server {
    /// Listens on the loopback address; port 0 is any free one.
    pub(super) fn listen(port: u16) -> anyhow::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))
            .with_context(|| format!("cannot listen on port {port} of this machine"))?;
        let port = listener.local_addr()?.port();
        Ok(Self {
            listener,
            port,
            token: token(),
        })
    }

    /// The address of the page.
    pub(super) fn address(&self) -> String {
        format!("http://127.0.0.1:{}/{}/", self.port, self.token)
    }

    /// Answers until the program ends.
    pub(super) fn serve(&self, content: &dyn Content) {
        let busy = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for stream in self.listener.incoming().flatten() {
                if busy.fetch_add(1, Ordering::Relaxed) >= MOST_AT_ONCE {
                    busy.fetch_sub(1, Ordering::Relaxed);
                    continue;
                }
                let busy = &busy;
                scope.spawn(move || {
                    // A browser that went away is no failure of ours.
                    let _ = self.answer(stream, content);
                    busy.fetch_sub(1, Ordering::Relaxed);
                });
            }
        });
    }

    fn answer(&self, mut stream: TcpStream, content: &dyn Content) -> std::io::Result<()> {
        stream.set_read_timeout(Some(PATIENCE))?;
        stream.set_write_timeout(Some(PATIENCE))?;
        let mut head = Vec::new();
        let mut buffer = [0; 2048];
        let end = loop {
            let count = stream.read(&mut buffer)?;
            head.extend_from_slice(&buffer[..count]);
            match end_of_head(&head) {
                Some(end) => break end,
                None if count == 0 || head.len() > LONGEST_HEAD => return Ok(()),
                None => {}
            }
        };
        let Some(request) = parse(&head[..end]) else {
            return reply(&mut stream, "400 Bad Request", &[], &[]);
        };
        let Some((kind, bytes)) = self.find(&request, content) else {
            return reply(&mut stream, "404 Not Found", &[], &[]);
        };
        let kind = format!("Content-Type: {kind}");
        let (status, range, more) = match request.range {
            None => ("200 OK", 0..bytes.len(), None),
            Some(asked) => match part(asked, bytes.len()) {
                Some(range) => {
                    let said = format!("Content-Range: bytes {}-{}/{}", range.start, range.end - 1, bytes.len());
                    ("206 Partial Content", range, Some(said))
                }
                None => {
                    let said = format!("Content-Range: bytes */{}", bytes.len());
                    return reply(&mut stream, "416 Range Not Satisfiable", &[&said], &[]);
                }
            },
        };
        let length = format!("Content-Length: {}", range.len());
        let mut lines = vec![kind.as_str(), "Accept-Ranges: bytes", &length];
        lines.extend(more.as_deref());
        let body = if request.head_only { &[] } else { &bytes[range] };
        reply(&mut stream, status, &lines, body)
    }

    /// What a request asks for: of this machine alone, so that no page of another name reaches us, and behind the token.
    fn find(&self, request: &Request, content: &dyn Content) -> Option<(&'static str, Arc<Vec<u8>>)> {
        let names = ["127.0.0.1", "localhost"].map(|name| format!("{name}:{}", self.port));
        if !names.contains(&request.host) {
            return None;
        }
        let path = request
            .path
            .strip_prefix('/')?
            .strip_prefix(&self.token)?
            .strip_prefix('/')?;
        content.get(path)
    }
}

/// 128 bits that nobody can guess, from the random keys that the system gives to hash tables.
fn token() -> String {
    let half = |salt: u64| RandomState::new().hash_one(salt);
    format!("{:016x}{:016x}", half(1), half(2))
}

fn reply(stream: &mut TcpStream, status: &str, lines: &[&str], body: &[u8]) -> std::io::Result<()> {
    let mut head = format!("HTTP/1.1 {status}\r\n");
    let length = "Content-Length: 0";
    let own = if lines.iter().any(|line| line.starts_with("Content-Length")) {
        None
    } else {
        Some(length)
    };
    let always = [
        "Connection: close",
        "Cache-Control: no-store",
        "X-Content-Type-Options: nosniff",
        "Referrer-Policy: no-referrer",
        "Cross-Origin-Resource-Policy: same-origin",
    ];
    for line in lines.iter().copied().chain(own).chain(always) {
        head.push_str(line);
        head.push_str("\r\n");
    }
    head.push_str("\r\n");
    stream.write_all(head.as_bytes())?;
    stream.write_all(body)?;
    stream.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    struct One;

    impl Content for One {
        fn get(&self, path: &str) -> Option<(&'static str, Arc<Vec<u8>>)> {
            (path == "scene/0").then(|| ("application/octet-stream", Arc::new(b"0123456789".to_vec())))
        }
    }

    /// The answer to a request of this path and these lines.
    fn ask(server: &Server, path: &str, lines: &str) -> String {
        let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, server.port)).unwrap();
        let request = format!("GET {path} HTTP/1.1\r\n{lines}\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        answer
    }

    #[test]
    fn only_whoever_knows_the_token_gets_what_there_is() {
        let server: &'static Server = Box::leak(Box::new(Server::listen(0).unwrap()));
        std::thread::spawn(|| server.serve(&One));
        let host = format!("Host: 127.0.0.1:{}", server.port);
        let path = format!("/{}/scene/0", server.token);
        let whole = ask(server, &path, &host);
        assert!(
            whole.starts_with("HTTP/1.1 200 OK\r\n") && whole.ends_with("\r\n\r\n0123456789"),
            "{whole}"
        );
        let part = ask(server, &path, &format!("{host}\r\nRange: bytes=2-4"));
        assert!(
            part.starts_with("HTTP/1.1 206") && part.contains("bytes 2-4/10") && part.ends_with("\r\n\r\n234"),
            "{part}"
        );
        let behind = ask(server, &path, &format!("{host}\r\nRange: bytes=10-"));
        assert!(behind.starts_with("HTTP/1.1 416"), "{behind}");
        let elsewhere = format!("/{}/../etc/passwd", server.token);
        let refused = [
            ("/scene/0", &host),
            ("/", &host),
            (&elsewhere, &host),
            (&path, &"Host: evil.example".to_owned()),
        ];
        for (path, host) in refused {
            assert!(ask(server, path, host).starts_with("HTTP/1.1 404"), "{path} {host}");
        }
        assert!(ask(server, "nonsense", "").starts_with("HTTP/1.1 400"));
    }

    #[test]
    fn tokens_differ() {
        assert_ne!(token(), token());
        assert_eq!(token().len(), 32);
    }
}
