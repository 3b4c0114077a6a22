//! `egotac data`.

mod crop;
mod diff;
mod import;
mod info;
mod store_info;

use std::path::PathBuf;
use std::process::ExitCode;

use super::options::Json;

/// Arguments of `egotac data`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Describe stores, bags, LeRobot data sets, videos, folders of images and tensor files: their content and the origin of
    /// their labels.
    Info {
        /// Recordings; a folder of stores stands for its stores.
        #[arg(required = true, value_name = "PATH")]
        paths: Vec<PathBuf>,
        #[command(flatten)]
        json: Json,
    },
    /// Compare two labelled data sets, frame by frame, under the scores of `egotac eval`.
    Diff(diff::Args),
    /// Turn data sets of hands and objects into stores: images, contact by distance, poses.
    Import(import::Args),
    /// Cut squares around the hands out of a store, for training a network that sees single hands.
    Crop(crop::Args),
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    match args.command {
        Command::Info { paths, json } => info::run(&paths, &json),
        Command::Diff(args) => diff::run(args),
        Command::Import(args) => import::run(args),
        Command::Crop(args) => crop::run(args),
    }
}
