//! Error of gloves: force on the vertices from simulated taxels, beside the simulator's own force.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

use egotac::error::Result;
use egotac::hand::{HandModel, N_FIELD, Side};
use egotac::machine::Machine;
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::plot::{self, PALETTE};
use egotac::sensor::{self, GloveSpec, Layout, SimulatedGlove, TaxelMap};
use egotac::sim::{Rollout, RolloutOptions, Scene};
use egotac::tactile::{CONTACT_FORCE_N, Validity};
use plotters::coord::Shift;
use plotters::prelude::*;
use serde::{Deserialize, Serialize};

/// Rows and columns of a finger and of the palm, from coarse to fine, on the outlines of `aether_132`.
const GRIDS: [([usize; 2], [usize; 2]); 8] = [
    ([1, 1], [1, 1]),
    ([2, 1], [2, 2]),
    ([2, 2], [3, 3]),
    ([3, 2], [4, 5]),
    ([4, 3], [5, 9]),
    ([6, 4], [8, 12]),
    ([8, 6], [12, 16]),
    ([12, 8], [20, 20]),
];
/// Layout whose outlines the grids have.
const OUTLINES: &str = "aether_132";
/// Floors that are measured, N.
const FLOORS: [f64; 6] = [0.0, 0.02, 0.05, 0.1, 0.2, 0.5];

/// Forces of one episode: time, s, and (1556) N of each valid frame.
type Episode = Vec<(f64, Vec<f32>)>;

/// Scores of one glove.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Score {
    /// Glove.
    pub glove: String,
    /// Taxels of one hand.
    pub taxels: usize,
    /// Vertices of the right hand that have a taxel.
    pub covered: usize,
    /// Mean absolute error over vertices with a taxel, N.
    pub mae: f64,
    /// The same over those that are touched in truth, above 0.05 N.
    pub active_mae: f64,
    /// Sum of absolute errors over vertices with a taxel, as a share of the force on them.
    pub field_error: f64,
    /// Force on vertices without a taxel, as a share of all force.
    pub lost: f64,
    /// Difference between the sum of the glove's forces and the true force on its vertices, as a share of the latter.
    pub sum_error: f64,
    /// F1 of contact at 0.05 N, pooled over all vertices; those without a taxel count as untouched.
    pub f1: f64,
}

/// Report of the bench.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GloveReport {
    /// Command that measures the same again.
    pub command: String,
    /// Version of the program.
    pub version: &'static str,
    /// Machine that it was measured on.
    pub machine: Machine,
    /// Scenes.
    pub scenes: Vec<String>,
    /// Number of frames with touch.
    pub frames: usize,
    /// Grids of taxels from coarse to fine, without imperfections.
    pub resolution: Vec<Score>,
    /// The same glove with higher and higher floors.
    pub floor: Vec<Score>,
    /// Gloves that come with egotac, without imperfections, and one with all of them.
    pub gloves: Vec<Score>,
}

/// Measures on `seeds` episodes of each scene, from `seed` on.
///
/// # Errors
/// If a rollout fails or a map can't be read.
pub fn measure(
    command: String,
    scenes: &[Scene],
    seed: u64,
    seeds: u64,
    progress: &mut dyn FnMut(&str),
) -> Result<GloveReport> {
    let mut episodes = Vec::new();
    for scene in scenes {
        for seed in seed..seed + seeds {
            progress(&format!("{} {seed}", scene.name));
            episodes.push(episode(scene, seed)?);
        }
    }
    let hands = Side::BOTH.map(HandModel::builtin);
    let outlines = sensor::open(OUTLINES)?;
    let ideal = |map: &Arc<TaxelMap>, name: &str| score(name, map, &GloveSpec::ideal(OUTLINES), &episodes);
    let mut resolution = Vec::new();
    for (finger, palm) in GRIDS {
        let map = Arc::new(TaxelMap::build(&with_grids(&outlines.layout, finger, palm), &hands)?);
        let name = format!("fingers {} x {}, palm {} x {}", finger[0], finger[1], palm[0], palm[1]);
        progress(&name);
        resolution.push(ideal(&map, &name)?);
    }
    let aether = Arc::new(outlines);
    let mut floor = Vec::new();
    for newtons in FLOORS {
        let spec = GloveSpec { floor: newtons, ..GloveSpec::ideal(OUTLINES) };
        floor.push(score(&format!("{OUTLINES}, floor {newtons} N"), &aether, &spec, &episodes)?);
    }
    let mut gloves = Vec::new();
    for name in sensor::shipped_names() {
        progress(&name);
        gloves.push(ideal(&Arc::new(sensor::open(&name)?), &name)?);
    }
    let worn = GloveSpec {
        gain: 0.1,
        floor: 0.2,
        noise: 0.02,
        crosstalk: 0.1,
        drift: 0.01,
        rate: 25.0,
        delay: 0.04,
        ..GloveSpec::ideal(OUTLINES)
    };
    let name = format!(
        "{OUTLINES}: gain {}, floor {} N, noise {} N, crosstalk {}, drift {} N/sqrt(s), {} Hz, {} s late",
        worn.gain, worn.floor, worn.noise, worn.crosstalk, worn.drift, worn.rate, worn.delay
    );
    gloves.push(score(&name, &aether, &worn, &episodes)?);
    let touched = |frame: &&(f64, Vec<f32>)| frame.1.iter().any(|force| *force > CONTACT_FORCE_N);
    Ok(GloveReport {
        command,
        version: egotac::VERSION,
        machine: Machine::this(),
        scenes: scenes.iter().map(|scene| scene.name.clone()).collect(),
        frames: episodes.iter().flatten().filter(touched).count(),
        resolution,
        floor,
        gloves,
    })
}

fn episode(scene: &Scene, seed: u64) -> Result<Episode> {
    let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
    let mut rollout = Rollout::new(scene, seed, &options)?;
    let mut frames = Vec::new();
    while let Some(frame) = rollout.next_frame()? {
        if frame.frame.validity == Validity::Valid {
            frames.push((frame.frame.timestamp, frame.frame.field.force));
        }
    }
    Ok(frames)
}

/// Returns the layout with other grids on the same outlines.
fn with_grids(layout: &Layout, finger: [usize; 2], palm: [usize; 2]) -> Layout {
    let mut layout = layout.clone();
    let mut first = 0;
    for pad in &mut layout.pads {
        pad.grid = if pad.name == "palm" { palm } else { finger };
        (pad.first, pad.channels, pad.left_channels) = (Some(first), None, None);
        first += pad.grid[0] * pad.grid[1];
    }
    layout.channels = first;
    layout
}

/// Scores a glove on all frames with touch.
fn score(name: &str, map: &Arc<TaxelMap>, spec: &GloveSpec, episodes: &[Episode]) -> Result<Score> {
    let covered: Vec<bool> = map.hands.iter().flat_map(|hand| hand.covered()).collect();
    let (mut errors, mut entries, mut active_errors, mut active) = (0.0, 0usize, 0.0, 0usize);
    let (mut all, mut on_taxels, mut felt) = (0.0, 0.0, 0.0);
    let (mut hits, mut false_alarms, mut misses) = (0usize, 0usize, 0usize);
    for (index, episode) in episodes.iter().enumerate() {
        let mut glove = SimulatedGlove::new(Arc::clone(map), spec.clone(), index as u64)?;
        for (time, truth) in episode {
            let [left, right] = glove.read(*time, truth)?;
            if !truth.iter().any(|force| *force > CONTACT_FORCE_N) {
                continue;
            }
            let felt_force = map.spread([Some(&left), Some(&right)])?;
            for vertex in 0..N_FIELD {
                let force = truth[vertex];
                all += f64::from(force);
                let guess = if covered[vertex] { felt_force[vertex] } else { 0.0 };
                match (guess > CONTACT_FORCE_N, force > CONTACT_FORCE_N) {
                    (true, true) => hits += 1,
                    (true, false) => false_alarms += 1,
                    (false, true) => misses += 1,
                    (false, false) => {}
                }
                if !covered[vertex] {
                    continue;
                }
                let error = f64::from((guess - force).abs());
                (errors, entries) = (errors + error, entries + 1);
                (on_taxels, felt) = (on_taxels + f64::from(force), felt + f64::from(guess));
                if force > CONTACT_FORCE_N {
                    (active_errors, active) = (active_errors + error, active + 1);
                }
            }
        }
    }
    Ok(Score {
        glove: name.into(),
        taxels: map.counts()[1],
        covered: map.hands[1].covered().iter().filter(|covered| **covered).count(),
        mae: errors / entries.max(1) as f64,
        active_mae: active_errors / active.max(1) as f64,
        field_error: errors / f64::max(on_taxels, f64::MIN_POSITIVE),
        lost: (all - on_taxels) / f64::max(all, f64::MIN_POSITIVE),
        sum_error: (felt - on_taxels) / f64::max(on_taxels, f64::MIN_POSITIVE),
        f1: 2.0 * hits as f64 / (2 * hits + false_alarms + misses).max(1) as f64,
    })
}

impl GloveReport {
    /// Writes `glove.md`, `glove.json`, `glove.png` and `glove.svg` into a folder.
    ///
    /// # Errors
    /// If a file can't be written.
    pub fn write_plot(&self, folder: &Path) -> anyhow::Result<()> {
        figure::write(folder, "glove", &Plot::deserialize(serde_json::to_value(self)?)?)?;
        Ok(())
    }

    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let mut text = String::from("# Error of force against the number of taxels\n\n");
        let _ = writeln!(
            text,
            "Written by `{}`: egotac {}, {}. Forces of the simulator's contacts load the taxels of a glove; the glove's readings, spread \
             over the vertices again, stand beside the simulator's own forces. {} frames with touch of the scenes {}. Numbers: \
             `glove.json`.\n\n![Error against the number of taxels](glove.png)\n",
            self.command,
            self.version,
            self.machine,
            self.frames,
            self.scenes.join(", ")
        );
        text.push_str(
            "*MAE* is over vertices that have a taxel, *active MAE* over those of them that are touched above 0.05 N. *Field error* is the \
             sum of absolute errors over the force on these vertices; *lost* is the share of all force that acts where no taxel is; \
             *sum* is the relative error of the force on the taxels' vertices. *F1* is that of contact at 0.05 N over all vertices.\n",
        );
        for (title, scores) in [
            ("Resolution: grids on the outlines of `aether_132`, no imperfection", &self.resolution),
            ("Floor: readings below it are cut off", &self.floor),
            ("Gloves that come with egotac, and one with every imperfection", &self.gloves),
        ] {
            let _ = writeln!(text, "\n## {title}\n");
            text.push_str(
                "| glove | taxels | vertices covered | MAE (N) | active MAE (N) | field error | lost | sum | F1 |\n",
            );
            text.push_str("|---|---|---|---|---|---|---|---|---|\n");
            for score in scores {
                let _ = writeln!(
                    text,
                    "| {} | {} | {} | {:.5} | {:.4} | {:.1} % | {:.1} % | {:+.2} % | {:.3} |",
                    score.glove,
                    score.taxels,
                    score.covered,
                    score.mae,
                    score.active_mae,
                    100.0 * score.field_error,
                    100.0 * score.lost,
                    100.0 * score.sum_error,
                    score.f1
                );
            }
        }
        text
    }
}

/// Content of the plot, as `glove.json` holds it.
#[derive(Debug, Clone, Deserialize)]
pub struct Plot {
    resolution: Vec<Point>,
}

/// Grid of taxels that is drawn; see [`Score`].
#[derive(Debug, Clone, Deserialize)]
struct Point {
    taxels: usize,
    field_error: f64,
    f1: f64,
}

impl Figure for Plot {
    const SIZE: (u32, u32) = (900, 540);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        type Of = fn(&Point) -> f64;
        let series: [(&str, Of); 2] = [
            ("error of the field / force (less is better)", |point| point.field_error),
            ("F1 of contact (more is better)", |point| point.f1),
        ];
        let keys: Vec<(&str, RGBColor)> = series.iter().map(|(name, _)| *name).zip(PALETTE).collect();
        let body = plot::head(root, "Accuracy of force against the number of taxels", &keys)?;
        let most = self.resolution.iter().map(|point| point.field_error.max(point.f1)).fold(0.0, f64::max).max(0.1);
        let (low, high) = (4.0, 1200.0);
        let mut chart =
            plot::chart(&body, "", [60, 86]).build_cartesian_2d((low..high).log_scale(), 0.0..1.05 * most)?;
        let whole = |value: &f64| format!("{value:.0}");
        let tenths = |value: &f64| format!("{value:.1}");
        plot::axes(&mut chart, ("taxels per hand", &whole), ("relative error, F1", &tenths), [6, 8])?;
        for ((_, of), color) in series.into_iter().zip(PALETTE) {
            let points = || self.resolution.iter().map(|point| (point.taxels as f64, of(point)));
            chart.draw_series(LineSeries::new(points(), color.stroke_width(2)))?;
            chart.draw_series(points().map(|point| Circle::new(point, 4, color.filled())))?;
        }
        root.present()?;
        Ok(())
    }
}
