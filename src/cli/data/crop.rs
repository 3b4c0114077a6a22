//! `egotac data crop`.

use std::path::PathBuf;
use std::process::ExitCode;

use crate::train::crops;

/// Arguments of `egotac data crop`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Every hand in view becomes an episode: its square of each picture, a left hand mirrored, with its labels in the \
    place of the right hand. A network that is trained on such stores sees single hands (`input: hands`): where it is used, a network \
    of whole pictures, --locator, finds the hands."
)]
pub struct Args {
    /// Store of whole pictures with poses of camera and hands, as `egotac sim generate` writes it.
    #[arg(value_name = "STORE")]
    source: PathBuf,
    /// Store to write.
    #[arg(long, value_name = "STORE")]
    out: PathBuf,
    /// Side of the squares in the new store, pixels.
    #[arg(long, value_name = "PIXELS", default_value_t = 112, value_parser = clap::value_parser!(u32).range(14..=1024))]
    size: u32,
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let Args { source, out, size } = args;
    let pictures = crops::write(&source, &out, size, "egotac data crop")?;
    println!("wrote {pictures} pictures of single hands, {size} x {size} pixels, to {}", out.display());
    Ok(ExitCode::SUCCESS)
}
