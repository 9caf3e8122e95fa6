//! What is sent back, with headers that keep a browser from doing anything else with it.

use std::borrow::Cow;
use std::io::{self, Write};
use std::net::TcpStream;

use serde::Serialize;

use super::request::Refusal;

/// Pages run their own scripts alone, talk to this server alone, and stand in no frame of others.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// An answer to a request.
#[derive(Clone, Debug)]
pub struct Answer {
    status: u16,
    content_type: &'static str,
    body: Cow<'static, [u8]>,
    is_last: bool,
}

impl Answer {
    fn new(content_type: &'static str, body: impl Into<Cow<'static, [u8]>>) -> Self {
        Self { status: 200, content_type, body: body.into(), is_last: false }
    }

    /// A page. Its scripts and styles are addresses of their own: inline ones do not run.
    pub fn page(html: impl Into<String>) -> Self {
        Self::new("text/html; charset=utf-8", html.into().into_bytes())
    }

    /// A script.
    pub fn script(text: impl Into<String>) -> Self {
        Self::new("text/javascript; charset=utf-8", text.into().into_bytes())
    }

    /// A style sheet.
    pub fn style(text: impl Into<String>) -> Self {
        Self::new("text/css; charset=utf-8", text.into().into_bytes())
    }

    /// A value as JSON.
    pub fn json(value: &impl Serialize) -> Self {
        match serde_json::to_vec(value) {
            Ok(body) => Self::new("application/json", body),
            Err(_) => Self::refusal(500, "the answer has no form in JSON"),
        }
    }

    /// Numbers for a script to lay out.
    pub fn binary(bytes: Vec<u8>) -> Self {
        Self::new("application/octet-stream", bytes)
    }

    /// A status code and what is wrong, in words for a person.
    pub fn refusal(status: u16, text: impl Into<String>) -> Self {
        Self { status, ..Self::new("text/plain; charset=utf-8", text.into().into_bytes()) }
    }

    /// There is nothing of this name.
    pub fn not_found() -> Self {
        Self::refusal(404, "there is nothing here")
    }

    /// The same answer, and the server ends after it.
    pub fn and_end(self) -> Self {
        Self { is_last: true, ..self }
    }

    pub(super) fn is_last(&self) -> bool {
        self.is_last
    }

    pub(super) fn write(&self, mut stream: &TcpStream, has_body: bool) -> io::Result<()> {
        let reason = match self.status {
            200 => "OK",
            503 => "Service Unavailable",
            500.. => "Internal Server Error",
            _ => "Refused",
        };
        let head = format!(
            "HTTP/1.1 {} {reason}\r\nContent-Type: {}\r\nContent-Length: {}\r\nContent-Security-Policy: {POLICY}\r\n\
             Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\nCross-Origin-Resource-Policy: same-origin\r\n\
             Cross-Origin-Opener-Policy: same-origin\r\nReferrer-Policy: no-referrer\r\nConnection: close\r\n\r\n",
            self.status,
            self.content_type,
            self.body.len()
        );
        stream.write_all(head.as_bytes())?;
        if has_body {
            stream.write_all(&self.body)?;
        }
        stream.flush()
    }
}

impl From<Refusal> for Answer {
    fn from(refusal: Refusal) -> Self {
        let (status, text) = refusal.answer();
        Self::refusal(status, text)
    }
}
