//! Experiment `reuse`: accuracy of a finished network and its time if it skips encoder work: images that hardly change, and patches
//! without hands.

use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::time::Instant;

use egotac::error::{Error, Result};
use egotac::model::predictor::{self, Focus};
use egotac::model::{Predictor, Unknown};
use egotac::render::figure::{Drawn, Figure};
use egotac::render::plot::{self, PALETTE};
use egotac::sim::{SHIPPED, Scene, UniformRange};
use egotac::text::put;
use plotters::coord::Shift;
use plotters::prelude::*;
use serde::{Deserialize, Serialize};

use super::data::MEASURED_SEED;
use super::measure;
use super::recipe::Recipe;
use super::report::{Head, Scores, force_truth, options};
use super::{Progress, Setup, Size, render};

/// Changes of a patch up to which tokens are reused, grey levels; 0 = every image is encoded.
const LEVELS: [f32; 8] = [0.0, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 16.0];
/// Shares of the encoder's layers that all patches pass, and distances from the hands up to which patches pass the others, patches.
const FOCUSES: [(f64, f32); 8] =
    [(0.0, 1.0), (0.0, 2.0), (0.25, 1.0), (0.25, 2.0), (0.5, 1.0), (0.5, 2.0), (0.75, 1.0), (0.75, 2.0)];
/// Images from one that is encoded whole to the next.
const EVERY: usize = 10;
/// Cameras: name, sway of the camera, m, and deviation of its noise, grey levels.
const CAMERAS: [(&str, UniformRange, UniformRange); 2] = [
    ("on the head", UniformRange::new(0.0, 0.008), UniformRange::new(1.0, 3.0)),
    ("on a stand", UniformRange::fixed(0.0), UniformRange::new(1.0, 3.0)),
];

/// Results of the experiment.
#[derive(Debug, Clone, Serialize)]
pub struct ReuseReport {
    /// Description of the run.
    #[serde(flatten)]
    pub head: Head,
    /// Frames of each camera.
    pub frames: usize,
    /// Episodes of each camera.
    pub episodes: usize,
    /// Results by camera and setting.
    pub rows: Vec<Row>,
}

/// Results with one setting.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Camera.
    pub camera: &'static str,
    /// Change of a patch up to which tokens are reused, grey levels.
    pub below: f32,
    /// Patches that are encoded; None = all.
    pub focus: Option<Focus>,
    /// Share of the patches of all images that all layers computed.
    pub encoded: f64,
    /// Median time of an image, preparation included, ms.
    pub median_ms: f64,
    /// Mean time of an image, ms.
    pub mean_ms: f64,
    /// Scores, and differences from encoding every image.
    pub scores: Scores,
}

/// Returns the settings of a network of `layers` layers: first the levels (the first level encodes everything), then the parts.
fn settings(quick: bool, layers: usize) -> Vec<(f32, Option<Focus>)> {
    let focus =
        |(share, reach): (f64, f32)| Focus { after: (share * layers as f64).round() as usize, reach, every: EVERY };
    let (levels, focuses) = match quick {
        true => (vec![LEVELS[0], LEVELS[LEVELS.len() - 1]], vec![FOCUSES[0]]),
        false => (LEVELS.to_vec(), FOCUSES.to_vec()),
    };
    let levels = levels.into_iter().map(|below| (below, None));
    levels.chain(focuses.into_iter().map(|part| (0.0, Some(focus(part))))).collect()
}

/// Measures a network with all settings.
///
/// # Errors
/// If data can't be made or read, or the network fails.
pub fn run(setup: &Setup, command: String, progress: &mut dyn FnMut(Progress)) -> Result<ReuseReport> {
    let settings = settings(setup.quick, predictor(setup, 0.0, None)?.config().vision_depth);
    let mut rows = Vec::new();
    let (mut frames, mut episodes, all) = (0, 0, CAMERAS.len() * settings.len());
    for (camera, sway, noise) in CAMERAS {
        let recipes = recipes(setup, camera, sway, noise)?;
        render(&recipes, progress)?;
        let truth = force_truth(&recipes)?;
        (frames, episodes) = (truth.n_frames(), truth.episodes().len());
        let mut encoded = None;
        for &(below, focus) in &settings {
            progress(Progress::Measured(rows.len(), all));
            let mut predictor = predictor(setup, below, focus)?;
            let (mut patches, mut times, before) = (0.0, Vec::with_capacity(frames), Cell::new(Instant::now()));
            let predicted = measure::predict_watched(
                &mut predictor,
                &recipes,
                &mut |_, image| {
                    before.set(Instant::now());
                    Ok(image)
                },
                &mut |prediction| {
                    times.push(before.get().elapsed().as_secs_f64() * 1e3);
                    patches += f64::from(prediction.encoded);
                },
            )?;
            let mut scores = Scores::default();
            scores.push(&predicted, encoded.as_ref(), &truth, &options(&truth, None))?;
            encoded.get_or_insert(predicted);
            let count = times.len().max(1) as f64;
            rows.push(Row {
                camera,
                below,
                focus,
                encoded: patches / count,
                mean_ms: times.iter().sum::<f64>() / count,
                median_ms: egotac::statistics::percentile(times, 0.5),
                scores,
            });
        }
    }
    progress(Progress::Measured(all, all));
    Ok(ReuseReport {
        head: Head::new(
            "reuse",
            "What does it cost to skip images that hardly change, or patches without hands?",
            command,
            setup,
        ),
        frames,
        episodes,
        rows,
    })
}

/// Loads the network with a setting.
fn predictor(setup: &Setup, reuse_below: f32, focus: Option<Focus>) -> Result<Predictor> {
    let path = setup.network.path.as_deref().ok_or_else(|| Error::value("--checkpoint", "a checkpoint", "none"))?;
    let (max_gap_secs, unknown) = (Some(f64::MAX), Unknown::Guess);
    Predictor::load(path, predictor::Options { max_gap_secs, unknown, reuse_below, focus, ..Default::default() })
}

/// Returns the stores of the shipped scenes under a camera.
fn recipes(setup: &Setup, camera: &str, sway: UniformRange, noise: UniformRange) -> Result<Vec<Recipe>> {
    let Size { held_out, image, scenes, .. } = setup.size;
    let folder = setup.work.join("data");
    let recipe = |(name, _): &(&str, &str)| {
        let mut spec = Scene::load(name)?.spec;
        (spec.camera.sway, spec.camera.noise) = (sway, noise);
        let text = serde_yaml::to_string(&spec).map_err(|e| Error::value("scene", "one that YAML can hold", e))?;
        let hash = &egotac::file::sha256(text.as_bytes())[..8];
        let file = format!("reuse_{name}_{}", camera.replace(' ', "_"));
        Ok(Recipe {
            path: folder.join(format!("{file}_{held_out}_{image}_{hash}.zarr")),
            scene: folder.join("scenes").join(format!("{file}.yaml")),
            text,
            episodes: held_out,
            seed: MEASURED_SEED,
            side: image,
            mano: None,
        })
    };
    SHIPPED.iter().take(scenes).map(recipe).collect()
}

impl ReuseReport {
    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let network = &self.head.network;
        let mut text = format!(
            "{}\nMeasured is `{}` ({}), which has seen {}. \
             {} frames of {} episodes at 25 Hz under each camera: *on the head* it sways, *on a stand* it does not; both have noise of 1 \
             to 3 grey levels.\nLevels: an image is not encoded if no patch differs from the last encoded image by more than the level, the mean \
             absolute difference of its pixels in 8 bits; touch is then decoded from the tokens of that image.\nPatches: all patches pass the \
             first layers, and only those near a hand pass the others: near the box around the hand's keypoints in the image before. The tokens of the \
             rest stay those of the image before. Every {EVERY}th image is encoded whole, and so is one after an image without a hand.\nTimes hold the \
             preparation of the picture. Differences are from encoding all, with 95 % intervals over episodes.\n\n\
             ![Share of encoded patches, time and F1 with each setting](reuse.png)\n",
            self.head.markdown(),
            network.name,
            network.sha256.get(..12).unwrap_or_default(),
            network.has_seen,
            self.frames,
            self.episodes,
        );
        for (camera, ..) in CAMERAS {
            let rows: Vec<&Row> = self.rows.iter().filter(|row| row.camera == camera).collect();
            let columns = "encoded | median time (ms) | mean time (ms) | of encoding all | F1, frame mean | difference | active MAE (N) | \
                           temporal Pearson | difference |";
            put(&mut text, format_args!("\n## Camera {camera}\n\n| level | {columns}\n|{}", "---|".repeat(10)));
            for row in rows.iter().filter(|row| row.focus.is_none()) {
                put(&mut text, format_args!("| {} | {}", row.below, row.cells(rows[0])));
            }
            put(
                &mut text,
                format_args!("\n| layers for all patches | near (patches) | {columns}\n|{}", "---|".repeat(11)),
            );
            for row in &rows {
                if let Some(focus) = row.focus {
                    put(&mut text, format_args!("| {} | {} | {}", focus.after, focus.reach, row.cells(rows[0])));
                }
            }
        }
        text
    }
}

impl Row {
    /// Returns the cells of all tables; `all` is the row that encodes all.
    fn cells(&self, all: &Row) -> String {
        let score = |name: &str| match self.scores.score(name).first() {
            Some(Some(score)) => format!("{score:.3}"),
            _ => "–".into(),
        };
        let difference = |name: &str| match self.scores.difference(name) {
            Some((difference, [low, high])) => format!("{difference:+.3} ({low:+.3} .. {high:+.3})"),
            None => "–".into(),
        };
        format!(
            "{:.1} % | {:.2} | {:.2} | {:.2} | {} | {} | {} | {} | {} |",
            100.0 * self.encoded,
            self.median_ms,
            self.mean_ms,
            self.mean_ms / all.mean_ms,
            score("frame_mean.f1"),
            difference("frame_mean.f1"),
            score("active_mae"),
            score("temporal_pearson"),
            difference("temporal_pearson"),
        )
    }
}

/// Plot of `reuse`, from its report in JSON.
#[derive(Debug, Clone, Deserialize)]
pub struct Plot {
    question: String,
    rows: Vec<Point>,
}

/// Drawn part of a [`Row`].
#[derive(Debug, Clone, Deserialize)]
struct Point {
    camera: String,
    below: f64,
    focus: Option<Focus>,
    encoded: f64,
    mean_ms: f64,
    scores: Scores,
}

impl Plot {
    /// Takes the content of the plot from a report.
    ///
    /// # Errors
    /// None in practice: a report has what the plot needs.
    pub fn of(report: &ReuseReport, path: &Path) -> Result<Self> {
        let json = serde_json::to_value(report).map_err(|error| Error::file(path, error))?;
        serde_json::from_value(json).map_err(|error| Error::file(PathBuf::from(path), error))
    }

    /// Draws a quantity over the level, one line per camera.
    fn panel<B: DrawingBackend>(
        &self,
        area: &DrawingArea<B, Shift>,
        title: &str,
        of: impl Fn(&Point, &Point) -> Option<f64>,
    ) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        let most = self.rows.iter().map(|point| point.below).fold(1.0, f64::max);
        let mut chart = plot::chart(area, title, [55, 76]).build_cartesian_2d(0.0..most, 0.0..1.05)?;
        let level = ("level, grey levels", &|x: &f64| format!("{x:.0}"));
        plot::axes(&mut chart, (level.0, level.1), ("", &|y| format!("{y:.1}")), [9, 6])?;
        for ((camera, ..), color) in CAMERAS.iter().zip(PALETTE) {
            let rows: Vec<&Point> =
                self.rows.iter().filter(|point| point.camera == *camera && point.focus.is_none()).collect();
            let points: Vec<(f64, f64)> =
                rows.iter().filter_map(|point| Some((point.below, of(point, rows[0])?))).collect();
            chart.draw_series(LineSeries::new(points.iter().copied(), color.stroke_width(3)))?;
            chart.draw_series(points.into_iter().map(|point| Circle::new(point, 4, color.filled())))?;
        }
        Ok(())
    }
}

impl Plot {
    /// Draws F1 over the mean time: a line for levels, rings for parts.
    fn price<B: DrawingBackend>(&self, area: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        let f1 = |point: &Point| *point.scores.score("frame_mean.f1").first()?;
        let values: Vec<f64> = self.rows.iter().filter_map(f1).collect();
        let (low, high) = values.iter().fold((f64::INFINITY, 0.0f64), |(low, high), y| (low.min(*y), high.max(*y)));
        let (low, high) = if low.is_finite() { (low - 0.02, high + 0.02) } else { (0.0, 1.0) };
        let title = "F1 by time (rings: patches without hands skipped)";
        let mut chart = plot::chart(area, title, [55, 76]).build_cartesian_2d(0.5..1.1, low..high)?;
        let time = ("time as a share of encoding all images", &|x: &f64| format!("{x:.1}"));
        plot::axes(&mut chart, (time.0, time.1), ("", &|y| format!("{y:.2}")), [7, 6])?;
        for ((camera, ..), color) in CAMERAS.iter().zip(PALETTE) {
            let rows: Vec<&Point> = self.rows.iter().filter(|point| point.camera == *camera).collect();
            let at = |point: &&&Point| Some((point.mean_ms / rows[0].mean_ms, f1(point)?));
            let levels: Vec<(f64, f64)> =
                rows.iter().filter(|point| point.focus.is_none()).filter_map(|p| at(&p)).collect();
            chart.draw_series(LineSeries::new(levels.iter().copied(), color.stroke_width(3)))?;
            chart.draw_series(levels.into_iter().map(|point| Circle::new(point, 4, color.filled())))?;
            let parts = rows.iter().filter(|point| point.focus.is_some()).filter_map(|p| at(&p));
            chart.draw_series(parts.map(|point| Circle::new(point, 5, color.stroke_width(2))))?;
        }
        Ok(())
    }
}

impl Figure for Plot {
    const SIZE: (u32, u32) = (1200, 860);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let names = CAMERAS.map(|(camera, ..)| format!("camera {camera}"));
        let keys: Vec<(&str, RGBColor)> = names.iter().map(String::as_str).zip(PALETTE).collect();
        let parts = plot::head(root, &self.question, &keys)?.split_evenly((2, 2));
        self.panel(&parts[0], "Share of images encoded", |point, _| Some(point.encoded))?;
        self.panel(&parts[1], "Time as a share of encoding all images", |point, all| {
            Some(point.mean_ms / all.mean_ms)
        })?;
        self.panel(&parts[2], "F1, frame mean", |point, _| *point.scores.score("frame_mean.f1").first()?)?;
        self.price(&parts[3])?;
        root.present()?;
        Ok(())
    }
}
