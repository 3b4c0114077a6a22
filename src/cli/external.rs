//! `egotac bench` and `egotac experiment`: commands of another program, `egotac-bench`.

use std::ffi::OsString;
use std::io::ErrorKind;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Command, ExitCode};

use anyhow::{Context, bail};

/// Name of the program; built from crates/bench.
const PROGRAM: &str = "egotac-bench";

/// Arguments of the other program, passed on unread.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Passed on to `egotac-bench`; `--help` lists what it takes.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, value_name = "ARGUMENTS")]
    arguments: Vec<OsString>,
}

/// Replaces this process by `egotac-bench`, so that its exit status and signals are ours. The program beside this one
/// comes first, so that both are of one build; then those in PATH. `option` stands before the command.
///
/// # Errors
/// If there is no such program, or it cannot be started.
pub fn run(command: &str, option: Option<&str>, args: Args) -> anyhow::Result<ExitCode> {
    let beside = std::env::current_exe().ok().map(|own| own.with_file_name(PROGRAM)).filter(|path| path.is_file());
    let program = beside.unwrap_or_else(|| PathBuf::from(PROGRAM));
    let error = Command::new(&program).args(option).arg(command).args(args.arguments).exec();
    if error.kind() == ErrorKind::NotFound {
        bail!(
            "`egotac {command}` needs the program {PROGRAM}, which is neither beside this program nor in PATH: \
             build it with `cargo build --release --features ros,sim -p egotac-bench`"
        );
    }
    Err(error).with_context(|| program.display().to_string())
}
