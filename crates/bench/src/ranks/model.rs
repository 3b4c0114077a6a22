//! Steps of more ranks than this machine has, computed from measured steps of one rank.

use serde::Serialize;

use super::Row;

/// Numbers of ranks that are computed.
pub const RANKS: [usize; 5] = [2, 4, 8, 16, 64];
/// Bandwidths between machines that are computed, Gbit/s.
pub const GBITS: [f64; 3] = [1.0, 10.0, 100.0];
/// Speeds of a rank relative to the measured one with one thread.
pub const SPEEDS: [f64; 2] = [1.0, 16.0];
/// Share of a step that is the backward pass, in which gradients could be sent while others are still computed.
const BACKWARD: f64 = 2.0 / 3.0;

/// A computed step.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Computed {
    /// Name of the preset.
    pub preset: String,
    /// Speed of a rank relative to one thread here.
    pub speed: f64,
    /// Number of ranks, each on a machine of its own.
    pub ranks: usize,
    /// Bandwidth of each machine in each direction, Gbit/s.
    pub gbit_per_s: f64,
    /// Share of the speed of all ranks that remains, sending after the backward pass, as the program does.
    pub efficiency: f64,
    /// The same if messages ran during the backward pass.
    pub efficiency_with_overlap: f64,
}

/// Returns the time of a step, s, without and with overlap: `compute` seconds of computing, and a ring that sums `bytes` of each of `ranks` ranks,
/// in which each rank sends 2 (R - 1) / R of its bytes.
pub fn step_secs(compute: f64, bytes: f64, ranks: usize, gbit_per_s: f64) -> (f64, f64) {
    let ranks = ranks as f64;
    let exchange = 8.0 * bytes * 2.0 * (ranks - 1.0) / ranks / (gbit_per_s * 1e9);
    (compute + exchange, compute + (exchange - BACKWARD * compute).max(0.0))
}

/// Computes the steps of all numbers of ranks and bandwidths from the measured runs of a preset.
pub fn computed(row: &Row) -> Vec<Computed> {
    let compute = row.one_thread.iter().map(|run| run.step_secs).fold(f64::INFINITY, f64::min);
    let bytes = row.ranks.iter().map(|run| run.exchange_bytes).fold(0.0, f64::max);
    let mut all = Vec::new();
    for speed in SPEEDS {
        for ranks in RANKS {
            for gbit_per_s in GBITS {
                let compute = compute / speed;
                let (after, during) = step_secs(compute, bytes, ranks, gbit_per_s);
                all.push(Computed {
                    preset: row.preset.clone(),
                    speed,
                    ranks,
                    gbit_per_s,
                    efficiency: compute / after,
                    efficiency_with_overlap: compute / during,
                });
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ring_sends_almost_twice_the_bytes_and_hides_behind_the_backward_pass() {
        // 2 ranks send 1.25e8 bytes each: 1 s at 1 Gbit/s.
        assert_eq!(step_secs(3.0, 1.25e8, 2, 1.0), (4.0, 3.0));
        // 4 ranks send 1.5 times the bytes.
        assert_eq!(step_secs(1.5, 1.25e8, 4, 1.0), (3.0, 2.0));
        assert_eq!(step_secs(1.0, 1e9, 1, 1.0), (1.0, 1.0));
        let (after, during) = step_secs(0.0, 1.25e8, 1000, 1.0);
        assert!((after - 2.0).abs() < 0.01 && after == during);
    }
}
