//! Experiment `decline`: accuracy of a finished network on pictures that get worse step by step.

use std::collections::BTreeMap;
use std::path::Path;

use egotac::dataset::zarr::ZarrReader;
use egotac::error::{Error, Result};
use egotac::image::Square;
use egotac::model::checkpoint::parameter_count;
use egotac::render::figure::{self, Drawn, Figure};
use egotac::render::plot::{self, PALETTE};
use egotac::score::metrics::baseline;
use egotac::tactile::TactileSequence;
use egotac::train::crops;
use image::RgbImage;
use plotters::coord::Shift;
use plotters::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use super::data;
use super::degrade::{Degradation, Episode};
use super::finished::Finished;
use super::measure::{self, Place};
use super::plot::test_title;
use super::recipe::Recipe;
use super::report::{ArmReport, Head, Report, TestInfo, force_truth, options, score, score_blind};
use super::{Progress, Setup, render};

/// Seed of noise, blocks and directions.
const SEED: u64 = 30;

/// Kind of degradation with its levels, from mild to severe.
struct Factor {
    name: &'static str,
    /// Title of the panel, with the unit of the levels.
    title: &'static str,
    levels: &'static [(&'static str, Degradation)],
}

use Degradation::{Blur, Exposure, FrameRate, Noise, Occlusion, Resolution};

static FACTORS: [Factor; 6] = [
    Factor {
        name: "occlusion",
        title: "Occluded share of the hands' squares",
        levels: &[("10%", Occlusion(0.1)), ("25%", Occlusion(0.25)), ("50%", Occlusion(0.5)), ("75%", Occlusion(0.75))],
    },
    Factor {
        name: "blur",
        title: "Motion blur, share of the picture's side",
        levels: &[("1%", Blur(0.01)), ("2%", Blur(0.02)), ("5%", Blur(0.05)), ("10%", Blur(0.1))],
    },
    Factor {
        name: "noise",
        title: "Noise, standard deviation of 255",
        levels: &[("5", Noise(5.0)), ("10", Noise(10.0)), ("20", Noise(20.0)), ("40", Noise(40.0))],
    },
    Factor {
        name: "exposure",
        title: "Exposure, stops",
        levels: &[
            ("-3", Exposure(-3.0)),
            ("-2", Exposure(-2.0)),
            ("-1", Exposure(-1.0)),
            ("+1", Exposure(1.0)),
            ("+2", Exposure(2.0)),
        ],
    },
    Factor {
        name: "resolution",
        title: "Resolution, pixels a side",
        levels: &[("84", Resolution(84)), ("56", Resolution(56)), ("42", Resolution(42)), ("28", Resolution(28))],
    },
    Factor {
        name: "frame_rate",
        title: "New pictures per second",
        levels: &[("12.5", FrameRate(12.5)), ("5", FrameRate(5.0)), ("2.5", FrameRate(2.5)), ("1", FrameRate(1.0))],
    },
];

/// Pictures of stores as they are.
const CLEAN: &str = "clean";
/// Tests: name and title.
const TESTS: [(&str, &str); 2] = [
    ("known", "Scenes that the network may know, unseen episodes"),
    ("ood", "The split `ood`: unseen shapes, camera and look"),
];
/// Scores in the plot: name in the JSON and title.
const DRAWN: [(&str, &str); 2] = [("frame_mean.f1", "F1, frame mean"), ("temporal_pearson", "temporal Pearson")];

/// Stores of one test, with the squares around the hands.
struct Data {
    recipes: Vec<Recipe>,
    truth: TactileSequence,
    squares: BTreeMap<std::path::PathBuf, Vec<Vec<[f32; 3]>>>,
    clean: TactileSequence,
}

/// Returns for each frame of a store the square around each hand in view: centre (x, y) and half side, as shares of the sides of its
/// square pictures.
fn squares_of(reader: &ZarrReader) -> Result<Vec<Vec<[f32; 3]>>> {
    let side = reader.image_size().1 as f64;
    let share = |Square { centre: [x, y], half }: Square| [x, y, half].map(|pixels| (pixels / side) as f32);
    let frames = crops::hand_squares(reader)?.into_iter();
    Ok(frames.map(|squares| squares.into_iter().map(share).collect()).collect())
}

/// Measures a network under all conditions.
///
/// # Errors
/// If data can't be made or read, or the network fails.
pub fn run(setup: &Setup, command: String, progress: &mut dyn FnMut(Progress)) -> Result<Report> {
    let sets = data::measured(&setup.work.join("data"), setup.size.held_out, setup.size.image, setup.size.scenes)?;
    let all: Vec<Recipe> = sets.iter().flatten().cloned().collect();
    render(&all, progress)?;
    let finished = Finished::new(setup, "decline", &all);
    let mut predictor = measure::predictor(setup)?;
    let levels = |factor: &'static Factor| {
        let first = if setup.quick { factor.levels.len() - 1 } else { 0 };
        factor.levels[first..].iter().map(move |level| (factor, level))
    };
    let conditions: Vec<(&Factor, &(&str, Degradation))> = FACTORS.iter().flat_map(levels).collect();
    let mut data = Vec::new();
    for recipes in sets {
        let clean = measure::predict(&mut predictor, &recipes, &mut |_, image| Ok(image))?;
        let squares =
            recipes.iter().map(|recipe| Ok((recipe.path.clone(), squares_of(&ZarrReader::open(&recipe.path)?)?)));
        data.push(Data { truth: force_truth(&recipes)?, squares: squares.collect::<Result<_>>()?, clean, recipes });
    }
    let mut arms = vec![finished.or_measure(CLEAN, || {
        let mut arm = condition(CLEAN.into(), "the pictures as they are".into());
        for ((name, _), data) in TESTS.iter().zip(&data) {
            arm.tests.entry((*name).into()).or_default().push(
                &data.clean,
                None,
                &data.truth,
                &options(&data.truth, None),
            )?;
        }
        Ok(arm)
    })?];
    for (done, (factor, (level, how))) in conditions.iter().enumerate() {
        progress(Progress::Measured(done, conditions.len()));
        let name = format!("{} {level}", factor.name);
        arms.push(finished.or_measure(&name.replace([' ', '%', '+', '.'], "_"), || {
            let mut arm = condition(name.clone(), format!("{}: {level}", factor.title.to_lowercase()));
            for ((name, _), data) in TESTS.iter().zip(&data) {
                let predicted = measure::predict(&mut predictor, &data.recipes, &mut degrader(*how, data))?;
                let scores = arm.tests.entry((*name).into()).or_default();
                scores.push(&predicted, Some(&data.clean), &data.truth, &options(&data.truth, None))?;
            }
            Ok(arm)
        })?);
    }
    progress(Progress::Measured(conditions.len(), conditions.len()));
    let mut blind = Vec::new();
    for ((name, _), data) in TESTS.iter().zip(&data) {
        score_blind(&mut blind, name, &baseline::constants(&data.truth), &data.truth, &options(&data.truth, None))?;
    }
    arms.extend(blind);
    let tests = TESTS.iter().zip(&data).map(|((name, title), data)| TestInfo {
        name: (*name).into(),
        title: (*title).into(),
        force: true,
        frames: data.truth.n_frames(),
        episodes: data.truth.episodes().len(),
        compared: ["frame_mean.f1", "temporal_pearson"],
    });
    Ok(Report {
        head: Head::new("decline", "Does accuracy decline gracefully as pictures get worse?", command, setup),
        parameters: parameter_count(&setup.network.geometry)?,
        differences: "from the same pictures as they are".into(),
        tests: tests.collect(),
        imported: Vec::new(),
        arms,
    })
}

/// Returns the empty row of a condition.
pub(super) fn condition(name: String, about: String) -> ArmReport {
    ArmReport { name, about, constant: false, training_frames: None, minutes: Vec::new(), tests: BTreeMap::new() }
}

/// Returns the function that degrades the frames of a test one by one, with the same random values each time.
fn degrader(how: Degradation, data: &Data) -> impl FnMut(Place, RgbImage) -> Result<RgbImage> + '_ {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut episode = Episode::draw(&mut rng);
    // Picture that stands, and when the next one is due.
    let mut standing: Option<(RgbImage, f64)> = None;
    move |place, image| {
        if place.frame == place.start {
            let number = data.recipes.iter().position(|recipe| recipe.path == place.store).unwrap_or(0) as u64;
            rng = ChaCha8Rng::seed_from_u64(SEED + 1000 * number + place.episode as u64);
            episode = Episode::draw(&mut rng);
            standing = None;
        }
        if let FrameRate(rate) = how {
            let (shown, due) = match standing.take() {
                Some((old, due)) if place.stamp < due - 1e-6 => (old, due),
                _ => (image, place.stamp + 1.0 / rate),
            };
            standing = Some((shown.clone(), due));
            return Ok(shown);
        }
        let squares = data.squares.get(place.store).and_then(|frames| frames.get(place.frame));
        Ok(how.apply(image, squares.map_or(&[][..], Vec::as_slice), &episode, &mut rng))
    }
}

/// Plot of `decline`, from its report in JSON: one panel per kind of degradation.
pub struct Plot(pub Value);

/// Writes `decline.png` and `decline.svg` into `folder`.
///
/// # Errors
/// If a file can't be written.
pub fn write_plot(folder: &Path, report: &Report) -> Result<()> {
    let json = serde_json::to_value(report).map_err(|error| Error::file(folder, error))?;
    figure::write(folder, "decline", &Plot(json))
}

impl Plot {
    /// Returns the score of a condition in a test.
    fn score(&self, condition: &str, test: &str, name: &str) -> Option<f64> {
        let arm = self.0["arms"].as_array()?.iter().find(|arm| arm["name"] == condition)?;
        score(&arm["tests"][test]["seeds"][0], name)
    }
}

impl Figure for Plot {
    const SIZE: (u32, u32) = (1200, 1120);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        let series = || DRAWN.iter().flat_map(|drawn| TESTS.iter().map(move |test| (drawn, test))).zip(PALETTE);
        let titles: Vec<String> =
            series().map(|(((_, title), (test, _)), _)| format!("{title}, {}", test_title(test))).collect();
        let keys: Vec<(&str, RGBColor)> = titles.iter().map(String::as_str).zip(PALETTE).collect();
        let panels = plot::head(root, self.0["question"].as_str().unwrap_or_default(), &keys)?.split_evenly((3, 2));
        for (panel, factor) in panels.iter().zip(&FACTORS) {
            let mut names: Vec<&str> = factor.levels.iter().map(|(level, _)| *level).collect();
            // From good to bad pictures; too dark, right, too bright.
            names.insert(names.iter().position(|level| level.starts_with('+')).unwrap_or(0), CLEAN);
            let last = names.len() as f64 - 1.0;
            let mut chart =
                plot::chart(panel, factor.title, [40, 66]).build_cartesian_2d(-0.3..last + 0.3, 0.0..1.0)?;
            plot::categories(panel, &mut chart, &names, ("score", &|y| format!("{y:.1}")))?;
            for (((name, _), (test, _)), color) in series() {
                let place = |at: usize| {
                    if names[at] == CLEAN { CLEAN.into() } else { format!("{} {}", factor.name, names[at]) }
                };
                let points: Vec<(f64, f64)> =
                    (0..names.len()).filter_map(|at| Some((at as f64, self.score(&place(at), test, name)?))).collect();
                chart.draw_series(LineSeries::new(points.iter().copied(), color.stroke_width(2)))?;
                chart.draw_series(points.into_iter().map(|point| Circle::new(point, 4, color.filled())))?;
            }
        }
        root.present()?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_a_lower_frame_rate_a_picture_stands_until_the_next_is_due() {
        let data =
            Data { recipes: vec![], truth: Default::default(), squares: BTreeMap::new(), clean: Default::default() };
        let mut degrade = degrader(FrameRate(5.0), &data);
        let shown: Vec<u8> = (0..12)
            .map(|frame| {
                // 25 pictures a second in two episodes.
                let (start, stamp) =
                    if frame < 8 { (0, f64::from(frame) * 0.04) } else { (8, f64::from(frame - 8) * 0.04) };
                let place = Place { store: Path::new("a"), episode: 0, start, frame: frame as usize, stamp };
                degrade(place, RgbImage::from_pixel(1, 1, image::Rgb([frame as u8; 3]))).unwrap().get_pixel(0, 0).0[0]
            })
            .collect();
        assert_eq!(shown, [0, 0, 0, 0, 0, 5, 5, 5, 8, 8, 8, 8]);
    }
}
