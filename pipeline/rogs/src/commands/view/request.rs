//! The little of HTTP/1.1 that the viewer speaks: `GET` and `HEAD` without a body, one range of bytes.

/// Longest head of a request, bytes.
pub(super) const LONGEST_HEAD: usize = 16 << 10;

/// What was asked for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Request {
    /// Whether only the head of the answer is wanted.
    pub(super) head_only: bool,
    /// The address, with its leading slash.
    pub(super) path: String,
    /// The host that it was meant for.
    pub(super) host: String,
    /// First and last byte, where only a part is wanted.
    pub(super) range: Option<(u64, Option<u64>)>,
}

/// Where the head of a request ends, once it is there.
pub(super) fn end_of_head(bytes: &[u8]) -> Option<usize> {
    let blank = b"\r\n\r\n";
    let found = bytes.windows(blank.len()).position(|window| window == blank);
    found.map(|at| at + blank.len())
}

/// Reads the head of a request; none where it is no request that is answered.
pub(super) fn parse(head: &[u8]) -> Option<Request> {
    let text = std::str::from_utf8(head).ok()?;
    let mut lines = text.split("\r\n");
    let mut words = lines.next()?.split(' ');
    let (method, path, version) = (words.next()?, words.next()?, words.next()?);
    let known = matches!(method, "GET" | "HEAD") && matches!(version, "HTTP/1.1" | "HTTP/1.0");
    if !known || words.next().is_some() || !path.starts_with('/') {
        return None;
    }
    let mut request = Request {
        head_only: method == "HEAD",
        path: path.to_owned(),
        host: String::new(),
        range: None,
    };
    for line in lines.take_while(|line| !line.is_empty()) {
        let (name, value) = line.split_once(':')?;
        if name.eq_ignore_ascii_case("host") {
            value.trim().clone_into(&mut request.host);
        } else if name.eq_ignore_ascii_case("range") {
            request.range = range(value.trim());
        }
    }
    Some(request)
}

/// One range that begins at a byte; others are not understood, which means the whole.
fn range(value: &str) -> Option<(u64, Option<u64>)> {
    let (first, last) = value.strip_prefix("bytes=")?.split_once('-')?;
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    if first.is_empty() || !digits(first) || !digits(last) {
        return None;
    }
    let last = if last.is_empty() {
        None
    } else {
        Some(last.parse().ok()?)
    };
    Some((first.parse().ok()?, last))
}

/// A part of so many bytes, as an index range; none where the part begins behind the end.
pub(super) fn part(range: (u64, Option<u64>), length: usize) -> Option<std::ops::Range<usize>> {
    let first = usize::try_from(range.0).ok().filter(|&first| first < length)?;
    let last = range
        .1
        .map_or(length - 1, |last| usize::try_from(last).unwrap_or(usize::MAX));
    (first <= last).then(|| first..last.min(length - 1) + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_of_browsers_are_understood() {
        let head = b"GET /abc/scene/0 HTTP/1.1\r\nHost: 127.0.0.1:80\r\nrange: bytes=16-31\r\nX: y:z\r\n\r\n";
        let request = parse(head).unwrap();
        assert_eq!(
            (
                request.path.as_str(),
                request.host.as_str(),
                request.range,
                request.head_only
            ),
            ("/abc/scene/0", "127.0.0.1:80", Some((16, Some(31))), false)
        );
        assert!(parse(b"HEAD / HTTP/1.0\r\n\r\n").unwrap().head_only);
        assert_eq!(end_of_head(b"GET / HTTP/1.1\r\n\r\nrest"), Some(18));
        assert_eq!(end_of_head(b"GET / HTTP/1.1\r\n"), None);
    }

    #[test]
    fn what_is_not_asked_by_browsers_is_not_answered() {
        for head in [
            "POST / HTTP/1.1",
            "GET / HTTP/2",
            "GET /",
            "GET a HTTP/1.1",
            "GET / x HTTP/1.1",
            "",
            "GET / HTTP/1.1\r\nbad",
        ] {
            assert_eq!(parse(format!("{head}\r\n\r\n").as_bytes()), None, "{head}");
        }
        assert_eq!(parse(b"GET /\xff HTTP/1.1\r\n\r\n"), None);
        // Any bytes at all: never a panic.
        let mut state = 1u32;
        for length in 0..600 {
            let bytes: Vec<u8> = (0..length)
                .map(|_| {
                    state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    b"GETHAD /1.:bytes=-\r\n\xff"[(state >> 24) as usize % 21]
                })
                .collect();
            let _ = parse(&bytes).map(|request| request.range.map(|range| part(range, 7)));
        }
    }

    #[test]
    fn parts_lie_within_the_whole() {
        assert_eq!(part((2, Some(4)), 10), Some(2..5));
        assert_eq!(part((2, None), 10), Some(2..10));
        assert_eq!(part((2, Some(u64::MAX)), 10), Some(2..10));
        for (range, length) in [
            ((10, None), 10),
            ((0, None), 0),
            ((5, Some(4)), 10),
            ((u64::MAX, None), 10),
        ] {
            assert_eq!(part(range, length), None);
        }
        for bad in [
            "bytes=-5",
            "bytes=a-",
            "bytes=1-2,3-4",
            "lines=1-2",
            "bytes=+1-",
            "bytes=99999999999999999999-",
        ] {
            assert_eq!(range(bad), None, "{bad}");
        }
    }
}
