//! Forces from motion against the simulator's contacts: all scenes, under noise, at two frame rates, with masses known,
//! guessed and wrong.

pub mod determined;
pub mod plot;
pub(crate) mod record;
mod report;
mod score;
mod solver;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

use egotac::error::Result;
use egotac::machine::Machine;
use egotac::physics::{Settings, whole};
use egotac::sim::Scene;
use rayon::prelude::*;
use serde::Serialize;

pub use record::{Disturbance, MassKnowledge, Recorded};
pub use score::{Score, Sums};
pub use solver::SolverRow;

/// Noise of poses: mm, degrees.
const NOISES: [(f64, f64); 5] = [(0.0, 0.0), (1.0, 1.0), (3.0, 1.0), (3.0, 3.0), (5.0, 3.0)];
/// Frame rates, 1/s.
const RATES: [f64; 2] = [30.0, 60.0];

/// Report of the bench.
#[derive(Debug, Clone, Serialize)]
pub struct PhysicsReport {
    /// Command that measures the same again.
    pub command: String,
    /// Version of the program.
    pub version: &'static str,
    /// Machine that it was measured on.
    pub machine: Machine,
    /// Processes that wanted to run beside it, mean over a minute.
    pub load: f64,
    /// Seeds of each scene.
    pub seeds: [u64; 2],
    /// Scenes without a body that moves freely: nothing follows from motion there.
    pub left_out: Vec<String>,
    /// Settings of the estimation.
    pub settings: Settings,
    /// Scores by condition.
    pub conditions: Vec<Score>,
    /// Scores by scene, with exact poses at 60 Hz and known masses.
    pub scenes: BTreeMap<String, Score>,
    /// Scores by condition and split of the scenes: the settings were chosen on other episodes of `train` scenes, and on no
    /// episode of `ood` scenes.
    pub splits: Vec<(String, Score)>,
    /// The solver beside a general one; empty without a peer.
    pub solvers: Vec<SolverRow>,
}

/// Returns the conditions: all noises and rates with known masses, and two noises with the others.
pub fn conditions() -> Vec<Disturbance> {
    let mut conditions = Vec::new();
    for rate in RATES {
        for (millimetres, degrees) in NOISES {
            conditions.push(Disturbance { rate, millimetres, degrees, mass: MassKnowledge::Known });
        }
    }
    for mass in [MassKnowledge::Density, MassKnowledge::Wrong] {
        for (millimetres, degrees) in [NOISES[0], NOISES[2]] {
            conditions.push(Disturbance { rate: RATES[0], millimetres, degrees, mass });
        }
    }
    conditions
}

/// Measures on `seeds` episodes of each scene, from `seed` on; `peer`: command of a solver to compare with.
///
/// # Errors
/// If a rollout fails.
pub fn measure(
    command: String,
    scenes: &[Scene],
    seeds: std::ops::Range<u64>,
    settings: Settings,
    rows: Option<&Path>,
    peer: Option<&str>,
    progress: &(dyn Fn(&str) + Sync),
) -> Result<PhysicsReport> {
    // Soft objects have no single pose, so that no motion is estimated for them.
    let (soft, rigid): (Vec<&Scene>, Vec<&Scene>) = scenes.iter().partition(|scene| scene.spec.has_soft_object());
    let episodes: Vec<(u64, &Scene)> =
        seeds.clone().flat_map(|seed| rigid.iter().map(move |scene| (seed, *scene))).collect();
    let recorded: Vec<(u64, Recorded)> = episodes
        .par_iter()
        .map(|(seed, scene)| {
            progress(&format!("{} {seed}", scene.name));
            Ok((*seed, Recorded::new(scene, *seed)?))
        })
        .collect::<Result<_>>()?;
    let (free, held): (Vec<_>, Vec<_>) = recorded.into_iter().partition(|(_, recorded)| recorded.is_free());
    let mut left_out: Vec<String> = held.into_iter().map(|(_, recorded)| recorded.scene).collect();
    left_out.dedup();
    left_out.extend(soft.into_iter().map(|scene| scene.name.clone()));
    let measure = |condition: Disturbance| -> Vec<(String, Sums)> {
        let episode = |(index, (seed, recorded)): (usize, &(u64, Recorded))| {
            let (take, frames) = recorded.disturbed(&condition, 1000 * seed + index as u64);
            let started = Instant::now();
            let estimate = whole(&take, &settings);
            let mut sums = Sums::default();
            sums.add(recorded, &take, &frames, &estimate, started.elapsed().as_secs_f64());
            (recorded.scene.clone(), sums)
        };
        free.par_iter().enumerate().map(episode).collect()
    };
    let exact = Disturbance { rate: RATES[1], millimetres: 0.0, degrees: 0.0, mass: MassKnowledge::Known };
    let held_out = egotac::sim::scene::Split::named("ood")?.scenes;
    let (mut scores, mut by_scene, mut splits) = (Vec::new(), BTreeMap::new(), Vec::new());
    for condition in conditions() {
        progress(&report::name(&condition));
        let episodes = measure(condition);
        let part = |of: &dyn Fn(&str) -> bool| {
            let mut sums = Sums::default();
            episodes.iter().filter(|(scene, _)| of(scene)).for_each(|(_, episode)| sums.append(episode));
            sums
        };
        let all = part(&|_| true);
        if let Some(folder) = rows {
            all.write(folder, &report::name(&condition).replace(" | ", "_").replace([' ', ',', '°', '%'], ""))?;
        }
        scores.push(all.score(condition));
        if condition == exact {
            for scene in scenes.iter().filter(|scene| !left_out.contains(&scene.name)) {
                by_scene.insert(scene.name.clone(), part(&|name| name == scene.name).score(exact));
            }
        }
        for (name, is_held_out) in [("train", false), ("ood", true)] {
            let of = |scene: &str| held_out.iter().any(|held| held == scene) == is_held_out;
            splits.push((name.to_string(), part(&of).score(condition)));
        }
    }
    Ok(PhysicsReport {
        command,
        version: egotac::VERSION,
        machine: Machine::this(),
        load: load(),
        seeds: [seeds.start, seeds.end],
        left_out,
        settings,
        conditions: scores,
        scenes: by_scene,
        splits,
        solvers: peer.map(solver::compare).transpose()?.unwrap_or_default(),
    })
}

/// Returns the number of processes that want to run, mean over a minute; NaN where the system does not tell.
fn load() -> f64 {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split(' ').next().and_then(|first| first.parse().ok()).unwrap_or(f64::NAN)
}
