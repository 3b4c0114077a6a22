//! The program `egotac_trainer` with an rclpy peer in the role of camera and truth, and a predictor that takes its checkpoints.

use std::path::PathBuf;

use crate::common::store::write_bright_store;
use crate::harness::{Running, Session};
use candle_core::{Device, Tensor};
use candle_nn::VarMap;
use egotac::hand::Topology;
use egotac::model::{Checkpoint, Config, EgoTac, Metadata, init};

const TRAINER: &str = env!("CARGO_BIN_EXE_egotac_trainer");
const PREDICTOR: &str = env!("CARGO_BIN_EXE_egotac_predictor");
const PEER: &str = "trainer_peer.py";

/// Writes a store in which the brightness of the image is proportional to force; returns its path.
fn store(session: &Session) -> PathBuf {
    let path = session.path("train.zarr");
    write_bright_store(&path, 60);
    path
}

/// Writes a configuration for a small network; returns its path.
fn config(session: &Session, data: &str, more: &str) -> String {
    let path = session.path("config.yaml");
    let text = format!(
        "name: node\ndata: [{data}]\nout: run\nmodel: toy\nseed: 1\nsteps: 150\nframe_dt: 0.04\n\
         optimizer: {{ learning_rate: 0.004, final_learning_rate: 0.0001 }}\nema: 0.9\nbatch: {{ clips: 3, windows: 8 }}\n{more}"
    );
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

fn trainer(session: &Session, more: &[&str]) -> Running {
    let folder = format!("folder:={}", session.path("trainer").display());
    session.node_on_one_thread(TRAINER, &[&["-p", &folder], more].concat())
}

#[test]
fn a_goal_sends_feedback_and_returns_a_checkpoint_with_scores() {
    let session = Session::new();
    let store = store(&session).display().to_string();
    let config = config(&session, &store, &format!("validation: [{store}]\n"));
    let mut node = trainer(&session, &[]);
    session.check(PEER, &["trains", &config, &session.path("run").display().to_string()]);
    node.ends_cleanly("INT");
}

#[test]
fn an_invalid_goal_is_rejected_with_the_reason() {
    let session = Session::new();
    let config = config(&session, &store(&session).display().to_string(), "");
    let mut node = trainer(&session, &[]);
    session.check(PEER, &["refuses", &config, &session.path("").display().to_string()]);
    node.ends_cleanly("TERM");
}

#[test]
fn a_cancelled_goal_resumes_and_a_signal_stops_a_training() {
    let session = Session::new();
    let config = config(&session, &store(&session).display().to_string(), "");
    let mut node = trainer(&session, &[]);
    session.check(PEER, &["cancels", &config, &session.path("run").display().to_string()]);
    node.ends_cleanly("INT");
}

#[test]
fn a_goal_is_aborted_with_a_result_and_its_state_is_saved_if_the_node_ends() {
    let session = Session::new();
    let store = store(&session).display().to_string();
    let config = config(&session, &store, &format!("validation: [{store}]\n"));
    let out = session.path("run").display().to_string();
    let mut node = trainer(&session, &[]);
    let mut peer = session.peer(PEER, &["ended", &config, &out]);
    peer.prints("training");
    // A terminal and a launch program each send a signal.
    node.signal("INT");
    std::thread::sleep(std::time::Duration::from_millis(120));
    node.signal("INT");
    let status = node.wait();
    assert_eq!(status.code(), Some(0), "{status}");
    let status = peer.wait();
    assert!(status.success(), "{status}\n{}", peer.output());
}

#[test]
fn lost_images_are_counted_and_the_memory_of_waiting_ones_is_bounded() {
    let session = Session::new();
    let mut node = trainer(&session, &["-p", "max_waiting_mb:=2.0"]);
    session.check(PEER, &["loses", &session.path("trainer").display().to_string()]);
    node.ends_cleanly("INT");
}

#[test]
fn live_frames_are_recorded_within_limits_while_rounds_train_on_them() {
    let session = Session::new();
    let config = config(&session, "none.zarr", "augment: { mirror: 0.0 }\n");
    let text = std::fs::read_to_string(&config).unwrap().replace("steps: 150", "steps: 120");
    std::fs::write(&config, text).unwrap();
    let live = [
        "-p",
        "max_recorded_mb:=0.05",
        "-p",
        "episode_secs:=1.0",
        "-p",
        "min_live_frames:=60",
        "-p",
        "round_steps:=40",
    ];
    let mut node = trainer(&session, &live);
    session.check(PEER, &["live", &config, &session.path("trainer").display().to_string()]);
    node.ends_cleanly("INT");
}

#[test]
fn a_predictor_takes_another_network_and_misses_no_image() {
    let session = Session::new();
    let first = session.checkpoint(&Config::toy());
    let save = |name: &str, topology: Topology| {
        let (path, vars) = (session.path(name), VarMap::new());
        EgoTac::new(&Config::toy(), init::var_builder(&vars, 7, &Device::Cpu)).unwrap();
        let metadata = Metadata { topology, ..Metadata::new("second", 1.0, 0.04) };
        Checkpoint::save(&path, &Config::toy(), &metadata, &vars).unwrap();
        path
    };
    let (second, other) = (save("second.safetensors", Topology::EgotacHand1), save("mano.safetensors", Topology::Mano));
    // One weight of the file is NaN.
    let spoilt = session.path("spoilt.safetensors");
    let mut bytes = std::fs::read(&second).unwrap();
    let end = bytes.len();
    bytes[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    std::fs::write(&spoilt, bytes).unwrap();
    let model = format!("model:={}", first.display());
    let mut node = session.node(PREDICTOR, &["-p", &model, "-p", "reliability:=reliable"]);
    let paths = [second, other, spoilt].map(|path| path.display().to_string());
    session.check(PEER, &["swaps", &paths[0], &paths[1], &paths[2]]);
    node.ends_cleanly("INT");
}

#[test]
fn live_training_improves_the_predictor() {
    let session = Session::new();
    let vars = VarMap::new();
    EgoTac::new(&Config::toy(), init::var_builder(&vars, 1, &Device::Cpu)).unwrap();
    for var in vars.all_vars() {
        var.set(&Tensor::randn(0f32, 0.05, var.shape(), &Device::Cpu).unwrap()).unwrap();
    }
    let first = session.path("first.safetensors");
    Checkpoint::save(&first, &Config::toy(), &Metadata::new("random", 1.0, 0.04), &vars).unwrap();
    let config =
        config(&session, "none.zarr", "augment: { mirror: 0.0, crop: 0.0, view_scale: 0.0 }\nloss: { active: 1.0 }\n");
    // Few steps with large changes, so that the test ends within a minute.
    let text = std::fs::read_to_string(&config).unwrap();
    let text = text.replace("steps: 150", "steps: 300").replace("{ learning_rate: 0.004", "{ learning_rate: 0.008");
    std::fs::write(&config, text).unwrap();
    let model = format!("model:={}", first.display());
    // The images of a recording so short do not tell which others are familiar.
    let options = ["-p", &model, "-p", "reliability:=reliable", "-p", "unknown:=guess"];
    let mut predictor = session.node(PREDICTOR, &options);
    let live = ["-p", "min_live_frames:=250", "-p", "round_steps:=150", "-p", "episode_secs:=2.0"];
    let notify = ["-p", "notify:=predictor/load_model"];
    let mut node = trainer(&session, &[&live[..], &notify].concat());
    session.check(PEER, &["improves", &config, &session.path("trainer").display().to_string()]);
    node.ends_cleanly("INT");
    predictor.ends_cleanly("INT");
}
