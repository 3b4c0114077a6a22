//! The short form of `egotac bench node`: everything but times and the growth of memory, which need a longer run.
#![cfg(all(feature = "ros", feature = "sim"))]

use std::path::Path;

use egotac_bench::node::{Options, measure};

fn short(only: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        programs: Path::new(env!("CARGO_BIN_EXE_egotac-bench")).parent().unwrap().to_path_buf(),
        python: std::env::var_os("EGOTAC_PYTHON").expect("EGOTAC_PYTHON is not set: source env.sh first").into(),
        folder: folder.path().to_path_buf(),
        only: only.iter().map(|name| (*name).to_owned()).collect(),
        secs: 4.0,
        soak_secs: 20.0,
    };
    let report = measure(&options, "test".into(), |_| ()).unwrap();
    assert_eq!(report.measurements.len(), only.len());
    let missed: Vec<_> =
        report.goals.iter().filter(|goal| !goal.met && !goal.is_time && !goal.what.starts_with("growth")).collect();
    assert!(!report.goals.is_empty() && missed.is_empty(), "{missed:#?}\n{}", report.markdown());
}

#[test]
fn nodes_survive_faulty_publishers_and_messages_and_tell() {
    short(&["faults"]);
}

#[test]
fn the_graph_goes_on_after_a_node_is_killed_and_no_recorded_frame_is_lost() {
    short(&["kills"]);
}

#[test]
fn every_image_is_counted_under_overload_and_over_time() {
    short(&["overload", "soak"]);
}
