//! Runs simulator, predictor and verifier as nodes, and records their topics.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use tokio::signal::unix::{SignalKind, signal};

use super::children::NodeProcess;
use super::{Args, report, topics};
use crate::message::{CameraInfo, HandModelInfo, HandPose, Image, TactileFrame, TactileMetrics, TactileTruth};
use crate::node::bag_recorder::{BagRecorder, RecordedTopic};

/// Frames per simulated second.
const FPS: f64 = 25.0;
/// Time in which ROS discovery finds running nodes.
const DISCOVERY: Duration = Duration::from_millis(1000);
/// Time limit for the start and the end of a node.
const NODE_TIMEOUT: Duration = Duration::from_secs(60);
/// Time for the prediction and the metrics of the last image to arrive.
const RESULT_DELAY: Duration = Duration::from_millis(1500);

/// Runs the demo and writes its report.
///
/// # Errors
/// If a node can't be started or fails, or the report can't be written.
pub fn run(args: &Args) -> Result<ExitCode> {
    if args.duration.0 < 1.0 {
        bail!("--duration: expected at least 1 second, got {}", args.duration);
    }
    let out = fresh_folder(&args.out)?;
    let recorder = BagRecorder::start(&out.join("bag"), recorded_topics()).context("recorder")?;
    let verifier_report = out.join("verifier.json");
    let nodes = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    nodes.block_on(async {
        refuse_other_publishers(&recorder).await?;
        // On a signal the future of `simulate` is dropped, which kills the nodes.
        let mut terminate = signal(SignalKind::terminate())?;
        tokio::select! {
            result = simulate(args, &out, &recorder, &verifier_report) => result,
            _ = terminate.recv() => bail!("ended by SIGTERM"),
            interrupted = tokio::signal::ctrl_c() => { interrupted?; bail!("interrupted") }
        }
    })?;
    let bag = recorder.finish().context("recorder")?;
    report::write(args, &out, &bag, &verifier_report)?;
    Ok(ExitCode::SUCCESS)
}

/// Creates a directory, or removes the files of an earlier demo from it; other files stay.
fn fresh_folder(path: &Path) -> Result<PathBuf> {
    const OURS: [&str; 8] = [
        "bag",
        "verifier.json",
        "demo.json",
        "metrics.md",
        "demo.png",
        "predictor.log",
        "simulator.log",
        "verifier.log",
    ];
    std::fs::create_dir_all(path).with_context(|| path.display().to_string())?;
    for name in OURS {
        let old = path.join(name);
        let removed = if old.is_dir() { std::fs::remove_dir_all(&old) } else { std::fs::remove_file(&old) };
        match removed {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                return Err(error).with_context(|| old.display().to_string());
            }
            _ => {}
        }
    }
    path.canonicalize().with_context(|| path.display().to_string())
}

/// Returns the topics of the recording.
fn recorded_topics() -> Vec<RecordedTopic> {
    vec![
        RecordedTopic::of::<Image>(topics::IMAGE),
        RecordedTopic::of::<CameraInfo>(topics::CAMERA_INFO),
        RecordedTopic::of::<TactileTruth>(topics::TRUTH),
        RecordedTopic::of::<HandPose>(topics::HAND_POSE),
        RecordedTopic::of::<TactileFrame>(topics::TACTILE),
        RecordedTopic::of::<HandModelInfo>(topics::MODEL_INFO).latched(),
        RecordedTopic::of::<TactileMetrics>(topics::METRICS),
    ]
}

/// Fails if a running node already publishes one of the demo's topics.
async fn refuse_other_publishers(recorder: &BagRecorder) -> Result<()> {
    tokio::time::sleep(DISCOVERY).await;
    if let Some(topic) = recorder.published().into_iter().next() {
        bail!("another node already publishes {topic}: stop it, or set another ROS_DOMAIN_ID");
    }
    Ok(())
}

/// Runs the three nodes until the simulator has published all its images.
async fn simulate(args: &Args, out: &Path, recorder: &BagRecorder, verifier_report: &Path) -> Result<()> {
    let mut predictor = NodeProcess::start("predictor", &predictor_arguments(args), out)?;
    let mut verifier = NodeProcess::start("verifier", &verifier_arguments(verifier_report), out)?;
    tokio::select! {
        ready = network_is_ready(recorder) => ready.with_context(|| out.join("predictor.log").display().to_string())?,
        end = predictor.ended() => end.and_then(|()| bail!("the predictor ended before the simulation began"))?,
        end = verifier.ended() => end.and_then(|()| bail!("the verifier ended before the simulation began"))?,
    }

    let mut simulator = NodeProcess::start("simulator", &simulator_arguments(args), out)?;
    tokio::select! {
        end = simulator.ended() => end?,
        end = predictor.ended() => end.and_then(|()| bail!("the predictor ended during the simulation"))?,
        end = verifier.ended() => end.and_then(|()| bail!("the verifier ended during the simulation"))?,
        () = show_progress(recorder, (args.duration.0 * FPS).round() as u64) => bail!("the recording failed"),
    }
    tokio::time::sleep(RESULT_DELAY).await;
    println!();
    predictor.stop(NODE_TIMEOUT).await?;
    verifier.stop(NODE_TIMEOUT).await
}

/// Waits until the predictor has published its model info.
async fn network_is_ready(recorder: &BagRecorder) -> Result<()> {
    let waiting = crate::cli::progress::spinner("loading the network");
    let deadline = Instant::now() + NODE_TIMEOUT;
    while recorder.count(topics::MODEL_INFO) == 0 {
        ensure!(Instant::now() < deadline, "no message on {} within {NODE_TIMEOUT:?}", topics::MODEL_INFO);
        waiting.tick();
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
    waiting.finish_and_clear();
    Ok(())
}

/// Shows the progress of the run; returns only if the recording fails.
async fn show_progress(recorder: &BagRecorder, images: u64) {
    let progress = crate::cli::progress::told_bar("images");
    progress.set_length(images);
    while !recorder.has_failed() {
        progress.set_position(recorder.count(topics::TRUTH));
        progress.set_message(format!("{} predictions", recorder.count(topics::TACTILE)));
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
}

fn predictor_arguments(args: &Args) -> Vec<String> {
    let mut parameters = vec![];
    if let Some(checkpoint) = &args.checkpoint {
        parameters.push(format!("model:={}", checkpoint.display()));
    }
    ros_arguments(&[("image", topics::IMAGE), ("hand_pose", topics::HAND_POSE)], &parameters)
}

fn verifier_arguments(report: &Path) -> Vec<String> {
    ros_arguments(&[("tactile", topics::TACTILE), ("truth", topics::TRUTH)], &[format!("report:={}", report.display())])
}

fn simulator_arguments(args: &Args) -> Vec<String> {
    let scenes = args.scenes.iter().map(|scene| format!("{scene:?}")).collect::<Vec<_>>().join(", ");
    let parameters = [
        format!("scenes:=[{scenes}]"),
        format!("seed:={}", args.seed),
        format!("duration:={:?}", args.duration.0),
        format!("wait_secs:={:?}", NODE_TIMEOUT.as_secs_f64()),
        // The predictor and the recorder subscribe to the images.
        "wait_listeners:=2".to_owned(),
    ];
    ros_arguments(&[], &parameters)
}

fn ros_arguments(remappings: &[(&str, &str)], parameters: &[String]) -> Vec<String> {
    let mut arguments = vec!["--ros-args".to_owned()];
    for (from, to) in remappings {
        arguments.extend(["-r".to_owned(), format!("{from}:={to}")]);
    }
    for parameter in parameters {
        arguments.extend(["-p".to_owned(), parameter.clone()]);
    }
    arguments
}
