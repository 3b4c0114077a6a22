//! A running `egotac view`, and a page's side of its connection.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use tungstenite::client::IntoClientRequest;
use tungstenite::{Message, WebSocket};

/// Time after which an answer counts as missing; no measure of speed.
const HUNG: Duration = Duration::from_secs(60);

/// A running `egotac view`, which ends with this value.
pub struct View {
    child: Child,
    pub address: String,
}

impl View {
    /// Starts `egotac view` with these arguments on a free port.
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_with(arguments, None)
    }

    /// As [`Self::start`], with another search path of programs.
    pub fn start_with(arguments: &[&str], path: Option<&str>) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_egotac"));
        command.arg("view").args(arguments).args(["--listen", "127.0.0.1:0"]).stdout(Stdio::piped());
        if let Some(path) = path {
            command.env("PATH", path);
        }
        let mut child = command.spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let address = line.trim().strip_prefix("http://").and_then(|rest| rest.strip_suffix('/'));
        let address = address.unwrap_or_else(|| panic!("{arguments:?}: {line:?}")).to_owned();
        Self { child, address }
    }

    /// Sends a request and returns status and body of the answer.
    pub fn http(&self, method: &str, path: &str, host: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(HUNG)).unwrap();
        write!(stream, "{method} {path} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n")
            .unwrap();
        let mut answer = String::new();
        stream.read_to_string(&mut answer).unwrap();
        let status = answer.split(' ').nth(1).unwrap().parse().unwrap();
        (status, answer.split_once("\r\n\r\n").unwrap_or_default().1.to_owned())
    }

    /// Opens a page's connection; `origin` is the page that asks.
    pub fn page(&self, origin: Option<&str>) -> Result<Page, tungstenite::Error> {
        Page::open(&self.address, origin)
    }

    /// Largest memory of the program so far, kB.
    pub fn peak_kb(&self) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).unwrap();
        line.trim().trim_end_matches(" kB").parse().unwrap()
    }
}

impl Drop for View {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A page's connection.
pub struct Page(WebSocket<TcpStream>);

impl Page {
    /// Opens a connection to the server at `address`; `origin` is the page that asks.
    pub fn open(address: &str, origin: Option<&str>) -> Result<Self, tungstenite::Error> {
        let mut request = format!("ws://{address}/moments").into_client_request()?;
        if let Some(origin) = origin {
            request.headers_mut().insert("Origin", origin.parse().unwrap());
        }
        let stream = TcpStream::connect(address).unwrap();
        stream.set_read_timeout(Some(HUNG)).unwrap();
        match tungstenite::client(request, stream) {
            Ok((socket, _)) => Ok(Self(socket)),
            Err(tungstenite::HandshakeError::Failure(error)) => Err(error),
            Err(tungstenite::HandshakeError::Interrupted(_)) => panic!("the handshake was interrupted"),
        }
    }

    pub fn send(&mut self, request: &str) {
        self.0.send(Message::text(request)).unwrap();
    }

    /// Sends a request and decodes the answer.
    pub fn ask(&mut self, request: &str) -> Answer {
        self.send(request);
        loop {
            match self.0.read().unwrap() {
                Message::Binary(bytes) => return Answer::decode(&bytes),
                Message::Text(text) => {
                    return Answer { head: serde_json::from_str(&text).unwrap(), ..Answer::default() };
                }
                _ => {}
            }
        }
    }
}

/// A decoded answer.
#[derive(Default)]
pub struct Answer {
    pub dropped: u32,
    pub head: Value,
    pub arrays: std::collections::BTreeMap<String, Vec<f32>>,
    pub jpeg: Vec<u8>,
}

impl Answer {
    fn decode(bytes: &[u8]) -> Self {
        let number = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let (dropped, length) = (number(0), number(4) as usize);
        let head: Value = serde_json::from_slice(&bytes[8..8 + length]).unwrap();
        let (mut at, mut arrays) = (8 + length, std::collections::BTreeMap::new());
        for array in head["arrays"].as_array().unwrap() {
            let end = at + 4 * array[1].as_u64().unwrap() as usize;
            let values = bytes[at..end].chunks_exact(4).map(|value| f32::from_le_bytes(value.try_into().unwrap()));
            arrays.insert(array[0].as_str().unwrap().to_owned(), values.collect());
            at = end;
        }
        Self { dropped, head, arrays, jpeg: bytes[at..].to_vec() }
    }
}
