//! `egotac bench retarget`.

use crate::cli::output::Output;
#[cfg(feature = "sim")]
use crate::retarget::{Plan, plot, run as measure, table};

/// Arguments of `egotac bench retarget`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Robots (a name of `egotac retarget list`, a YAML file or a model); without them, those of the program whose models
    /// are part of it.
    robots: Vec<String>,
    /// Frames of the trajectory.
    #[arg(long, default_value_t = 10_000, value_parser = clap::value_parser!(u64).range(100..=1_000_000))]
    frames: u64,
    /// Seed of the trajectory and its noise.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Command that runs a peer on the same vectors, such as `python crates/bench/benches/retarget_peer.py --peer dexi-rs`; repeatable.
    #[arg(long, value_name = "COMMAND")]
    peer: Vec<String>,
    /// Other load of the machine, in words, for the table.
    #[arg(long, value_name = "TEXT")]
    load: Option<String>,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject.
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<()> {
    let bar = egotac::cli::progress::spinner("measuring");
    let report = measure(&plan(args), |what| bar.set_message(what.to_owned()))?;
    bar.finish_and_clear();
    args.output.write("retarget", &report, &table::markdown(&report))?;
    if let Some(folder) = args.output.folder() {
        plot::write(folder, &report)?;
    }
    Ok(())
}

#[cfg(feature = "sim")]
fn plan(args: &Args) -> Plan {
    use egotac::retarget::robot::source;
    let robots = match args.robots.is_empty() {
        true => source::names().filter(|name| source::has_own_model(name)).map(str::to_owned).collect(),
        false => args.robots.clone(),
    };
    let mut words = vec!["egotac bench retarget".to_owned()];
    words.extend(args.robots.iter().cloned());
    words.push(format!("--frames {} --seed {}", args.frames, args.seed));
    words.extend(args.peer.iter().map(|peer| format!("--peer {peer:?}")));
    Plan {
        command: words.join(" ") + &args.output.words(),
        robots,
        frames: args.frames as usize,
        seed: args.seed,
        peers: args.peer.clone(),
        load: args.load.clone(),
    }
}
