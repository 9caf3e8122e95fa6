//! The server over real sockets.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::time::{Duration, Instant};

use super::{Answer, Limits, LocalServer, Method, Request};

const SMALL: Limits = Limits { head: 2048, body: 64, patience: Duration::from_secs(2), connections: 32 };

/// Answers with what it understood; posts of `end` end it and gets of `fault` fail.
fn echo(request: &Request) -> Answer {
    match (request.method, request.parts().as_slice()) {
        (Method::Get, []) => Answer::page("<p>hello</p>"),
        (Method::Get, ["fault"]) => panic!("a fault on purpose"),
        (Method::Get, ["numbers"]) => Answer::binary(vec![0, 1, 2, 255]),
        (Method::Get, parts) => Answer::json(&parts),
        (Method::Post, ["end"]) => Answer::json(&"ended").and_end(),
        (Method::Post, _) => Answer::json(&request.body),
    }
}

/// Ends the server also when a check fails, so that the test fails rather than waits.
struct Visit(u16);

impl Drop for Visit {
    fn drop(&mut self) {
        let port = self.0;
        let end = format!(
            "POST /end HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://127.0.0.1:{port}\r\n\
             Content-Type: application/json\r\nContent-Length: 2\r\n\r\n{{}}"
        );
        // While all places are taken, it has to be said again.
        for _ in 0..100 {
            let Ok(mut stream) = TcpStream::connect(("127.0.0.1", port)) else { return };
            let mut answer = String::new();
            let _ =
                stream.write_all(end.as_bytes()).and_then(|()| stream.read_to_string(&mut answer).map(drop));
            if answer.starts_with("HTTP/1.1 200") {
                return;
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

/// Runs a server for as long as `visit` takes.
fn with_server(limits: Limits, visit: impl FnOnce(u16)) {
    let server = LocalServer::with_limits(0, limits).expect("a free port");
    std::thread::scope(|scope| {
        let serving = scope.spawn(|| server.serve(&echo));
        let open = Visit(server.address.port());
        visit(open.0);
        drop(open);
        serving.join().expect("does not panic").expect("ends well");
    });
}

/// Sends bytes and returns all that comes back.
fn exchange(port: u16, bytes: &[u8]) -> String {
    let mut stream = TcpStream::connect(("127.0.0.1", port)).expect("connects");
    stream.write_all(bytes).expect("sends");
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).expect("answers");
    String::from_utf8_lossy(&answer).into_owned()
}

fn get(port: u16, target: &str) -> String {
    exchange(port, format!("GET {target} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n").as_bytes())
}

fn post_with(port: u16, target: &str, headers: &str, body: &str) -> String {
    let length = body.len();
    let text = format!(
        "POST {target} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Length: {length}\r\n{headers}\r\n{body}"
    );
    exchange(port, text.as_bytes())
}

fn post(port: u16, target: &str, body: &str) -> String {
    let headers = format!("Origin: http://127.0.0.1:{port}\r\nContent-Type: application/json\r\n");
    post_with(port, target, &headers, body)
}

fn body_of(answer: &str) -> &str {
    answer.split_once("\r\n\r\n").map_or("", |(_, body)| body)
}

#[track_caller]
fn expect_status(answer: &str, status: u16) {
    assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")), "{status} expected:\n{answer}");
}

#[test]
fn pages_values_and_numbers_are_served_with_headers_that_bind_the_browser() {
    with_server(Limits::default(), |port| {
        let page = get(port, "/");
        expect_status(&page, 200);
        assert_eq!(body_of(&page), "<p>hello</p>");
        for header in [
            "Content-Type: text/html; charset=utf-8",
            "Content-Length: 12",
            "script-src 'self'",
            "frame-ancestors 'none'",
            "X-Content-Type-Options: nosniff",
            "Cross-Origin-Resource-Policy: same-origin",
        ] {
            assert!(page.contains(header), "{header} is missing:\n{page}");
        }
        assert!(!page.to_lowercase().contains("access-control-allow"), "no other site may read: {page}");
        let value = get(port, "/a%20b/%C3%A9%3F+%26");
        assert_eq!(body_of(&value), r#"["a b","é?+&"]"#);
        assert!(get(port, "/numbers").contains("Content-Length: 4"));
        let head = exchange(port, format!("HEAD / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n").as_bytes());
        assert!(head.contains("Content-Length: 12") && body_of(&head).is_empty(), "{head}");
        assert_eq!(body_of(&post(port, "/note", "{\"é\":1}")), r#""{\"é\":1}""#);
    });
}

#[test]
fn only_its_own_address_is_a_host() {
    with_server(Limits::default(), |port| {
        for host in [
            "evil.example".to_string(),
            format!("evil.example:{port}"),
            "127.0.0.1".to_string(),
            "127.0.0.1:1".to_string(),
            format!("127.0.0.1:{port}.evil.example"),
            format!("evil.example@127.0.0.1:{port}"),
            format!("[::1]:{port}"),
        ] {
            let answer = exchange(port, format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes());
            expect_status(&answer, 421);
            assert!(!answer.contains("hello"));
        }
        expect_status(&exchange(port, b"GET / HTTP/1.1\r\n\r\n"), 400);
        let two = format!("GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nHost: evil.example\r\n\r\n");
        expect_status(&exchange(port, two.as_bytes()), 400);
        let absolute = format!("GET http://evil.example/ HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n");
        expect_status(&exchange(port, absolute.as_bytes()), 400);
    });
}

#[test]
fn posts_come_from_its_own_pages_only() {
    with_server(Limits::default(), |port| {
        let json = "Content-Type: application/json\r\n";
        for origin in ["http://evil.example", "null", "https://127.0.0.1", "http://127.0.0.1"] {
            let headers = format!("Origin: {origin}\r\n{json}");
            expect_status(&post_with(port, "/end", &headers, "{}"), 403);
        }
        let other_port = format!("Origin: http://127.0.0.1:{}\r\n{json}", port ^ 1);
        expect_status(&post_with(port, "/end", &other_port, "{}"), 403);
        expect_status(&post_with(port, "/end", json, "{}"), 403);
        let own = format!("Origin: http://localhost:{port}\r\n");
        for kind in
            ["", "Content-Type: text/plain\r\n", "Content-Type: application/x-www-form-urlencoded\r\n"]
        {
            expect_status(&post_with(port, "/end", &format!("{own}{kind}"), "{}"), 415);
        }
        let across = format!("{own}{json}Sec-Fetch-Site: cross-site\r\n");
        expect_status(&post_with(port, "/end", &across, "{}"), 403);
        let spying = format!("GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nSec-Fetch-Site: same-site\r\n\r\n");
        expect_status(&exchange(port, spying.as_bytes()), 403);
        // What a browser sends before it lets another site post: no permission comes back.
        let asking =
            format!("OPTIONS /end HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nOrigin: http://evil.example\r\n\r\n");
        let answer = exchange(port, asking.as_bytes());
        assert!(!answer.starts_with("HTTP/1.1 200") && !answer.to_lowercase().contains("access-control"));
        expect_status(&post_with(port, "/note", &format!("{own}{json}"), "{}"), 200);
    });
}

#[test]
fn no_path_leads_out_of_what_is_served() {
    with_server(Limits::default(), |port| {
        for target in [
            "/..",
            "/../secret",
            "/a/../../secret",
            "/%2e%2e/secret",
            "/%2E%2e%2fsecret",
            "/a%2fb",
            "/a%5cb",
            "/a\\b",
            "/a//b",
            "/./a",
            "/a%00b",
            "/a%0d%0ab",
            "/%",
            "/%4",
            "/%zz",
            "/%ff",
            "/a?b=c",
            "secret",
            "*",
        ] {
            expect_status(&get(port, target), 400);
        }
        // What was decoded once stays as it is.
        assert_eq!(body_of(&get(port, "/%252e%252e")), r#"["%2e%2e"]"#);
    });
}

#[test]
fn long_slow_and_odd_requests_are_refused_and_the_next_is_answered() {
    with_server(SMALL, |port| {
        let own = format!("Host: 127.0.0.1:{port}\r\n");
        expect_status(&get(port, &format!("/{}", "x".repeat(4000))), 431);
        let long = format!("GET / HTTP/1.1\r\n{own}X: {}\r\n\r\n", "y".repeat(4000));
        expect_status(&exchange(port, long.as_bytes()), 431);
        let many = format!("GET / HTTP/1.1\r\n{own}{}\r\n", "a: b\r\n".repeat(100));
        expect_status(&exchange(port, many.as_bytes()), 431);
        expect_status(&post(port, "/note", &"z".repeat(65)), 413);
        expect_status(&post(port, "/note", &"z".repeat(64)), 200);
        let from_page = format!("{own}Origin: http://127.0.0.1:{port}\r\nContent-Type: application/json\r\n");
        for (headers, status) in [
            ("Content-Length: 99999999999999999999999999\r\n", 413),
            ("Content-Length: -1\r\n", 400),
            ("Content-Length: 1\r\nContent-Length: 2\r\n", 400),
            ("Transfer-Encoding: chunked\r\n", 501),
            ("", 411),
        ] {
            let text = format!("POST /note HTTP/1.1\r\n{from_page}{headers}\r\n");
            expect_status(&exchange(port, text.as_bytes()), status);
        }
        // More than was announced, fewer than was announced, not UTF-8, not HTTP.
        let two = format!("POST /note HTTP/1.1\r\n{from_page}Content-Length: 1\r\n\r\n12");
        expect_status(&exchange(port, two.as_bytes()), 400);
        let few = format!("POST /note HTTP/1.1\r\n{from_page}Content-Length: 9\r\n\r\n12");
        expect_status(&exchange(port, few.as_bytes()), 408);
        let mut bytes = format!("POST /note HTTP/1.1\r\n{from_page}Content-Length: 1\r\n\r\n").into_bytes();
        bytes.push(0xff);
        expect_status(&exchange(port, &bytes), 415);
        expect_status(&exchange(port, b"\x16\x03\x01\x00\xa5\x01\x00\x00"), 400);
        expect_status(&exchange(port, format!("DELETE / HTTP/1.1\r\n{own}\r\n").as_bytes()), 405);
        expect_status(&get(port, "/fault"), 500);
        expect_status(&get(port, "/"), 200);
    });
}

#[test]
fn a_sender_that_dawdles_is_given_up_and_does_not_hold_the_others() {
    with_server(SMALL, |port| {
        let start = Instant::now();
        let mut slow = TcpStream::connect(("127.0.0.1", port)).expect("connects");
        slow.write_all(b"GET / HT").expect("sends");
        expect_status(&get(port, "/"), 200);
        let mut answer = String::new();
        slow.read_to_string(&mut answer).expect("is told");
        expect_status(&answer, 408);
        // It waits as long as it says, and not until the sender ends.
        assert!(start.elapsed() >= SMALL.patience);
        let mut gone = TcpStream::connect(("127.0.0.1", port)).expect("connects");
        gone.write_all(b"GET / HT").expect("sends");
        gone.shutdown(Shutdown::Both).expect("goes away");
        expect_status(&get(port, "/"), 200);
    });
}

#[test]
fn more_connections_than_allowed_are_told_to_come_again() {
    with_server(Limits { connections: 3, ..Limits::default() }, |port| {
        let idle: Vec<TcpStream> =
            (0..3).map(|_| TcpStream::connect(("127.0.0.1", port)).expect("connects")).collect();
        // Connections are taken in their order, so the three idle ones hold all places.
        expect_status(&get(port, "/"), 503);
        drop(idle);
        let deadline = Instant::now() + Duration::from_secs(20);
        while !get(port, "/").starts_with("HTTP/1.1 200") {
            assert!(Instant::now() < deadline, "places are not given back");
            std::thread::sleep(Duration::from_millis(20));
        }
    });
}

#[test]
fn it_listens_on_127_0_0_1_alone_and_says_when_a_port_is_taken() {
    let server = LocalServer::bind(0).expect("a free port");
    assert!(server.address.ip().is_loopback());
    assert_eq!(server.address(), format!("http://127.0.0.1:{}/", server.address.port()));
    let message = LocalServer::bind(server.address.port()).expect_err("is taken").to_string();
    assert!(message.contains("--port"), "{message}");
}
