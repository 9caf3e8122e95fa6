//! A web server for this program's own pages and for the person at this machine alone.
//!
//! It listens on 127.0.0.1. It answers only requests that name that address as their `Host`, since a stranger's page whose
//! name was made to resolve to 127.0.0.1 (DNS rebinding) carries its own name there, and takes posts only from its own
//! pages (`Origin`). It opens no file: the caller answers a path with bytes, so that nothing else can be asked for. What
//! it reads is bounded in size and time. Each connection carries one request.

mod answer;
mod request;
#[cfg(test)]
mod tests;

use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use anyhow::Context;

pub use answer::Answer;
pub use request::{Method, Request};

/// What a request may cost.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    /// Bytes of the request line and all headers.
    pub head: usize,
    /// Bytes of a post's body.
    pub body: usize,
    /// Time for all of a request to arrive, and for its answer to be taken.
    pub patience: Duration,
    /// Connections that are answered at the same time; more are told to come again.
    pub connections: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { head: 16 << 10, body: 1 << 20, patience: Duration::from_secs(10), connections: 32 }
    }
}

/// A server that has its port and waits to serve.
#[derive(Debug)]
pub struct LocalServer {
    listener: TcpListener,
    address: SocketAddr,
    limits: Limits,
}

impl LocalServer {
    /// Takes a port of 127.0.0.1; port 0 is any free one.
    pub fn bind(port: u16) -> anyhow::Result<Self> {
        Self::with_limits(port, Limits::default())
    }

    /// The same with other limits.
    pub fn with_limits(port: u16, limits: Limits) -> anyhow::Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port))
            .with_context(|| format!("port {port} of 127.0.0.1 cannot be used; name another with --port"))?;
        let address = listener.local_addr().context("the port has no address")?;
        Ok(Self { listener, address, limits })
    }

    /// Where its pages are.
    pub fn address(&self) -> String {
        format!("http://{}/", self.address)
    }

    /// Answers requests, some at the same time, until an answer is the last one (see [`Answer::and_end`]).
    pub fn serve(&self, answer: &(dyn Fn(&Request) -> Answer + Sync)) -> anyhow::Result<()> {
        let is_ended = AtomicBool::new(false);
        let connections = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for stream in self.listener.incoming() {
                if is_ended.load(Ordering::SeqCst) {
                    break;
                }
                // A connection that broke before it was taken concerns nobody else.
                let Ok(stream) = stream else { continue };
                if connections.fetch_add(1, Ordering::SeqCst) >= self.limits.connections {
                    self.send(
                        &stream,
                        &Answer::refusal(503, "too many requests at the same time; try again"),
                        true,
                    );
                    connections.fetch_sub(1, Ordering::SeqCst);
                    continue;
                }
                let (is_ended, connections) = (&is_ended, &connections);
                let talk = move || {
                    if self.talk(&stream, answer) {
                        is_ended.store(true, Ordering::SeqCst);
                        // The loop waits for a connection: this one wakes it.
                        let _ = TcpStream::connect(self.address);
                    }
                    connections.fetch_sub(1, Ordering::SeqCst);
                };
                if std::thread::Builder::new().spawn_scoped(scope, talk).is_err() {
                    connections.fetch_sub(1, Ordering::SeqCst);
                }
            }
        });
        Ok(())
    }

    /// One request and its answer; whether it was the last.
    fn talk(&self, stream: &TcpStream, answer: &(dyn Fn(&Request) -> Answer + Sync)) -> bool {
        let request = match request::read(stream, &self.limits, self.address.port()) {
            Ok(request) => request,
            // Nothing was asked: browsers open connections ahead of need.
            Err(request::Refusal::Silence) => return false,
            Err(refusal) => {
                self.send(stream, &refusal.into(), true);
                return false;
            }
        };
        // A fault in one answer must not end the work of a person on all others.
        let answer = catch_unwind(AssertUnwindSafe(|| answer(&request)))
            .unwrap_or_else(|_| Answer::refusal(500, "a fault of this program; see the terminal"));
        self.send(stream, &answer, request.wants_body);
        answer.is_last()
    }

    /// Sends an answer. A reader that went away is no error.
    fn send(&self, stream: &TcpStream, answer: &Answer, has_body: bool) {
        let _ = stream.set_write_timeout(Some(self.limits.patience));
        if answer.write(stream, has_body).is_ok() && stream.shutdown(Shutdown::Write).is_ok() {
            // Closing with unread bytes would reset the connection and take the answer away.
            request::discard_rest(stream, &self.limits);
        }
    }
}
