//! A verb that serves a page, and requests to it without a browser.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, ExitStatus, Stdio};

/// A running verb.
pub struct Served {
    child: Child,
    /// The address that it printed.
    pub address: String,
}

/// The built command.
pub fn habitus() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_habitus"));
    command.env("COLUMNS", "100").env_remove("RUST_BACKTRACE");
    command
}

impl Served {
    /// Starts a verb and waits for its address.
    pub fn start(command: &mut Command) -> Self {
        let mut child =
            command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().expect("the command starts");
        let mut address = String::new();
        let output = child.stdout.take().expect("is piped");
        BufReader::new(output).read_line(&mut address).expect("an address");
        Self { child, address: address.trim().to_string() }
    }

    /// `127.0.0.1:PORT`.
    pub fn host(&self) -> &str {
        self.address.trim_start_matches("http://").trim_end_matches('/')
    }

    fn exchange(&self, text: &str) -> (u16, Vec<u8>) {
        let mut stream = TcpStream::connect(self.host()).expect("connects");
        stream.write_all(text.as_bytes()).expect("sends");
        let mut answer = Vec::new();
        stream.read_to_end(&mut answer).expect("answers");
        let end = answer.windows(4).position(|window| window == b"\r\n\r\n").expect("a head");
        let head = String::from_utf8_lossy(&answer[..end]).into_owned();
        let status = head.split(' ').nth(1).and_then(|code| code.parse().ok()).expect("a status");
        (status, answer[end + 4..].to_vec())
    }

    /// Status and body.
    pub fn get(&self, path: &str) -> (u16, Vec<u8>) {
        self.exchange(&format!("GET {path} HTTP/1.1\r\nHost: {}\r\n\r\n", self.host()))
    }

    /// Status and body of a post from this or another site.
    pub fn post(&self, path: &str, origin: &str, body: &str) -> (u16, String) {
        let (host, length) = (self.host(), body.len());
        let (status, body) = self.exchange(&format!(
            "POST {path} HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nContent-Type: application/json\r\n\
             Content-Length: {length}\r\n\r\n{body}"
        ));
        (status, String::from_utf8_lossy(&body).into_owned())
    }

    /// Where its own pages come from.
    pub fn origin(&self) -> String {
        format!("http://{}", self.host())
    }

    /// What Ctrl-C does.
    pub fn interrupt(&mut self) -> ExitStatus {
        let id = self.child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &id]).status().expect("kill is there").success());
        self.child.wait().expect("ends")
    }

    /// Waits for its own end.
    pub fn ended(&mut self) -> ExitStatus {
        self.child.wait().expect("ends")
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
