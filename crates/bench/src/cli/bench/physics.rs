//! `egotac bench physics`.

use std::path::PathBuf;

use crate::cli::output::Output;

/// Arguments of `egotac bench physics`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes to measure in; by default all.
    scenes: Vec<String>,
    /// Number of episodes of each scene.
    #[arg(long, default_value_t = 1)]
    seeds: u64,
    /// Seed of the first episode.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Median of the ratio between the force of a grip and the least one that holds; by default that of `label --physics`.
    #[arg(long)]
    grip: Option<f64>,
    /// Standard deviation of the logarithm of this ratio's excess over 1.
    #[arg(long)]
    grip_spread: Option<f64>,
    /// Force at which a hand takes hold of what something else carries, relative to the force that would hold it.
    #[arg(long)]
    early_grip: Option<f64>,
    /// Factor on the widths of intervals.
    #[arg(long)]
    inflation: Option<f64>,
    /// Folder for the bodies and links behind the tables, as CSV files.
    #[arg(long, value_name = "FOLDER")]
    rows: Option<PathBuf>,
    /// Command that solves the same problems with another solver, such as `python crates/bench/benches/solver_peer.py`.
    #[arg(long, value_name = "COMMAND")]
    solver_peer: Option<String>,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject.
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<()> {
    use egotac::text::tell;

    anyhow::ensure!(args.seeds > 0, "--seeds: expected at least 1, got 0");
    let scenes = super::load_scenes(&args.scenes)?;
    let names: String = args.scenes.iter().map(|scene| format!("{scene} ")).collect();
    let peer = args.solver_peer.as_ref().map(|peer| format!(" --solver-peer {peer:?}")).unwrap_or_default();
    let (Args { seeds, seed, .. }, out) = (args, args.output.words());
    let command = format!("egotac bench physics {names}--seeds {seeds} --seed {seed}{peer}{out}");
    let seeds = args.seed..args.seed + args.seeds;
    let usual = egotac::physics::Settings::default();
    let settings = egotac::physics::Settings {
        grip: args.grip.unwrap_or(usual.grip),
        grip_spread: args.grip_spread.unwrap_or(usual.grip_spread),
        early_grip: args.early_grip.unwrap_or(usual.early_grip),
        inflation: args.inflation.unwrap_or(usual.inflation),
        ..usual
    };
    if let Some(folder) = &args.rows {
        std::fs::create_dir_all(folder)?;
    }
    let told = |what: &str| tell(format_args!("{what}"));
    let report = crate::physics::measure(
        command,
        &scenes,
        seeds,
        settings,
        args.rows.as_deref(),
        args.solver_peer.as_deref(),
        &told,
    )?;
    args.output.write("physics", &report, &report.markdown())?;
    args.output.folder().map_or(Ok(()), |folder| report.write_plots(folder))
}
