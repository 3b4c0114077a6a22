//! Time of a training step: on windows with frames of their own, on windows that share the frames of a clip, and a peer's.

use std::ffi::OsString;
use std::time::Instant;

use candle_core::Device;
use candle_nn::VarMap;
use egotac::error::{Error, Result};
use egotac::machine::Machine;
use egotac::model::{Config, EgoTac, Precision, init};
use egotac::statistics::median;
use egotac::tactile::N_FIELD;
use egotac::text::put;
use egotac::train::batch::{Batch, FrameKey};
use egotac::train::config::LossWeights;
use egotac::train::fixed_encoder::FixedEncoder;
use egotac::train::memory;
use egotac::train::optimizer::AdamW;
use egotac::train::pass::Pass;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::peer;

/// Windows of a batch without shared frames.
const WINDOWS: usize = 4;
/// Frames of a clip with shared frames.
const CLIP: usize = 16;
/// Share of contacts among the labels.
const ACTIVE: f64 = 0.1;

/// Arrangement of the windows of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Form {
    /// Clips; no two share a frame.
    pub clips: usize,
    /// Windows of each clip, one frame apart; they share the frames of the clip.
    pub windows: usize,
    /// True if the encoder does not learn and has encoded the frames before.
    pub encoded: bool,
}

impl Form {
    /// 4 windows of T frames each.
    pub const OWN: Self = Self { clips: WINDOWS, windows: 1, encoded: false };

    /// Returns all windows of a clip of 16 frames; each frame is encoded once.
    pub fn shared(geometry: &Config) -> Self {
        Self { clips: 1, windows: CLIP.saturating_sub(geometry.horizon) + 1, encoded: false }
    }
}

/// Time of a step.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Timed {
    /// Median of the steps, ms.
    pub step_ms: f64,
    /// Windows per second at this time.
    pub windows_per_s: f64,
}

/// Networks to measure, and how.
#[derive(Debug, Clone, Copy)]
pub struct Plan<'a> {
    /// Presets, with random weights.
    pub presets: &'a [String],
    /// Number formats of forward and backward pass.
    pub precisions: &'a [Precision],
    /// Threads of ours and of the peer.
    pub threads: usize,
    /// Steps per round and form.
    pub runs: usize,
    /// Command of a peer, and rounds in which it takes turns with ours.
    pub peer: Option<(&'a str, usize)>,
}

/// Results of one preset in one number format beside the peer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Name of the preset.
    pub preset: String,
    /// Number format of forward and backward pass.
    pub precision: Precision,
    /// 4 windows with frames of their own; one value per round.
    pub own: Vec<Timed>,
    /// 13 windows (T = 4) of a clip's 16 frames; one value per round.
    pub shared: Vec<Timed>,
    /// The peer's step on 4 windows; one value per round.
    pub peer: Vec<Timed>,
}

/// Results of all presets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrainReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of egotac.
    pub egotac: &'static str,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// Threads of ours and of the peer.
    pub threads: usize,
    /// Steps per round and form.
    pub runs: usize,
    /// One row per preset and number format.
    pub rows: Vec<Row>,
}

/// Times whole optimisation steps on random pictures and labels: forward, objective, backward, clipping, AdamW.
///
/// # Errors
/// If the device is out of memory.
pub fn step(geometry: &Config, form: Form, runs: usize, precision: Precision, device: &Device) -> Result<Timed> {
    let varmap = VarMap::new();
    let network = EgoTac::new(geometry, init::var_builder(&varmap, 0, device))?;
    let mut optimizer = AdamW::new(&varmap, &config()?)?;
    let weights = LossWeights::default();
    let fixed = match form.encoded {
        true => {
            let same = EgoTac::new(geometry, init::var_builder(&varmap, 0, device))?;
            Some(FixedEncoder::new(same.freeze()?, true))
        }
        false => None,
    };
    let pass = Pass {
        network: &network,
        variables: &varmap,
        fixed_encoder: fixed.as_ref(),
        keypoint_heads: None,
        geometry,
        force_scale: 1.0,
        weights: &weights,
        device,
    };
    let batch = batch(geometry, form);
    let windows = batch.windows.len() / geometry.horizon;
    let mut times = Vec::new();
    // The first step also pays for the page faults of its memory; on a GPU kernels are loaded and chosen in the first ones.
    let warm_up = if device.is_cpu() { 1 } else { 5 };
    for _ in 0..warm_up + runs.max(1) {
        let batch = batch.clone();
        let begun = Instant::now();
        let passed = pass.run(batch, 1.0, precision)?;
        optimizer.step(&passed.gradients, 1e-4)?;
        device.synchronize()?;
        times.push(begun.elapsed().as_secs_f64() * 1e3);
    }
    let step_ms = median(times.into_iter().skip(warm_up));
    Ok(Timed { step_ms, windows_per_s: 1e3 * windows as f64 / step_ms })
}

/// Times every preset in every number format and both forms, in turn with the peer. `command` measures the same again.
///
/// # Errors
/// If a preset is unknown, and as [`step`], and if the peer fails.
pub fn measure(command: String, plan: Plan, mut progress: impl FnMut(&str)) -> Result<TrainReport> {
    memory::keep(true);
    let Plan { presets, precisions, threads, runs, peer } = plan;
    let mut rows = Vec::new();
    for (preset, precision) in presets.iter().flat_map(|preset| precisions.iter().map(move |it| (preset, *it))) {
        let geometry = Config::preset(preset)?;
        let mut row = Row { preset: preset.clone(), precision, own: vec![], shared: vec![], peer: vec![] };
        for _ in 0..peer.map_or(1, |(_, rounds)| rounds.max(1)) {
            progress(&format!("{preset}, {precision}"));
            row.own.push(step(&geometry, Form::OWN, runs, precision, &Device::Cpu)?);
            row.shared.push(step(&geometry, Form::shared(&geometry), runs, precision, &Device::Cpu)?);
            if let Some((command, _)) = peer {
                row.peer.push(ask(command, preset, precision, threads, runs)?);
            }
        }
        rows.push(row);
    }
    Ok(TrainReport { command, egotac: egotac::VERSION, machine: Machine::this(), threads, runs, rows })
}

impl TrainReport {
    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let mut text = format!(
            "# What a training step costs\n\nWritten by `{}`: {} threads, {} steps per round and form, median of the steps and \
             best of the rounds,\negotac {}, {}. Numbers: `train.json`.\n\n\
             *Own*: {WINDOWS} windows with frames of their own. *Shared*: all windows of a clip of {CLIP} frames, each encoded \
             once. The peer takes\n{WINDOWS} windows with frames of their own, in the same number format. A step is forward, objective, backward, clipping and \
             AdamW\non random pictures; weights and optimiser are f32.\n\n\
             | preset | precision | own, windows/s | shared, windows/s | peer, windows/s | own / peer | shared / peer |\n\
             |---|---|---|---|---|---|---|\n",
            self.command, self.threads, self.runs, self.egotac, self.machine
        );
        for row in &self.rows {
            let [own, shared, peer] = [&row.own, &row.shared, &row.peer].map(|timed| best(timed));
            let value = |rate: f64| if rate > 0.0 { format!("{rate:.2}") } else { "—".into() };
            let ratio = |rate: f64| if peer > 0.0 { format!("**{:.2}**", rate / peer) } else { "—".into() };
            put(
                &mut text,
                format_args!(
                    "| {} | {} | {} | {} | {} | {} | {} |",
                    row.preset,
                    row.precision,
                    value(own),
                    value(shared),
                    value(peer),
                    ratio(own),
                    ratio(shared)
                ),
            );
        }
        text
    }
}

/// Returns the windows per second of the best round.
fn best(timed: &[Timed]) -> f64 {
    timed.iter().map(|timed| timed.windows_per_s).fold(0.0, f64::max)
}

fn config() -> Result<egotac::train::Config> {
    let text = "{ name: bench, data: [none], out: none, model: tiny, seed: 0, steps: 1000 }";
    serde_yaml::from_str(text).map_err(|error| Error::value("bench", "a configuration", error))
}

fn batch(geometry: &Config, form: Form) -> Batch {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let horizon = geometry.horizon as u32;
    let of_clip = (geometry.horizon + form.windows - 1) as u32;
    let starts =
        (0..form.clips as u32).flat_map(|clip| (0..form.windows as u32).map(move |window| clip * of_clip + window));
    let windows: Vec<u32> = starts.flat_map(|start| start..start + horizon).collect();
    let frames = form.clips * of_clip as usize;
    let entries = windows.len() / geometry.horizon * geometry.predict * N_FIELD;
    let force: Vec<f32> =
        (0..entries).map(|_| if rng.random_bool(ACTIVE) { rng.random_range(0.1..1.0) } else { 0.0 }).collect();
    Batch {
        frames: (0..frames * 3 * geometry.image.pow(2)).map(|_| rng.random_range(-2.0..2.0)).collect(),
        windows,
        contact: force.iter().map(|force| f32::from(u8::from(*force > 0.05))).collect(),
        force,
        mask_force: vec![1.0; entries],
        mask_contact: vec![1.0; entries],
        points: vec![],
        keys: (0..frames).map(|frame| FrameKey { store: 0, frame, mirrored: false }).collect(),
    }
}

/// Runs the peer as `command --train --preset NAME --precision FORMAT --threads N --runs R --batch 4` and reads the JSON object on its
/// last line.
fn ask(command: &str, preset: &str, precision: Precision, threads: usize, runs: usize) -> Result<Timed> {
    let [count, runs, batch] = [threads, runs, WINDOWS].map(|count| count.to_string());
    let (network, steps) =
        (["--preset", preset, "--precision", precision.name()], ["--runs", &runs, "--batch", &batch]);
    let arguments = [["--train", "--threads", &count].as_slice(), &network, &steps].concat();
    let arguments: Vec<OsString> = arguments.into_iter().map(Into::into).collect();
    peer::ask(command, &arguments, threads)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_windows_use_every_frame_of_the_clip_and_own_windows_none_twice() {
        let geometry = Config { horizon: 4, ..Config::toy() };
        let own = batch(&geometry, Form::OWN);
        assert_eq!((own.n_frames(geometry.image), own.windows), (16, (0..16).collect::<Vec<u32>>()));
        let shared = batch(&geometry, Form::shared(&geometry));
        assert_eq!((shared.n_frames(geometry.image), shared.windows.len()), (16, 13 * 4));
        assert_eq!(shared.windows.last(), Some(&15));
    }

    #[test]
    fn a_step_of_the_smallest_network_is_timed() {
        for precision in [Precision::F32, Precision::Bf16] {
            let timed = step(&Config::toy(), Form::shared(&Config::toy()), 1, precision, &Device::Cpu).unwrap();
            // toy has T = 3: 14 windows.
            assert!((timed.windows_per_s * timed.step_ms - 14_000.0).abs() < 1e-6);
        }
    }
}
