//! Time of the network and of a training step on a GPU, beside PyTorch.

use std::process::Command;

use egotac::error::Result;
use egotac::machine::Machine;
use egotac::model::{Config, Precision};
use egotac::text::put;
use serde::{Deserialize, Serialize};

use crate::model::peer::{Timing, least};
use crate::model::{Setup, measure};
use crate::peer;
use crate::train::{self, Form, Timed};

/// Configurations to measure.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The command that measures the same again.
    pub command: String,
    /// Presets, with random weights.
    pub presets: Vec<String>,
    /// Number formats.
    pub precisions: Vec<Precision>,
    /// Windows of a training step.
    pub windows: Vec<usize>,
    /// Timed runs of each kind.
    pub runs: usize,
    /// Index of the CUDA device.
    pub cuda: usize,
    /// Command of a peer.
    pub peer: Option<String>,
    /// Rounds, in which the peer takes turns with ours.
    pub rounds: usize,
}

/// One network in one number format: ours and the peer's, one entry per round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Inference {
    /// Name of the preset.
    pub preset: String,
    /// Number format.
    pub precision: Precision,
    /// Ours.
    pub ours: Vec<Timing>,
    /// From a JPEG of 640 x 480 pixels to touch, ours, ms.
    pub picture_ms: Vec<f64>,
    /// The peer's.
    pub peer: Vec<Timing>,
}

/// A training step with one number of windows, in one number format: ours and the peer's, one entry per round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Training {
    /// Name of the preset.
    pub preset: String,
    /// Number format of forward and backward pass.
    pub precision: Precision,
    /// Windows of a step, each with frames of its own.
    pub windows: usize,
    /// Ours.
    pub ours: Vec<Timed>,
    /// The peer's.
    pub peer: Vec<Timed>,
}

/// Results on one GPU.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GpuReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of egotac.
    pub egotac: String,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// Name of the GPU, and its driver's version.
    pub gpu: String,
    /// Timed runs of each kind.
    pub runs: usize,
    /// Command of the peer.
    pub peer: Option<String>,
    /// The network.
    pub inference: Vec<Inference>,
    /// The training step.
    pub training: Vec<Training>,
}

/// Measures everything; `progress` is told what comes next.
///
/// # Errors
/// If there is no such GPU, it is out of memory, or the peer fails.
pub fn measure(plan: &Plan, mut progress: impl FnMut(&str)) -> Result<GpuReport> {
    let device = egotac_kernels::gpu::open(plan.cuda)?;
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let mut report = GpuReport {
        command: plan.command.clone(),
        egotac: egotac::VERSION.into(),
        machine: Machine::this(),
        gpu: name(plan.cuda),
        runs: plan.runs,
        peer: plan.peer.clone(),
        inference: vec![],
        training: vec![],
    };
    for preset in &plan.presets {
        for precision in plan.precisions.iter().copied() {
            progress(&format!("{preset}, {precision}"));
            let config = Config::preset(preset)?;
            let name = preset.clone();
            let setup = Setup { name, config, precision, threads, runs: plan.runs, batch: 1, device: device.clone() };
            let mut pair =
                Inference { preset: preset.clone(), precision, ours: vec![], picture_ms: vec![], peer: vec![] };
            for _ in 0..plan.rounds {
                let row = measure::random(&setup)?;
                pair.picture_ms.push(row.picture.p50);
                pair.ours.push(Timing {
                    encoder_ms: row.encoder.p50,
                    streaming_ms: row.streaming.p50,
                    clip_ms: row.clip.p50,
                    ..Timing::default()
                });
                if let Some(command) = &plan.peer {
                    pair.peer.push(ask(command, &setup, plan, &[])?);
                }
            }
            report.inference.push(pair);
            for windows in plan.windows.iter().copied() {
                progress(&format!("{preset}, {precision}, training on {windows} windows"));
                let form = Form { clips: windows, windows: 1, encoded: false };
                let mut pair = Training { preset: preset.clone(), precision, windows, ours: vec![], peer: vec![] };
                for _ in 0..plan.rounds {
                    pair.ours.push(train::step(&setup.config, form, plan.runs, precision, &device)?);
                    if let Some(command) = &plan.peer {
                        let batch = windows.to_string();
                        pair.peer.push(ask(command, &setup, plan, &["--train", "--batch", &batch])?);
                    }
                }
                report.training.push(pair);
            }
        }
    }
    Ok(report)
}

/// Asks the peer for the same measurement.
fn ask<T: serde::de::DeserializeOwned>(command: &str, setup: &Setup, plan: &Plan, more: &[&str]) -> Result<T> {
    let [threads, runs, cuda] = [setup.threads, plan.runs, plan.cuda].map(|count| count.to_string());
    let mut words =
        vec!["--preset", &setup.name, "--threads", &threads, "--runs", &runs, "--cuda", &cuda, "--precision"];
    words.push(setup.precision.name());
    words.extend(more);
    peer::ask(command, &words.into_iter().map(Into::into).collect::<Vec<_>>(), setup.threads)
}

/// Returns the name of a GPU and its driver's version, as the driver tells them.
fn name(index: usize) -> String {
    let query = ["--query-gpu=name,driver_version", "--format=csv,noheader", "-i", &index.to_string()];
    let told = Command::new("nvidia-smi").args(query).output().ok().filter(|output| output.status.success());
    match told.map(|output| String::from_utf8_lossy(&output.stdout).trim().replace(", ", ", driver ")) {
        Some(name) if !name.is_empty() => name,
        _ => "unknown GPU".into(),
    }
}

impl GpuReport {
    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let rounds = self.inference.first().map_or(0, |pair| pair.ours.len());
        let mut text = format!(
            "# Time of network and training on a GPU\n\nWritten by `{}`: {} runs of each kind, {rounds} rounds, egotac {}, {}; {}.\n\
             Numbers: `gpu.json`.\n\n\
             *Encoder*: one frame. *Stream*: one more frame of a stream whose other frames are kept. *Window*: all frames of the \
             observation window.\n*Picture*: a JPEG of 640 x 480 pixels to touch, decoding and resizing on the CPU included. Random \
             weights, median of the runs and least of\nthe rounds, ms, up to the end of the work on the GPU.\n\n",
            self.command, self.runs, self.egotac, self.gpu, self.machine
        );
        if let Some(peer) = &self.peer {
            text += &format!("*Peer*: `{peer}` in turn with ours, in the same number format.\n\n");
        }
        text += "| preset | precision | encoder | stream | window | picture | peer's encoder | stream | window | stream, ours / peer |\n\
                 |---|---|---|---|---|---|---|---|---|---|\n";
        for pair in &self.inference {
            let of = |timings: &[Timing]| {
                [least(timings, |t| t.encoder_ms), least(timings, |t| t.streaming_ms), least(timings, |t| t.clip_ms)]
            };
            let ([encoder, stream, window], theirs) = (of(&pair.ours), of(&pair.peer));
            let picture = pair.picture_ms.iter().copied().fold(f64::INFINITY, f64::min);
            let [their_encoder, their_stream, their_window] = theirs.map(ms);
            put(
                &mut text,
                format_args!(
                    "| {} | {} | {} | {} | {} | {} | {their_encoder} | {their_stream} | {their_window} | {} |",
                    pair.preset,
                    pair.precision,
                    ms(encoder),
                    ms(stream),
                    ms(window),
                    ms(picture),
                    ratio(stream / theirs[1])
                ),
            );
        }
        text += "\n## A training step\n\nForward, objective, backward, clipping and AdamW on random pictures, which come from the host; windows have frames of their own, \
                 weights and optimiser are f32.\nMedian of the steps and best of the rounds.\n\n\
                 | preset | precision | windows of a step | step, ms | windows/s | peer's windows/s | ours / peer |\n|---|---|---|---|---|---|---|\n";
        for pair in &self.training {
            let best = |timed: &[Timed]| timed.iter().map(|timed| timed.windows_per_s).fold(0.0, f64::max);
            let (ours, theirs) = (best(&pair.ours), best(&pair.peer));
            put(
                &mut text,
                format_args!(
                    "| {} | {} | {} | {} | {ours:.1} | {} | {} |",
                    pair.preset,
                    pair.precision,
                    pair.windows,
                    ms(1e3 * pair.windows as f64 / ours),
                    if theirs > 0.0 { format!("{theirs:.1}") } else { "—".into() },
                    ratio(ours / theirs)
                ),
            );
        }
        text
    }
}

fn ms(value: f64) -> String {
    if value.is_finite() { format!("{value:.2}") } else { "—".into() }
}

fn ratio(value: f64) -> String {
    if value.is_normal() { format!("**{value:.2}**") } else { "—".into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tables_hold_the_best_rounds_and_a_dash_without_a_peer() {
        let timing =
            |ms: f64| Timing { encoder_ms: ms, streaming_ms: 2.0 * ms, clip_ms: 4.0 * ms, ..Timing::default() };
        let timed = |rate: f64| Timed { step_ms: 4e3 / rate, windows_per_s: rate };
        let inference = |peer| Inference {
            preset: "base".into(),
            precision: Precision::Bf16,
            ours: vec![timing(1.5), timing(1.0)],
            picture_ms: vec![3.0, 2.5],
            peer,
        };
        let training = |peer| Training {
            preset: "base".into(),
            precision: Precision::Bf16,
            windows: 4,
            ours: vec![timed(100.0), timed(80.0)],
            peer,
        };
        let report = GpuReport {
            command: "egotac bench gpu".into(),
            egotac: "0".into(),
            machine: Machine { cpu: "a processor".into(), cores: 2 },
            gpu: "a GPU".into(),
            runs: 5,
            peer: None,
            inference: vec![inference(vec![timing(4.0)]), inference(vec![])],
            training: vec![training(vec![timed(50.0)]), training(vec![])],
        };
        let text = report.markdown();
        for line in [
            "| base | bf16 | 1.00 | 2.00 | 4.00 | 2.50 | 4.00 | 8.00 | 16.00 | **0.25** |",
            "| base | bf16 | 1.00 | 2.00 | 4.00 | 2.50 | — | — | — | — |",
            "| base | bf16 | 4 | 40.00 | 100.0 | 50.0 | **2.00** |",
            "| base | bf16 | 4 | 40.00 | 100.0 | — | — |",
        ] {
            assert!(text.contains(line), "{line} in\n{text}");
        }
    }
}
