//! `egotac bench glove`.

use crate::cli::output::Output;

/// Arguments of `egotac bench glove`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes to measure in.
    #[arg(default_values = ["poke", "pinch_cube", "lift_mug"])]
    scenes: Vec<String>,
    /// Number of episodes of each scene.
    #[arg(long, default_value_t = 2)]
    seeds: u64,
    /// Seed of the first episode.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject.
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<()> {
    anyhow::ensure!(args.seeds > 0, "--seeds: expected at least 1, got 0");
    let scenes = super::load_scenes(&args.scenes)?;
    let command = format!(
        "egotac bench glove {} --seeds {} --seed {}{}",
        args.scenes.join(" "),
        args.seeds,
        args.seed,
        args.output.words()
    );
    let report = crate::glove::measure(command, &scenes, args.seed, args.seeds, &mut |what| eprintln!("{what}"))?;
    args.output.write("glove", &report, &report.markdown())?;
    args.output.folder().map_or(Ok(()), |folder| report.write_plot(folder))
}
