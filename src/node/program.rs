//! `main` of the nodes' programs.

use std::process::ExitCode;

use super::create::create;
use super::params::{self, Parameter};
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use crate::file::limits::check_environment;
use crate::text::{error_chain, tell};

/// Runs the program of the node `name`: `--help` and `--describe-parameters` print without starting ROS; otherwise `run`
/// gets the node and runs until SIGINT or SIGTERM. The exit status is 0 after a clean shutdown, 1 after an error, which is
/// printed in one line, and 2 for an unknown argument.
pub(crate) fn run(
    name: &str,
    about: &str,
    table: &[Parameter],
    run: impl FnOnce(Runtime, &Shutdown) -> anyhow::Result<()>,
) -> ExitCode {
    // ROS checks the arguments after --ros-args.
    let mut own_arguments = std::env::args().skip(1).take_while(|argument| argument != "--ros-args");
    if let Some(argument) = own_arguments.next() {
        return match argument.as_str() {
            "--describe-parameters" => {
                println!("{}", params::describe(table));
                ExitCode::SUCCESS
            }
            "--help" | "-h" => {
                print!("{}", params::help(about, table));
                ExitCode::SUCCESS
            }
            other => {
                tell(format_args!("unknown argument {other:?}; ROS arguments follow --ros-args, see --help"));
                ExitCode::from(2)
            }
        };
    }
    let shutdown = Shutdown::default();
    let run = || {
        check_environment()?;
        shutdown.request_on_signals()?;
        run(create(name, table)?, &shutdown)
    };
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tell(format_args!("{}", error_chain(error.as_ref())));
            ExitCode::FAILURE
        }
    }
}
