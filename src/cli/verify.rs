//! `egotac verify`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{bail, ensure};

use super::hands::{Hands, Kernel};
use super::options::{Json, Length};
use crate::file;
use crate::score::verify::recording::{self, Topics};
use crate::score::verify::report::{self, Unmatched};
use crate::score::verify::{Candidate, Requirement, SweepSettings, VerifyReport, picture};
use crate::text::{printable, tell};

/// Arguments of `egotac verify`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Truth is the force of the simulator's contacts on the vertices (label c); a vertex is touched above \
    0.05 N. Without predictions, labels a (a point of the resampled surface within a distance) and b (the surface within \
    it) are swept over distances.\nScores that can be required: precision, recall, f1, iou (at least), missed_force, \
    false_contact_mass, missed_touches, false_touches, onset_error_secs, offset_error_secs, mae, active_mae, \
    link_force_error, cop_distance_mm, false_positive_rate (at most). precision, recall, f1 and iou are means over frames \
    with touch, as in the paper; pooled_f1 and so on are over all vertices of all frames; b_5mm:f1=0.6 is for one of several \
    labels. The exit status is 1 if a required score is missed."
)]
pub struct Args {
    /// Scenes to simulate (a name from `egotac sim list`, or a YAML file), or stores written by `egotac sim run` or
    /// `generate`.
    #[arg(value_name = "SCENE|EPISODE", required_unless_present = "recording", conflicts_with = "recording")]
    sources: Vec<String>,
    /// Rollouts of each scene.
    #[arg(long, value_name = "N", default_value_t = 3)]
    seeds: u64,
    /// Seed of each scene's first rollout (each next rollout has the next seed) and of the bootstrap.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Distances of labels a and b.
    #[arg(long, value_name = "LENGTH,..", value_delimiter = ',', default_value = "0mm,1mm,2mm,5mm,10mm")]
    thresholds: Vec<Length>,
    /// Spacing of the points of label a.
    #[arg(long, value_name = "LENGTH", default_value = "6mm")]
    spacing: Length,
    /// YAML files of scenes that the program does not ship and that the stores were made from.
    #[arg(long, value_name = "FILE", num_args = 1..)]
    scene: Vec<PathBuf>,
    /// Checkpoint to score instead of the labels, on rendered images.
    #[arg(long, value_name = "FILE|shipped", value_parser = super::options::checkpoint(), conflicts_with_all = ["predictions", "recording"])]
    checkpoint: Option<PathBuf>,
    /// Predictions to score instead of the labels: tensor files or stores with the same frames as the given stores.
    #[arg(long, value_name = "STORE|FILE", num_args = 1.., conflicts_with = "recording")]
    predictions: Vec<PathBuf>,
    /// Bag or MCAP file with predictions (TactileFrame) and truth (TactileTruth) to score.
    #[arg(long, value_name = "BAG")]
    recording: Option<PathBuf>,
    /// Topic of the predictions, if the recording has several.
    #[arg(long, value_name = "TOPIC", requires = "recording")]
    tactile_topic: Option<String>,
    /// Topic of the truth, if the recording has several.
    #[arg(long, value_name = "TOPIC", requires = "recording")]
    truth_topic: Option<String>,
    /// Scores to reach, such as `f1=0.7,missed_force=0.2`.
    #[arg(long, value_name = "NAME=NUMBER,..")]
    require: Option<String>,
    #[command(flatten)]
    json: Json,
    /// PNG file to draw.
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Folder for verify.md, verify.json and verify.png.
    #[arg(long, value_name = "FOLDER", conflicts_with_all = ["json", "picture"])]
    out: Option<PathBuf>,
    /// Width and height of the images for a predictor, pixels.
    #[arg(long, default_value_t = 224)]
    size: u32,
    /// Rollouts that run at the same time (always one with a predictor).
    #[arg(long, default_value_t = 2)]
    jobs: usize,
    #[command(flatten)]
    kernel: Kernel,
    #[command(flatten)]
    hands: Hands,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    // Validates all arguments first: scoring may take hours.
    let requirements = Requirement::parse_all(args.require.as_deref().unwrap_or_default())?;
    let settings = settings(&args)?;
    let candidates = match args.recording.is_some() || args.checkpoint.is_some() || !args.predictions.is_empty() {
        true => Candidate::PREDICTIONS.to_vec(),
        false => settings.sweep(),
    };
    check_candidates(&requirements, &candidates)?;
    let report = match &args.recording {
        Some(recording) => score_recording(&args, recording)?,
        None => score_sources(&args, &settings, &candidates)?,
    };
    write(&args, &report)?;
    gate(&requirements, &report)
}

/// Writes the requested files; prints the table unless JSON goes to standard output.
fn write(args: &Args, report: &VerifyReport) -> anyhow::Result<()> {
    let json = serde_json::to_value(report)?;
    let table = report::table(report);
    args.json.show(&json, || table.clone())?;
    let in_folder = |name: &str| args.out.as_ref().map(|folder| folder.join(name));
    if let Some(path) = in_folder("verify.json") {
        file::write(&path, format!("{json:#}\n").as_bytes())?;
    }
    if let Some(path) = args.picture.clone().or(in_folder("verify.png")) {
        file::write_png(&path, &picture::draw(report)?)?;
    }
    if let Some(path) = in_folder("verify.md") {
        let words: Vec<String> = std::env::args().skip(1).collect();
        let text = format!(
            "# Labels and predictions against contact forces\n\nWritten by `egotac {}` (egotac {}). Numbers: \
             `verify.json`.\n\n![Scores over the distance that counts as touch](verify.png)\n\nColumns of the plot: `c` is contact by \
             force, `a` and `b` are labels by distance to points of the surface and to the surface itself, up to the given distance.\n\n```\n{table}\n```\n",
            words.join(" "),
            env!("CARGO_PKG_VERSION"),
        );
        file::write(&path, text.as_bytes())?;
    }
    Ok(())
}

fn settings(args: &Args) -> anyhow::Result<SweepSettings> {
    let thresholds = args.thresholds.iter().map(|length| length.0 as f32).collect();
    let settings = SweepSettings { thresholds, spacing: args.spacing.0 as f32 };
    settings.check()?;
    ensure!(args.seeds > 0, "--seeds: expected at least 1");
    ensure!(args.jobs > 0, "--jobs: expected at least 1");
    Ok(settings)
}

/// Checks that each requirement names one of the candidates, if there are several labels; a prediction needs no name.
fn check_candidates(requirements: &[Requirement], candidates: &[Candidate]) -> anyhow::Result<()> {
    let names: Vec<String> = candidates.iter().map(|candidate| candidate.name()).collect();
    for requirement in requirements {
        match &requirement.candidate {
            None if names.len() > 1 && !candidates.contains(&Candidate::Prediction) => bail!(
                "--require: {} of which label? Expected LABEL:NAME=NUMBER, with one of {}",
                requirement.score.name,
                names.join(", ")
            ),
            Some(name) if !names.contains(name) => {
                return Err(crate::Error::unknown("label", name, names.iter().map(String::as_str)).into());
            }
            _ => {}
        }
    }
    Ok(())
}

/// Prints the requirements that are missed; returns failure if there is one.
fn gate(requirements: &[Requirement], report: &VerifyReport) -> anyhow::Result<ExitCode> {
    let mut status = ExitCode::SUCCESS;
    for requirement in requirements {
        let candidate = report.candidate(requirement.candidate.as_deref())?;
        let value = candidate.scores.get(requirement.score.name).and_then(|scored| scored.value);
        if let Some(missed) = requirement.missed(value) {
            tell(format_args!("egotac: {}", printable(&format!("{}: {missed}", candidate.name))));
            status = ExitCode::FAILURE;
        }
    }
    Ok(status)
}

fn score_recording(args: &Args, path: &Path) -> anyhow::Result<VerifyReport> {
    let topics = Topics { tactile: args.tactile_topic.clone(), truth: args.truth_topic.clone() };
    let recording = recording::score(path, &topics, args.hands.files()?.as_ref())?;
    let mut report = VerifyReport::new(&Candidate::PREDICTIONS, &recording.groups, &recording.episodes, args.seed)?;
    let (predictions, truths) = (recording.unmatched_predictions, recording.unmatched_truths);
    report.unmatched = Some(Unmatched { predictions, truths });
    Ok(report)
}

#[cfg(not(feature = "sim"))]
fn score_sources(_: &Args, _: &SweepSettings, _: &[Candidate]) -> anyhow::Result<VerifyReport> {
    Err(super::feature_off("verify", "sim"))
}

#[cfg(feature = "sim")]
use with_sim::score_sources;

#[cfg(feature = "sim")]
mod with_sim {
    use std::path::{Path, PathBuf};

    use anyhow::ensure;
    use rayon::prelude::*;

    use super::Args;
    use crate::cli::sim::{load, picture};
    use crate::dataset::zarr::{self, ZarrReader};
    use crate::model::{Predictor, predictor};
    use crate::score::agreement::VertexGroups;
    use crate::score::verify::{Candidate, Episode, SweepSettings, VerifyReport, predictions};
    use crate::sim::verify::store::EstimateSource;
    use crate::sim::verify::{rollout, store};
    use crate::sim::{RolloutOptions, Scene};

    pub fn score_sources(
        args: &Args,
        settings: &SweepSettings,
        candidates: &[Candidate],
    ) -> anyhow::Result<VerifyReport> {
        let (stores, scenes): (Vec<&String>, Vec<&String>) =
            args.sources.iter().partition(|source| Path::new(source).is_dir());
        let paths: Vec<PathBuf> = stores.into_iter().map(PathBuf::from).collect();
        let stores = zarr::open_all(&paths)?;
        let scenes = scenes.into_iter().map(|name| load(name)).collect::<anyhow::Result<Vec<_>>>()?;
        let hands = args.hands.models()?;
        let mut predictor = open_predictor(args)?;

        let mut episodes = score_stores(args, settings, &stores, &hands, predictor.as_mut())?;
        let picture = match &predictor {
            Some(_) => picture(args.size)?,
            None => None,
        };
        let options =
            RolloutOptions { hands: hands.clone(), picture, sigma: args.kernel.metres(), ..RolloutOptions::default() };
        let plan: Vec<(&Scene, u64)> =
            scenes.iter().flat_map(|scene| (0..args.seeds).map(move |i| (scene, args.seed + i))).collect();
        let bar = crate::cli::progress::bar("rollouts");
        bar.set_length(plan.len() as u64);
        let done = |result| {
            bar.inc(1);
            result
        };
        let rollouts: Vec<crate::Result<Episode>> = match &mut predictor {
            // The network alone uses all cores.
            Some(predictor) => plan
                .iter()
                .map(|(scene, seed)| done(rollout::score(scene, *seed, &options, settings, Some(predictor))))
                .collect(),
            None => rayon::ThreadPoolBuilder::new().num_threads(args.jobs).build()?.install(|| {
                let score = |(scene, seed): &(&Scene, u64)| rollout::score(scene, *seed, &options, settings, None);
                plan.par_iter().map(|rollout| done(score(rollout))).collect()
            }),
        };
        bar.finish_and_clear();
        for episode in rollouts {
            episodes.push(episode?);
        }
        Ok(VerifyReport::new(candidates, &VertexGroups::links(&hands), &episodes, args.seed)?)
    }

    fn open_predictor(args: &Args) -> anyhow::Result<Option<Predictor>> {
        let Some(path) = &args.checkpoint else { return Ok(None) };
        let predictor = Predictor::load(path, predictor::Options::default())?;
        crate::cli::progress::tell_network(path, &predictor);
        Ok(Some(predictor))
    }

    fn score_stores(
        args: &Args,
        settings: &SweepSettings,
        stores: &[ZarrReader],
        hands: &[crate::hand::HandModel; 2],
        mut predictor: Option<&mut Predictor>,
    ) -> anyhow::Result<Vec<Episode>> {
        let given = args.scene.iter().map(|path| Scene::load(&path.to_string_lossy()));
        let given = given.collect::<crate::Result<Vec<_>>>()?;
        let predicted = match args.predictions.is_empty() {
            true => None,
            false => {
                ensure!(
                    !stores.is_empty() && args.sources.iter().all(|source| Path::new(source).is_dir()),
                    "--predictions: expected the stores that they are for, and no scene"
                );
                Some(predictions::read(&args.predictions, stores)?)
            }
        };
        let mut first_frame = 0;
        let mut episodes = Vec::new();
        for reader in stores {
            let source = match (&mut predictor, &predicted) {
                (Some(predictor), _) => EstimateSource::Predictor(predictor),
                (None, Some(predicted)) => EstimateSource::Predictions(predicted, first_frame),
                (None, None) => EstimateSource::Labels(&given),
            };
            episodes.extend(store::score(reader, hands, settings, source)?);
            first_frame += reader.len();
        }
        Ok(episodes)
    }
}
