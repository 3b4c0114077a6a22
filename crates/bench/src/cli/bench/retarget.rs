//! `egotac bench retarget`.

use std::path::PathBuf;

use egotac::cli::options::Json;

#[cfg(feature = "sim")]
use crate::cli::write_report;
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
    json: Json,
    /// Folder for retarget.md, retarget.json, retarget.png and retarget.svg.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
}

/// Runs the subject.
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<()> {
    let bar = egotac::cli::progress::spinner("measuring");
    let report = measure(&plan(args), |what| bar.set_message(what.to_owned()))?;
    bar.finish_and_clear();
    let table = table::markdown(&report);
    args.json.show(&serde_json::to_value(&report)?, || table.clone())?;
    if let Some(folder) = &args.out {
        write_report(folder, "retarget", &report, &table)?;
        plot::write(folder, &report)?;
        egotac::text::tell(format_args!("wrote {0}/retarget.md and {0}/retarget.json", folder.display()));
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
        command: words.join(" "),
        robots,
        frames: args.frames as usize,
        seed: args.seed,
        peers: args.peer.clone(),
        load: args.load.clone(),
    }
}
