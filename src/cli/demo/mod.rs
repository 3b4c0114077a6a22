//! `egotac demo`: runs simulator, predictor and verifier end to end.

#[cfg(feature = "ros")]
mod bag;
#[cfg(feature = "ros")]
mod children;
#[cfg(feature = "ros")]
mod figure;
#[cfg(feature = "ros")]
mod report;
#[cfg(feature = "ros")]
mod run;
#[cfg(feature = "ros")]
mod topics;

use std::path::PathBuf;
use std::process::ExitCode;

use super::options::Time;

/// Arguments of `egotac demo`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for report, picture and recording; files of an earlier demo are replaced.
    #[arg(long, default_value = "out/demo")]
    out: PathBuf,
    /// Simulated time.
    #[arg(long, value_name = "TIME", default_value = "15s")]
    duration: Time,
    /// Seed of the first rollout; the shipped checkpoint was trained and chosen on seeds below 900000.
    #[arg(long, default_value_t = 900_000)]
    seed: u64,
    /// Scenes, in turn.
    #[arg(long, value_delimiter = ',', default_value = "pinch_cube,lift_mug,hover")]
    scenes: Vec<String>,
    /// Checkpoint for the predictor; by default the one shipped with egotac.
    #[arg(long, value_name = "FILE|shipped", value_parser = super::options::checkpoint())]
    checkpoint: Option<PathBuf>,
}

#[cfg(feature = "ros")]
impl Args {
    /// Returns the command line that reproduces the run.
    fn command(&self) -> String {
        let checkpoint = self.checkpoint.as_ref();
        let checkpoint = checkpoint.map(|path| format!(" --checkpoint {}", path.display())).unwrap_or_default();
        let Self { duration, seed, scenes, .. } = self;
        format!("egotac demo --duration {duration} --seed {seed} --scenes {}{checkpoint}", scenes.join(","))
    }
}

/// Runs the command.
///
/// # Errors
/// If a node can't be started or fails, or the report can't be written.
#[cfg(feature = "ros")]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    run::run(&args)
}

/// Fails and names the missing feature.
///
/// # Errors
/// Always.
#[cfg(not(feature = "ros"))]
pub fn run(_: Args) -> anyhow::Result<ExitCode> {
    Err(super::feature_off("demo", "ros,sim"))
}
