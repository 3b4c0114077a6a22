//! `egotac doctor`: what is installed, and how to fix what is not.

mod checks;
mod gl;
#[cfg_attr(not(feature = "ros"), allow(dead_code, reason = "the build script uses it for feature `ros`"))]
mod idl_hash;

use std::process::ExitCode;

use serde::Serialize;

/// Arguments of `egotac doctor`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// The hand to check: `builtin`, or a MANO file (.pkl or .npz) of the right hand.
    #[arg(long, value_name = "builtin|PATH", default_value = "builtin")]
    hand: String,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Print the OpenGL renderer's name; the table asks a second process, since OpenGL can end the one it fails in.
    #[arg(long, hide = true)]
    probe_gl: bool,
}

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Row {
    /// What is looked at.
    name: &'static str,
    state: State,
    /// What is there, with version and place.
    found: String,
    /// What to do; empty if nothing.
    fix: String,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum State {
    Ok,
    /// This build can't do its work without it.
    Missing,
    /// Whatever is there, this build does not use it.
    NotNeeded,
}

impl Row {
    fn ok(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, state: State::Ok, found: found.into(), fix: String::new() }
    }

    fn missing(name: &'static str, found: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { name, state: State::Missing, found: found.into(), fix: fix.into() }
    }

    /// A row of a feature that is not built in.
    fn not_needed(name: &'static str, feature: &str, found: impl Into<String>) -> Self {
        let fix = format!("to use it: `make setup`, `. ./env.sh`, `cargo build --features {feature}`");
        Self { name, state: State::NotNeeded, found: found.into(), fix }
    }
}

/// Runs the command.
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    if args.probe_gl {
        println!("{}", gl::renderer_here()?);
        return Ok(ExitCode::SUCCESS);
    }
    let rows = checks::all(&args.hand);
    if args.json {
        println!("{}", serde_json::to_string_pretty(&rows)?);
    } else {
        print!("{}", table(&rows));
    }
    let complete = rows.iter().all(|row| row.state != State::Missing);
    Ok(if complete { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn table(rows: &[Row]) -> String {
    let width = rows.iter().map(|row| row.name.len()).max().unwrap_or_default();
    let mut text = String::new();
    for row in rows {
        let state = match row.state {
            State::Ok => "ok",
            State::Missing => "MISSING",
            State::NotNeeded => "-",
        };
        text += &format!("{:width$}  {state:7}  {}\n", row.name, row.found);
        if !row.fix.is_empty() {
            let arrow = if row.state == State::Missing { "fix" } else { "off" };
            text += &format!("{:width$}  {arrow:>7}: {}\n", "", row.fix);
        }
    }
    let missing: Vec<_> = rows.iter().filter(|row| row.state == State::Missing).map(|row| row.name).collect();
    text += &match missing.as_slice() {
        [] => "Nothing is missing.\n".to_string(),
        names => format!("Missing for this build: {}.\n", names.join(", ")),
    };
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_says_how_to_fix_what_is_missing() {
        let rows = [Row::ok("Rust", "rustc 1"), Row::missing("GL", "no EGL", "apt-get install libegl1")];
        assert_eq!(
            table(&rows),
            "Rust  ok       rustc 1\n\
             GL    MISSING  no EGL\n          fix: apt-get install libegl1\n\
             Missing for this build: GL.\n"
        );
    }

    #[test]
    fn what_a_build_does_not_use_is_not_missing() {
        let rows = [Row::not_needed("GL", "sim", "not looked for")];
        assert!(table(&rows).ends_with("Nothing is missing.\n"));
    }
}
