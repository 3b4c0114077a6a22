//! Metrics and verification.

#[path = "../common/mod.rs"]
mod common;

mod metrics;
#[cfg(feature = "sim")]
mod verify_cli;
#[cfg(feature = "sim")]
mod verify_unknown;
