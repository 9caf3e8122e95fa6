//! Reading one request, with every doubt decided against it.

use std::io::{ErrorKind, Read};
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::Limits;

/// Headers that a request may have; browsers send about twenty.
const HEADER_COUNT: usize = 64;

/// What is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// Something to read.
    Get,
    /// Something to do.
    Post,
}

/// A request of one of this server's own pages, or of the person at this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Request {
    /// Reading or doing.
    pub method: Method,
    /// The parts of the path, decoded. None is empty, `.` or `..`, and none holds a slash, backslash or control character.
    pub path: Vec<String>,
    /// What was posted: JSON, as text.
    pub body: String,
    /// False for HEAD, which wants the headers alone.
    pub wants_body: bool,
}

impl Request {
    /// The parts of the path, to be matched with.
    pub fn parts(&self) -> Vec<&str> {
        self.path.iter().map(String::as_str).collect()
    }
}

/// Why a request is not answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// The connection was closed, or broke, before anything came.
    Silence,
    /// It did not arrive in time.
    Slow,
    /// It is not HTTP, or says contradictory things.
    Malformed,
    /// Its headers are too long.
    LongHead,
    /// Its body is too long.
    LongBody,
    /// A post without its length.
    NoLength,
    /// A way of sending that is not read here.
    Encoded,
    /// Neither GET, HEAD nor POST.
    OtherMethod,
    /// It was not sent to this server's own address.
    ForeignHost,
    /// It comes from another site's page.
    ForeignOrigin,
    /// A post of something other than JSON.
    NoJson,
}

impl Refusal {
    /// Status code and what to say.
    pub fn answer(self) -> (u16, &'static str) {
        match self {
            Self::Silence | Self::Slow => (408, "the request did not arrive in time"),
            Self::Malformed => (400, "this is not a proper request"),
            Self::LongHead => (431, "the headers are too long"),
            Self::LongBody => (413, "the body is too long"),
            Self::NoLength => (411, "a post needs its length"),
            Self::Encoded => (501, "transfer encodings are not read here"),
            Self::OtherMethod => (405, "only GET, HEAD and POST are answered"),
            Self::ForeignHost => (421, "this address is not mine: open the one that the terminal shows"),
            Self::ForeignOrigin => (403, "only this server's own pages may ask this"),
            Self::NoJson => (415, "posts are application/json in UTF-8"),
        }
    }
}

/// Reads a request that came to `port` of 127.0.0.1.
pub fn read(stream: &TcpStream, limits: &Limits, port: u16) -> Result<Request, Refusal> {
    let deadline = Instant::now() + limits.patience;
    let mut bytes = Vec::new();
    let head_length = loop {
        let mut headers = [httparse::EMPTY_HEADER; HEADER_COUNT];
        match httparse::Request::new(&mut headers).parse(&bytes) {
            Ok(httparse::Status::Complete(length)) => break length,
            Err(httparse::Error::TooManyHeaders) => return Err(Refusal::LongHead),
            Err(_) => return Err(Refusal::Malformed),
            Ok(httparse::Status::Partial) if bytes.len() >= limits.head => return Err(Refusal::LongHead),
            Ok(httparse::Status::Partial) => {}
        }
        if receive(stream, deadline, &mut bytes, limits.head)? == 0 {
            return Err(if bytes.is_empty() { Refusal::Silence } else { Refusal::Malformed });
        }
    };
    let mut body = bytes.split_off(head_length);
    let mut headers = [httparse::EMPTY_HEADER; HEADER_COUNT];
    let mut head = httparse::Request::new(&mut headers);
    head.parse(&bytes).map_err(|_| Refusal::Malformed)?;
    let checked = checked(&head, limits, port)?;
    if checked.method == Method::Post {
        while body.len() < checked.body_length {
            if receive(stream, deadline, &mut body, checked.body_length)? == 0 {
                return Err(Refusal::Malformed);
            }
        }
    }
    if body.len() != checked.body_length {
        return Err(Refusal::Malformed);
    }
    let path = path_parts(head.path.ok_or(Refusal::Malformed)?)?;
    let body = String::from_utf8(body).map_err(|_| Refusal::NoJson)?;
    Ok(Request { method: checked.method, path, body, wants_body: head.method != Some("HEAD") })
}

/// What the headers say, as far as it matters.
struct CheckedHead {
    method: Method,
    body_length: usize,
}

fn checked(head: &httparse::Request<'_, '_>, limits: &Limits, port: u16) -> Result<CheckedHead, Refusal> {
    let is_own_host = |text: &str| text == format!("127.0.0.1:{port}") || text == format!("localhost:{port}");
    let host = only(head, "host")?.ok_or(Refusal::Malformed)?;
    if !is_own_host(host) {
        return Err(Refusal::ForeignHost);
    }
    let origin = only(head, "origin")?;
    let is_own_origin = |text: &str| text.strip_prefix("http://").is_some_and(is_own_host);
    if origin.is_some_and(|origin| !is_own_origin(origin)) {
        return Err(Refusal::ForeignOrigin);
    }
    // Sent by browsers, whatever a page does: `none` is an address that the person typed or opened.
    if only(head, "sec-fetch-site")?.is_some_and(|site| !["same-origin", "none"].contains(&site)) {
        return Err(Refusal::ForeignOrigin);
    }
    if only(head, "transfer-encoding")?.is_some() {
        return Err(Refusal::Encoded);
    }
    let length = only(head, "content-length")?.map(|text| {
        let is_number = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        // A number too long to be read is a body too long to be read.
        if is_number { Ok(text.parse().unwrap_or(usize::MAX)) } else { Err(Refusal::Malformed) }
    });
    let length: Option<usize> = length.transpose()?;
    match head.method {
        Some("GET" | "HEAD") if length.unwrap_or(0) == 0 => {
            Ok(CheckedHead { method: Method::Get, body_length: 0 })
        }
        Some("GET" | "HEAD") => Err(Refusal::Malformed),
        // Browsers name the origin of every post; what names none is no page of ours.
        Some("POST") if origin.is_none() => Err(Refusal::ForeignOrigin),
        Some("POST") => {
            let body_length = length.ok_or(Refusal::NoLength)?;
            if body_length > limits.body {
                return Err(Refusal::LongBody);
            }
            // A form of another site cannot send this type without asking first, and asking is refused.
            let content_type = only(head, "content-type")?.unwrap_or_default();
            let kind = content_type.split(';').next().unwrap_or_default().trim();
            if kind.eq_ignore_ascii_case("application/json") {
                Ok(CheckedHead { method: Method::Post, body_length })
            } else {
                Err(Refusal::NoJson)
            }
        }
        _ => Err(Refusal::OtherMethod),
    }
}

/// A header that may stand once: two of them, of which each reader could believe another, are refused.
fn only<'a>(head: &httparse::Request<'_, 'a>, name: &str) -> Result<Option<&'a str>, Refusal> {
    let mut found = head.headers.iter().filter(|header| header.name.eq_ignore_ascii_case(name));
    let first = found.next();
    if found.next().is_some() {
        return Err(Refusal::Malformed);
    }
    first.map(|header| std::str::from_utf8(header.value).map_err(|_| Refusal::Malformed)).transpose()
}

/// Decoded parts of a path. Nothing here is asked for with a question mark.
fn path_parts(target: &str) -> Result<Vec<String>, Refusal> {
    let path = target.strip_prefix('/').filter(|path| !path.contains('?')).ok_or(Refusal::Malformed)?;
    if path.is_empty() {
        return Ok(Vec::new());
    }
    let parts = path.split('/').map(|part| {
        let part = decoded(part)?;
        let is_name = !part.is_empty() && part != "." && part != "..";
        let is_plain = !part.contains(|c: char| c == '/' || c == '\\' || c.is_control());
        (is_name && is_plain).then_some(part)
    });
    parts.collect::<Option<_>>().ok_or(Refusal::Malformed)
}

/// Text with its `%41` resolved, once.
fn decoded(text: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let [first, after @ ..] = rest {
        rest = after;
        if *first != b'%' {
            bytes.push(*first);
            continue;
        }
        let [high, low, after @ ..] = rest else { return None };
        let digit = |byte: u8| char::from(byte).to_digit(16);
        bytes.push((digit(*high)? * 16 + digit(*low)?) as u8);
        rest = after;
    }
    String::from_utf8(bytes).ok()
}

/// Appends what has come, up to `limit` bytes in all; 0 at the end of the stream.
fn receive(
    stream: &TcpStream,
    deadline: Instant,
    bytes: &mut Vec<u8>,
    limit: usize,
) -> Result<usize, Refusal> {
    let mut block = [0; 4096];
    let room = limit.saturating_sub(bytes.len()).min(block.len());
    let left = deadline.saturating_duration_since(Instant::now());
    if left.is_zero() {
        return Err(Refusal::Slow);
    }
    stream.set_read_timeout(Some(left)).map_err(|_| Refusal::Silence)?;
    let mut reader = stream;
    loop {
        return match reader.read(&mut block[..room]) {
            Ok(count) => {
                bytes.extend_from_slice(&block[..count]);
                Ok(count)
            }
            Err(error) if error.kind() == ErrorKind::Interrupted => continue,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                Err(if bytes.is_empty() { Refusal::Silence } else { Refusal::Slow })
            }
            Err(_) => Err(Refusal::Silence),
        };
    }
}

/// Reads what a refused sender still has to say, for a moment and up to a bound.
pub fn discard_rest(stream: &TcpStream, limits: &Limits) {
    let deadline = Instant::now() + Duration::from_millis(500).min(limits.patience);
    let mut bytes = Vec::new();
    while receive(stream, deadline, &mut bytes, limits.body).is_ok_and(|count| count > 0) {}
}
