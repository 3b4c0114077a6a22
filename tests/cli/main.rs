//! Commands of `egotac` that belong to no other group.

#[path = "../common/mod.rs"]
mod common;

mod command_line;
mod completions;
mod doctor;
mod eval;
mod examples;
mod external;
mod limits;
mod reference;
mod terminal;
