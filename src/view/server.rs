//! The server of the page: files and descriptions by GET, moments by WebSocket on request.
//!
//! A page has one request under way; its answer is sent before the next request is read. A page that is slow, or gone, holds
//! back nobody, and the server keeps no queue for it. Nothing that a page sends changes anything.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::body::Bytes;
use axum::extract::ws::{Message, WebSocket, WebSocketUpgrade};
use axum::extract::{Path, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{self, Next};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use serde::Deserialize;
use serde_json::json;
use tokio::net::TcpListener;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::feed::{Answer, Feed};
use super::guard;
use super::page::{self, FILES};
use crate::error::{Error, Result};

/// Largest number of pages at a time.
const PAGES: usize = 16;
/// Size of a request, bytes: a few numbers.
const REQUEST: usize = 1024;
/// Memory that a page's answers may wait in, bytes: above the largest answer, an image of 8K.
const WAITING: usize = 64 << 20;
/// Time within which a page must take an answer.
const PATIENCE: Duration = Duration::from_secs(30);
/// Permissions of the page: nothing from elsewhere.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; \
                      frame-ancestors 'none'; base-uri 'none'; form-action 'none'";

/// Settings of the server.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Address and port; port 0 = any free one.
    pub listen: SocketAddr,
    /// Further names of this machine that requests may use.
    pub names: Vec<String>,
}

/// A server that listens.
pub struct Server {
    listener: TcpListener,
    state: Arc<Shared>,
}

struct Shared {
    feeds: Vec<Feed>,
    names: Vec<String>,
    pages: Arc<Semaphore>,
}

/// Request of a page: frame `frame` of a recording, or the next moment of a live source behind number `after`.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    source: usize,
    #[serde(default)]
    frame: usize,
    #[serde(default)]
    after: u64,
}

impl Server {
    /// Listens for pages of `feeds`.
    ///
    /// # Errors
    /// If the address is taken, or is none of this machine.
    pub async fn bind(settings: &Settings, feeds: Vec<Feed>) -> Result<Self> {
        let listener = TcpListener::bind(settings.listen).await.map_err(|error| {
            let reason = format!("{error}; choose another with --listen, such as --listen 127.0.0.1:0");
            Error::value("listen", "a free address of this machine", format!("{}: {reason}", settings.listen))
        })?;
        let pages = Arc::new(Semaphore::new(PAGES));
        Ok(Self { listener, state: Arc::new(Shared { feeds, names: settings.names.clone(), pages }) })
    }

    /// Returns the address of the page.
    ///
    /// # Errors
    /// If the operating system does not tell it.
    pub fn address(&self) -> Result<SocketAddr> {
        self.listener.local_addr().map_err(Error::io("listen"))
    }

    /// Serves pages for ever.
    ///
    /// # Errors
    /// If the operating system ends the listener.
    pub async fn run(self) -> Result<()> {
        let mut router = Router::new();
        for (path, media_type, text) in FILES {
            router = router.route(path, get(move || async move { ([(header::CONTENT_TYPE, media_type)], text) }));
        }
        let router = router
            .route("/about", get(async |State(shared): State<Arc<Shared>>| json_of(&page::about(&shared.feeds))))
            .route("/hands/{source}", get(hands))
            .route("/moments", get(moments))
            .layer(middleware::from_fn_with_state(Arc::clone(&self.state), guarded))
            .with_state(self.state);
        axum::serve(self.listener, router).await.map_err(Error::io("listen"))
    }
}

/// Refuses requests of other pages, and adds the headers that every answer has.
async fn guarded(State(shared): State<Arc<Shared>>, request: Request, next: Next) -> Response {
    let mut response = match guard::check(request.headers(), &shared.names) {
        Ok(()) => next.run(request).await,
        Err(reason) => (StatusCode::FORBIDDEN, format!("{reason}\n")).into_response(),
    };
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-store"));
    response
}

fn json_of(value: &serde_json::Value) -> Response {
    ([(header::CONTENT_TYPE, "application/json")], value.to_string()).into_response()
}

async fn hands(State(shared): State<Arc<Shared>>, Path(source): Path<usize>) -> Response {
    match shared.feeds.get(source) {
        Some(feed) => json_of(feed.hands()),
        None => (StatusCode::NOT_FOUND, "no such source\n").into_response(),
    }
}

async fn moments(State(shared): State<Arc<Shared>>, upgrade: WebSocketUpgrade) -> Response {
    let Ok(permit) = Arc::clone(&shared.pages).try_acquire_owned() else {
        return (StatusCode::SERVICE_UNAVAILABLE, format!("{PAGES} pages are open already\n")).into_response();
    };
    let upgrade = upgrade.max_message_size(REQUEST).max_frame_size(REQUEST).max_write_buffer_size(WAITING);
    upgrade.on_upgrade(move |socket| serve(socket, shared, permit))
}

/// Answers the requests of one page until it goes.
async fn serve(mut socket: WebSocket, shared: Arc<Shared>, _permit: OwnedSemaphorePermit) {
    let mut page = Page::default();
    let mut wanted: Option<Wanted> = None;
    loop {
        let answer = match wanted {
            None => match request(&mut socket).await {
                None => return,
                next => {
                    wanted = next;
                    continue;
                }
            },
            // A page that goes, or asks for something else meanwhile, ends the wait.
            Some(current) => tokio::select! {
                answer = page.answer(&shared, current) => answer,
                next = request(&mut socket) => match next {
                    None => return,
                    next => {
                        wanted = next;
                        continue;
                    }
                },
            },
        };
        wanted = None;
        let sent = tokio::time::timeout(PATIENCE, socket.send(answer)).await;
        if !matches!(sent, Ok(Ok(()))) {
            return;
        }
    }
}

/// Waits for a request of the page: None = the page has gone, or sends something else.
async fn request(socket: &mut WebSocket) -> Option<Wanted> {
    loop {
        match socket.recv().await?.ok()? {
            Message::Text(text) => return serde_json::from_str(&text).ok(),
            Message::Ping(_) | Message::Pong(_) => {}
            Message::Binary(_) | Message::Close(_) => return None,
        }
    }
}

/// State of one page.
#[derive(Debug, Default)]
struct Page {
    /// Source and number of the last moment of a live source.
    last: Option<(usize, u64)>,
    /// Number of moments of the live source that the page was too slow for.
    dropped: u32,
}

impl Page {
    async fn answer(&mut self, shared: &Shared, wanted: Wanted) -> Message {
        match shared.feeds.get(wanted.source) {
            None => told(&json!({ "failed": "there is no such source" })),
            Some(Feed::Recording(feed)) => match feed.packet(wanted.frame).await {
                Answer::Packet(packet) => self.packed(&packet),
                Answer::End => told(&json!({ "end": wanted.frame })),
                Answer::Failed(reason) => told(&json!({ "failed": reason })),
            },
            Some(Feed::Live(feed)) => match feed.next(wanted.after).await {
                Some((sequence, packet)) => {
                    self.count(wanted.source, sequence);
                    self.packed(&packet)
                }
                None => told(&json!({ "failed": "the source has ended" })),
            },
        }
    }

    /// Counts the moments of a live source between the last one and this one.
    fn count(&mut self, source: usize, sequence: u64) {
        match self.last.replace((source, sequence)) {
            Some((before, last)) if before == source => {
                let missed = u32::try_from(sequence.saturating_sub(last + 1)).unwrap_or(u32::MAX);
                self.dropped = self.dropped.saturating_add(missed);
            }
            _ => self.dropped = 0,
        }
    }

    /// Returns a packet behind the number of dropped moments (u32, little-endian).
    fn packed(&self, packet: &[u8]) -> Message {
        let mut bytes = Vec::with_capacity(4 + packet.len());
        bytes.extend(self.dropped.to_le_bytes());
        bytes.extend(packet);
        Message::Binary(Bytes::from(bytes))
    }
}

fn told(value: &serde_json::Value) -> Message {
    Message::Text(value.to_string().into())
}
