//! `egotac view` and the videos of `egotac label`.

#[path = "../common/mod.rs"]
mod common;

mod client;
mod live;
mod pages;
mod recording;
mod scene;
mod video;
