//! Experiment `transfer`: dynamics of a network's force against sensors of another make.
//!
//! The truth is measured anew by a simulated sensor with other taxels, gain or spread. Both sides are normalised by the
//! range of calibration episodes that are not scored, as in the paper, which compares relative dynamics across sensors.

use egotac::error::{Error, Result};
use egotac::model::checkpoint::parameter_count;
use egotac::score::metrics::{self, baseline};
use egotac::tactile::TactileSequence;

use super::data;
use super::decline::condition;
use super::finished::Finished;
use super::measure;
use super::recipe::Recipe;
use super::report::{Head, Report, TestInfo, force_truth, options, score_blind};
use super::sensor::Sensor;
use super::{Progress, Setup, render};

/// Sensors: name, difference in words, properties.
const SENSORS: [(&str, &str, Sensor); 5] = [
    ("same", "the simulator's label, as in training", Sensor { layout: None, spread: 0.0, gain: None }),
    (
        "gain",
        "gain 0.4 on average, and another for each vertex (log-normal, 0.4)",
        Sensor { layout: None, spread: 0.0, gain: Some((0.4, 0.4)) },
    ),
    ("spread", "forces spread by another 8 mm", Sensor { layout: None, spread: 0.008, gain: None }),
    (
        "layout",
        "96 taxels of 5 mm a hand on palm and inner side of the fingers",
        Sensor { layout: Some((96, 0.005)), spread: 0.0, gain: None },
    ),
    ("all", "all of these at once", Sensor { layout: Some((96, 0.005)), spread: 0.008, gain: Some((0.4, 0.4)) }),
];
/// Tests: name and title.
const TESTS: [(&str, &str); 2] = [
    ("known", "scenes that the network may know, unseen episodes"),
    ("ood", "the split `ood`, unseen shapes, camera and look"),
];

/// Measures a network against all sensors.
///
/// # Errors
/// If data can't be made or read, or the network fails.
pub fn run(setup: &Setup, command: String, progress: &mut dyn FnMut(Progress)) -> Result<Report> {
    if setup.size.held_out < 2 {
        return Err(Error::value("--held-out", "at least 2: one episode in three calibrates", setup.size.held_out));
    }
    let sets = data::measured(&setup.work.join("data"), setup.size.held_out, setup.size.image, setup.size.scenes)?;
    let all: Vec<Recipe> = sets.iter().flatten().cloned().collect();
    render(&all, progress)?;
    let finished = Finished::new(setup, "transfer", &all);
    let mut predictor = measure::predictor(setup)?;
    let (mut tests, mut arms, mut blind) = (Vec::new(), Vec::new(), Vec::new());
    let mut done = 0;
    for ((test, title), recipes) in TESTS.iter().zip(&sets) {
        let (calibrating, scored) = split(&force_truth(recipes)?);
        let predicted = measure::predict(&mut predictor, recipes, &mut |_, image| Ok(image))?;
        let [calibrating, scored] = [&calibrating, &scored].map(|frames| {
            let truth = force_truth(recipes).map(|truth| truth.select(frames.iter().copied()));
            truth.map(|truth| (truth, predicted.select(frames.iter().copied())))
        });
        let ((calibrating_truth, calibrating_predicted), (truth, predicted)) = (calibrating?, scored?);
        tests.push(TestInfo {
            name: (*test).into(),
            title: format!("Truth by the sensor; {title}"),
            force: true,
            frames: truth.n_frames(),
            episodes: truth.episodes().len(),
            compared: ["force_cosine", "rise_f1"],
        });
        for (at, (name, about, sensor)) in SENSORS.iter().enumerate() {
            progress(Progress::Measured(done, TESTS.len() * SENSORS.len()));
            done += 1;
            let measured = finished.or_measure(&format!("{test}_{name}"), || {
                let read = sensor.read(&truth);
                // Any constant has the same normalised trace; this one is the mean force of each vertex.
                let [_, constant, ..] = baseline::constants(&read);
                let calibration = metrics::calibrate(&calibrating_predicted, &sensor.read(&calibrating_truth))?;
                let options = options(&read, Some(calibration));
                let mut arm = condition((*name).into(), (*about).into());
                let constant = constant.sequence(read.n_frames());
                let scores = arm.tests.entry((*test).into()).or_default();
                scores.push(&predicted, Some(&constant), &read, &options)?;
                Ok(arm)
            })?;
            match arms.get_mut(at) {
                None => arms.push(measured),
                Some(arm) => arm.tests.extend(measured.tests),
            }
        }
        let calibration = metrics::calibrate(&calibrating_predicted, &calibrating_truth)?;
        score_blind(&mut blind, test, &baseline::constants(&truth), &truth, &options(&truth, Some(calibration)))?;
    }
    arms.extend(blind);
    progress(Progress::Measured(done, done));
    Ok(Report {
        head: Head::new(
            "transfer",
            "Do the dynamics of predicted force hold for sensors with another layout, gain and spread?",
            command,
            setup,
        ),
        parameters: parameter_count(&setup.network.geometry)?,
        differences: "from a constant prediction, the mean force of each vertex, against the same truth".into(),
        tests,
        imported: Vec::new(),
        arms,
    })
}

/// Returns the frames of the calibration episodes, every `n`-th one, and of the others.
fn split(truth: &TactileSequence) -> (Vec<usize>, Vec<usize>) {
    let (mut calibrating, mut scored) = (Vec::new(), Vec::new());
    for (index, episode) in truth.episodes().into_iter().enumerate() {
        let of = if index % CALIBRATING == 0 { &mut calibrating } else { &mut scored };
        of.extend(episode);
    }
    (calibrating, scored)
}

/// One episode of this many calibrates.
const CALIBRATING: usize = 3;

#[cfg(test)]
mod tests {
    use egotac::tactile::N_FIELD;

    use super::*;

    #[test]
    fn calibration_episodes_are_not_scored() {
        let mut truth = TactileSequence::from_force(None, vec![0.0; 10 * N_FIELD]);
        truth.episode_ends = vec![2, 5, 6, 10];
        assert_eq!(split(&truth), (vec![0, 1, 6, 7, 8, 9], vec![2, 3, 4, 5]));
    }
}
