//! `egotac label` and the agreement of labels.

#[path = "../common/mod.rs"]
mod common;

mod agreement;
mod bag_cli;
mod identity;
mod lerobot_cli;
mod lerobot_policy;
mod store_cli;
mod unknown_cli;
mod video_cli;
mod view_cli;
