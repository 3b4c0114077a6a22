//! `egotac doctor`: checks the installation and prints fixes for missing parts.

mod checks;
mod gl;
#[cfg_attr(not(feature = "ros"), allow(dead_code, reason = "the build script uses it for feature `ros`"))]
mod idl_hash;

use std::process::ExitCode;

use serde::Serialize;

use super::options::Json;

/// Arguments of `egotac doctor`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Hand to check: `builtin`, or a MANO file (.pkl or .npz) of the right hand.
    #[arg(long, value_name = "builtin|PATH", default_value = "builtin")]
    hand: String,
    #[command(flatten)]
    json: Json,
    /// Print the name of the OpenGL renderer. The table runs this in a child process, because a broken OpenGL can end
    /// the process that opens it.
    #[arg(long, hide = true)]
    probe_gl: bool,
}

/// One line of the table.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct Row {
    /// Name of the checked part.
    name: &'static str,
    state: State,
    /// Version and path that were found.
    found: String,
    /// Command or action that fixes the part or enables it; empty if none is needed.
    fix: String,
}

/// State of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
enum State {
    /// Present and usable.
    Ok,
    /// Absent or unusable, and required by this build.
    Missing,
    /// Not used by this build, present or not.
    NotNeeded,
}

impl Row {
    fn ok(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, state: State::Ok, found: found.into(), fix: String::new() }
    }

    fn missing(name: &'static str, found: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { name, state: State::Missing, found: found.into(), fix: fix.into() }
    }

    /// Creates the row of a part whose feature is not compiled in.
    fn not_needed(name: &'static str, feature: &str, found: impl Into<String>) -> Self {
        let fix = format!("`make setup`, `. ./env.sh`, `cargo build --features {feature}`");
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
    args.json.show(&serde_json::to_value(&rows)?, || table(&rows))?;
    let complete = rows.iter().all(|row| row.state != State::Missing);
    Ok(if complete { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Formats the rows as a table for people.
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
            let label = if row.state == State::Missing { "fix" } else { "enable" };
            text += &format!("{:width$}  {label:>7}: {}\n", "", row.fix);
        }
    }
    let missing: Vec<_> = rows.iter().filter(|row| row.state == State::Missing).map(|row| row.name).collect();
    text += &match missing.as_slice() {
        [] => "All parts that this build needs are installed.\n".to_string(),
        names => format!("This build lacks: {}.\n", names.join(", ")),
    };
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_lists_fixes_for_missing_parts() {
        let rows = [Row::ok("Rust", "rustc 1"), Row::missing("GL", "no EGL", "apt-get install libegl1")];
        assert_eq!(
            table(&rows),
            "Rust  ok       rustc 1\n\
             GL    MISSING  no EGL\n          fix: apt-get install libegl1\n\
             This build lacks: GL.\n"
        );
    }

    #[test]
    fn parts_of_other_features_are_not_missing() {
        let rows = [Row::not_needed("GL", "sim", "not checked")];
        assert!(table(&rows).ends_with("All parts that this build needs are installed.\n"));
    }
}
