//! `egotac bench hard-cases`.

#[cfg(feature = "sim")]
use anyhow::{Context, ensure};
#[cfg(feature = "sim")]
use egotac::machine::Machine;
#[cfg(feature = "sim")]
use egotac::text::tell;

use crate::cli::output::Output;
#[cfg(feature = "sim")]
use crate::hard_cases::{registry, report, run as run_case};

/// Arguments of `egotac bench hard-cases`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Only cases whose name contains this.
    #[arg(long, conflicts_with = "out")]
    only: Option<String>,
    #[command(flatten)]
    output: Output,
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
        tell(format_args!("{:32} {before:>9} -> {:.2e}  {}", row.name, outcome.remedied, outcome.guard));
        if let Err(why) = outcome.verdict() {
            all_pass = false;
            tell(format_args!("{:32} FAILED: {why}", ""));
        }
        rows.push(row);
    }
    ensure!(!rows.is_empty(), "--only: expected a part of a case's name; no case has this in its name");
    let machine = Machine::this();
    args.output.write("hard-cases", &report::json(&rows, &machine), &report::markdown(&rows, &machine))?;
    Ok(all_pass)
}
