//! The program itself over a real socket: start, submit in chunks, stop.

use super::harness::{Directory, study};
use std::{
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

struct Program {
    child: Child,
    address: String,
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn ventricle() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_ventricle"));
    command.env_remove("VENTRICLE_LISTEN").env_remove("VENTRICLE_DATABASE_URL").stdin(Stdio::null());
    command
}

fn start(directory: &Directory) -> Program {
    let mut child = ventricle()
        .args(["serve", "--listen", "127.0.0.1:0", "--log", "warn", "--data-dir"])
        .arg(&directory.0)
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    let address = line.trim().rsplit("http://").next().unwrap().to_owned();
    assert!(address.starts_with("127.0.0.1:") && !address.ends_with(":0"), "{line}");
    Program { child, address }
}

/// Sends raw bytes and reads to the end.
fn exchange(address: &str, request: &[u8]) -> String {
    let mut stream = TcpStream::connect(address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
    stream.write_all(request).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    String::from_utf8_lossy(&answer).into_owned()
}

#[test]
fn the_program_serves_and_stops_in_order() {
    let directory = Directory::new();
    let mut program = start(&directory);
    let url = format!("http://{}", program.address);
    let health = ventricle().args(["healthcheck", "--url", &url]).output().unwrap();
    assert!(health.status.success(), "{health:?}");

    let body = study(0).to_string();
    let head = "POST /v1/reconstructions HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nContent-Type: application/json\r\n\
                Transfer-Encoding: chunked\r\n\r\n";
    let chunks: Vec<String> =
        body.as_bytes().chunks(1000).map(|chunk| format!("{:x}\r\n{}\r\n", chunk.len(), std::str::from_utf8(chunk).unwrap())).collect();
    let chunks = chunks.concat();
    let answer = exchange(&program.address, format!("{head}{chunks}0\r\n\r\n").as_bytes());
    assert!(answer.starts_with("HTTP/1.1 202"), "{answer}");
    assert!(answer.to_lowercase().contains("location: /v1/reconstructions/"), "{answer}");

    let head = "HEAD /v1/parameters HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let answer = exchange(&program.address, head.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 200") && answer.ends_with("\r\n\r\n"), "{answer}");
    assert!(answer.to_lowercase().contains("content-length: "), "{answer}");

    // Another machine's name that leads here for the moment, and another site's page: nobody is asked who he is, so they are.
    let ask = |method: &str, headers: &str| {
        exchange(&program.address, format!("{method} /v1/reconstructions HTTP/1.1\r\nConnection: close\r\n{headers}\r\n").as_bytes())
    };
    let rebound = ask("GET", "Host: rebound.example:8080\r\n");
    assert!(rebound.starts_with("HTTP/1.1 403") && rebound.contains("host_not_allowed") && rebound.contains("--allowed-host"), "{rebound}");
    assert!(ask("GET", "Host: localhost:8080\r\n").starts_with("HTTP/1.1 200"));
    let of_page = ask("POST", "Host: localhost:8080\r\nOrigin: https://page.example\r\nContent-Type: text/plain\r\nContent-Length: 0\r\n");
    assert!(of_page.starts_with("HTTP/1.1 403") && of_page.contains("cross_site_request"), "{of_page}");

    // Announced too large: refused before the body is sent.
    let head = "POST /v1/reconstructions HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\nExpect: 100-continue\r\nContent-Length: 999999999\r\n\r\n";
    let answer = exchange(&program.address, head.as_bytes());
    assert!(answer.starts_with("HTTP/1.1 413") && answer.contains("too_large"), "{answer}");

    let pid = rustix::process::Pid::from_raw(program.child.id().cast_signed()).unwrap();
    rustix::process::kill_process(pid, rustix::process::Signal::TERM).unwrap();
    let began = Instant::now();
    let status = loop {
        if let Some(status) = program.child.try_wait().unwrap() {
            break status;
        }
        assert!(began.elapsed() < Duration::from_secs(40), "the program does not stop");
        std::thread::sleep(Duration::from_millis(20));
    };
    assert_eq!(status.code(), Some(0));
    let health = ventricle().args(["healthcheck", "--url", &url]).output().unwrap();
    assert!(!health.status.success(), "nothing answers any more");
}

#[test]
fn an_open_address_is_refused_with_the_reason() {
    let output = ventricle().args(["serve", "--listen", "0.0.0.0:0"]).output().unwrap();
    assert!(!output.status.success());
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("not a loopback address") && said.contains("--insecure-no-auth"), "{said}");
}
