//! `egotac bench node`.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use egotac::cli::options::Time;

use crate::cli::output::Output;
use crate::node::{self, MEASUREMENTS, Options};

/// Arguments of `egotac bench node`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Takes about 15 minutes with the soak of 10. The nodes' programs must lie beside this one, and EGOTAC_PYTHON (env.sh) must name a \
    Python with rclpy. The exit status is 1 if a goal is missed; beside other work (the report says so) missed times do not count."
)]
pub struct Args {
    /// Take short measurements, as the tests do.
    #[arg(long)]
    short: bool,
    /// Only these measurements, comma separated: overhead, overload, soak, faults, kills.
    #[arg(long, value_name = "NAME", value_delimiter = ',')]
    only: Vec<String>,
    /// Length of the soak, such as 90s, 10min or 1h [default: 10min]. Growth of memory is judged after a
    /// warm-up of two minutes, in soaks of four minutes and longer.
    #[arg(long, value_name = "TIME", value_parser = duration)]
    soak: Option<Time>,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject; false if a goal is missed.
pub fn run(args: &Args) -> anyhow::Result<bool> {
    let unknown = args.only.iter().find(|name| !MEASUREMENTS.contains(&name.as_str()));
    ensure!(unknown.is_none(), "--only: expected {}, got {unknown:?}", MEASUREMENTS.join(", "));
    let python = std::env::var_os("EGOTAC_PYTHON").context("EGOTAC_PYTHON is not set: source env.sh first")?;
    let folder = tempfile::tempdir()?;
    let program = std::env::current_exe().context("path of this program")?;
    let soak_secs = args.soak.map_or(if args.short { 20.0 } else { 600.0 }, |time| time.0);
    let options = Options {
        programs: program.parent().map(PathBuf::from).unwrap_or_default(),
        python: python.into(),
        folder: folder.path().to_path_buf(),
        only: match args.only.is_empty() {
            true => MEASUREMENTS.map(str::to_owned).to_vec(),
            false => args.only.clone(),
        },
        secs: if args.short { 4.0 } else { 30.0 },
        soak_secs,
    };
    let words: Vec<String> = std::env::args().skip(1).collect();
    let report = node::measure(&options, format!("egotac {}", words.join(" ")), |name| eprintln!("measuring: {name}"))?;
    args.output.write("node", &report, &report.markdown())?;
    Ok(report.is_good())
}

/// Parses the length of the soak.
fn duration(text: &str) -> Result<Time, String> {
    let time = text.parse::<Time>().ok().filter(|time| (10.0..=1e6).contains(&time.0));
    time.ok_or_else(|| format!("expected a time of 10 seconds or more such as 90s, 10min or 1h, got {text:?}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_with_their_units() {
        let secs = ["600", "90s", "10min", "1h", "1.5h"].map(|text| duration(text).unwrap().0);
        assert_eq!(secs, [600.0, 90.0, 600.0, 3600.0, 5400.0]);
        for wrong in ["", "m", "5s", "-1h", "1d", "nan", "1e9"] {
            assert!(duration(wrong).unwrap_err().contains(&format!("{wrong:?}")), "{wrong}");
        }
    }
}
