//! Another program that runs the same network, timed in turn with ours.

use egotac::error::Result;
use serde::{Deserialize, Serialize};

use crate::peer;

/// Median times of one round, ours or a peer's, ms.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// Encoder, one frame.
    pub encoder_ms: f64,
    /// Stream, one more frame.
    pub streaming_ms: f64,
    /// Whole window.
    pub clip_ms: f64,
    /// Encoder as compiled by OpenVINO, if the peer has it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub openvino_encoder_ms: Option<f64>,
    /// The same in bf16.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub openvino_bf16_ms: Option<f64>,
    /// The same in 8 bits, as quantised by NNCF.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub openvino_int8_ms: Option<f64>,
    /// Largest resident memory, MB (2²⁰), if reported.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peak_memory_mb: Option<f64>,
}

/// A preset beside the peer: one timing of each per round.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rounds {
    /// Name of the preset.
    pub preset: String,
    /// Ours, f32.
    pub ours: Vec<Timing>,
    /// Ours, bf16.
    #[serde(default)]
    pub ours_bf16: Vec<Timing>,
    /// Ours, int8.
    pub ours_int8: Vec<Timing>,
    /// The peer's.
    pub peer: Vec<Timing>,
}

/// Runs `command --preset NAME --threads N --runs R` and reads the JSON object on the last line of its output.
///
/// # Errors
/// If the peer can't be started, fails, or prints something else.
pub fn run(command: &str, preset: &str, threads: usize, runs: usize) -> Result<Timing> {
    let (count, runs) = (threads.to_string(), runs.to_string());
    let arguments = ["--preset", preset, "--threads", &count, "--runs", &runs].map(Into::into);
    peer::ask(command, &arguments, threads)
}

impl Rounds {
    /// Returns our least time over the peer's, for encoder, stream and window. If the peer has OpenVINO, the encoder is
    /// compared with the faster of its two.
    pub fn ratios(&self) -> [f64; 3] {
        let ours = |value: fn(&Timing) -> f64| least(&self.ours, value);
        [
            ours(|t| t.encoder_ms) / least(&self.peer, |t| t.encoder_ms.min(t.openvino_encoder_ms.unwrap_or(f64::MAX))),
            ours(|t| t.streaming_ms) / least(&self.peer, |t| t.streaming_ms),
            ours(|t| t.clip_ms) / least(&self.peer, |t| t.clip_ms),
        ]
    }
}

impl Rounds {
    /// Returns the least times of our encoder and of OpenVINO's in f32, bf16 and int8, ms. Infinite where there is none.
    pub fn encoders(&self) -> [[f64; 2]; 3] {
        let theirs = |value: fn(&Timing) -> Option<f64>| least(&self.peer, |t| value(t).unwrap_or(f64::INFINITY));
        let ours = |timings: &[Timing]| least(timings, |t| t.encoder_ms);
        [
            [ours(&self.ours), theirs(|t| t.openvino_encoder_ms)],
            [ours(&self.ours_bf16), theirs(|t| t.openvino_bf16_ms)],
            [ours(&self.ours_int8), theirs(|t| t.openvino_int8_ms)],
        ]
    }
}

/// Returns the least of a value over all rounds: other load on the machine only lengthens times.
pub fn least(timings: &[Timing], value: impl Fn(&Timing) -> f64) -> f64 {
    timings.iter().map(value).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_encoder_is_compared_with_the_faster_of_both_peers() {
        let timing = |encoder_ms, streaming_ms, openvino_encoder_ms| Timing {
            encoder_ms,
            streaming_ms,
            clip_ms: 40.0,
            openvino_encoder_ms,
            openvino_bf16_ms: openvino_encoder_ms.map(|ms: f64| ms / 2.0),
            ..Default::default()
        };
        let rounds = Rounds {
            preset: "toy".into(),
            ours: vec![timing(9.0, 12.0, None), timing(8.0, 14.0, None)],
            ours_bf16: vec![timing(4.0, 5.0, None)],
            ours_int8: vec![],
            peer: vec![timing(20.0, 24.0, Some(16.0)), timing(21.0, 25.0, Some(17.0))],
        };
        assert_eq!(rounds.ratios(), [0.5, 0.5, 1.0]);
        assert_eq!(rounds.encoders(), [[8.0, 16.0], [4.0, 8.0], [f64::INFINITY; 2]]);
    }

    #[test]
    fn a_peer_that_fails_or_prints_something_else_is_named() {
        for command in ["/nonexistent/program", "false", "echo hello"] {
            let error = run(command, "toy", 1, 1).unwrap_err().to_string();
            assert!(error.contains(command.split(' ').next().unwrap()), "{error}");
        }
    }
}
