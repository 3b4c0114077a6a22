//! `egotac bench hard-cases`.

use std::path::PathBuf;

#[cfg(feature = "sim")]
use anyhow::{Context, ensure};
#[cfg(feature = "sim")]
use egotac::machine::Machine;

#[cfg(feature = "sim")]
use crate::hard_cases::{registry, report, run as run_case};

/// Arguments of `egotac bench hard-cases`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for `hard-cases.md` and `hard-cases.json`; without it, only the verdicts are printed.
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Only cases whose name contains this.
    #[arg(long, conflicts_with = "out")]
    only: Option<String>,
}

/// Runs the subject; false if a case fails silently.
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<bool> {
    let is_wanted = |name: &str| args.only.as_ref().is_none_or(|part| name.contains(part.as_str()));
    let mut rows = Vec::new();
    let mut all_pass = true;
    for case in registry().iter().filter(|case| is_wanted(case.name)) {
        let row = run_case(case).with_context(|| format!("case {}", case.name))?;
        let outcome = &row.outcome;
        let before = outcome.unguarded.map_or("refused".into(), |error| format!("{error:.2e}"));
        println!("{:32} {before:>9} -> {:.2e}  {}", row.name, outcome.remedied, outcome.guard);
        if let Err(why) = outcome.verdict() {
            all_pass = false;
            println!("{:32} FAILED: {why}", "");
        }
        rows.push(row);
    }
    ensure!(!rows.is_empty(), "--only: expected a part of a case's name; no case has this in its name");
    if let Some(folder) = &args.out {
        let machine = Machine::this();
        egotac::file::write(&folder.join("hard-cases.md"), report::markdown(&rows, &machine).as_bytes())?;
        let json = serde_json::to_string_pretty(&report::json(&rows, &machine))?;
        egotac::file::write(&folder.join("hard-cases.json"), json.as_bytes())?;
        println!("wrote {0}/hard-cases.md and {0}/hard-cases.json", folder.display());
    }
    Ok(all_pass)
}
