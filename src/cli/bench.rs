//! `egotac bench`: what accuracy costs and what breaks, measured on this machine.

use std::path::PathBuf;
use std::process::ExitCode;

/// Arguments of `egotac bench`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    subject: Subject,
}

#[derive(Debug, clap::Subcommand)]
enum Subject {
    /// What goes wrong, what the guards say, and what helps: every hard case in three runs.
    HardCases(HardCases),
    /// What the guards cost: a step with and without them.
    Guards(Guards),
}

#[derive(Debug, clap::Args)]
struct HardCases {
    /// Folder for `hard-cases.md` and `hard-cases.json`; without it, only the verdicts are printed.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Only cases whose name contains this.
    #[arg(long, conflicts_with = "out")]
    only: Option<String>,
}

#[derive(Debug, clap::Args)]
struct Guards {
    /// Scenes to measure in.
    #[arg(default_values = ["pinch_cube", "lift_mug", "hover"])]
    scenes: Vec<String>,
    /// Measurements of each kind; the least counts.
    #[arg(long, default_value_t = 2000)]
    rounds: usize,
    /// JSON file to write.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// Runs the command.
#[cfg(not(feature = "sim"))]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let name = match args.subject {
        Subject::HardCases(_) => "bench hard-cases",
        Subject::Guards(_) => "bench guards",
    };
    Err(super::feature_off(name, "sim"))
}

/// Runs the command; the exit status is 1 if a case fails silently or the guards cost more than they may.
#[cfg(feature = "sim")]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let good = match args.subject {
        Subject::HardCases(args) => with_sim::hard_cases(&args)?,
        Subject::Guards(args) => with_sim::guards(&args)?,
    };
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(feature = "sim")]
mod with_sim {
    use anyhow::{Context, ensure};

    use super::{Guards, HardCases};
    use crate::bench::hard_cases::{registry, report, run};
    use crate::bench::{Machine, guards};
    use crate::file;

    pub fn hard_cases(args: &HardCases) -> anyhow::Result<bool> {
        let wanted = |name: &str| args.only.as_ref().is_none_or(|part| name.contains(part.as_str()));
        let mut rows = Vec::new();
        let mut good = true;
        for case in registry().iter().filter(|case| wanted(case.name)) {
            let row = run(case).with_context(|| format!("case {}", case.name))?;
            let outcome = &row.outcome;
            let verdict = outcome.verdict();
            let before = outcome.unguarded.map_or("refused".into(), |error| format!("{error:.2e}"));
            println!("{:32} {before:>9} -> {:.2e}  {}", row.name, outcome.remedied, outcome.guard);
            if let Err(why) = verdict {
                good = false;
                println!("{:32} FAILED: {why}", "");
            }
            rows.push(row);
        }
        ensure!(!rows.is_empty(), "--only: no case has that in its name");
        if let Some(folder) = &args.out {
            let machine = Machine::this();
            file::write(&folder.join("hard-cases.md"), report::markdown(&rows, &machine).as_bytes())?;
            let json = serde_json::to_string_pretty(&report::json(&rows, &machine))?;
            file::write(&folder.join("hard-cases.json"), json.as_bytes())?;
            println!("wrote {0}/hard-cases.md and {0}/hard-cases.json", folder.display());
        }
        Ok(good)
    }

    pub fn guards(args: &Guards) -> anyhow::Result<bool> {
        ensure!(args.rounds > 0, "--rounds: expected at least 1, got 0");
        let scenes: Vec<&str> = args.scenes.iter().map(String::as_str).collect();
        let prices = guards::measure(&scenes, args.rounds)?;
        println!(
            "{:16} {:>8} {:>9} {:>9} {:>9} {:>7}",
            "scene", "contacts", "step us", "guard us", "frame us", "share"
        );
        for price in &prices.scenes {
            let (step, guard, frame) = (price.step_us, price.guard_us, price.frame_us);
            let percent = 100.0 * price.share;
            println!("{:16} {:8} {step:9.2} {guard:9.2} {frame:9.2} {percent:6.2}%", price.scene, price.contacts);
        }
        if let Some(out) = &args.out {
            file::write(out, serde_json::to_string_pretty(&prices)?.as_bytes())?;
            println!("wrote {}", out.display());
        }
        let most = prices.scenes.iter().map(|price| price.share).fold(0.0, f64::max);
        if most > guards::BUDGET {
            println!("guards cost {:.1} %, allowed are {:.0} %", 100.0 * most, 100.0 * guards::BUDGET);
        }
        Ok(most <= guards::BUDGET)
    }
}
