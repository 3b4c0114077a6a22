//! `egotac report`.

use std::path::PathBuf;
use std::process::ExitCode;

use super::hands::Hands;
use crate::file;
use crate::report::{PageSettings, html};

/// Arguments of `egotac report`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Labelled data set: a store, bag, .mcap file, LeRobot data set or tensor file.
    labels: PathBuf,
    /// HTML file to write; by default the name of the labels with .html added.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Number of sample frames.
    #[arg(long, value_name = "N", default_value_t = 12)]
    frames: usize,
    /// Largest number of episodes whose force over time is plotted.
    #[arg(long, value_name = "N", default_value_t = 24)]
    episodes: usize,
    #[command(flatten)]
    hands: Hands,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let settings = PageSettings { frames: args.frames, episodes: args.episodes, hands: args.hands.files()? };
    let out = args.out.unwrap_or_else(|| {
        let mut out = args.labels.clone().into_os_string();
        out.push(".html");
        out.into()
    });
    file::write(&out, html(&args.labels, &settings)?.as_bytes())?;
    println!("{}", out.display());
    Ok(ExitCode::SUCCESS)
}
