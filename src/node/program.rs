//! `main` of the nodes' programs.

use std::process::ExitCode;
use std::rc::Rc;
use std::sync::Arc;

use anyhow::Context as _;

use super::create::create;
use super::lifecycle::{self, Lifecycle};
use super::parameter_services::Setter;
use super::params::{self, Parameter, Parameters, USE_SIM_TIME};
use super::runtime::Runtime;
use super::shutdown::Shutdown;
use super::topic_statistics;
use crate::file::limits::check_environment;
use crate::text::{error_chain, tell};

/// Runs the program of the node `name`: `--help` and `--describe-parameters` print without starting ROS; otherwise `run` gets a
/// node that is to be configured, and runs until SIGINT, SIGTERM or a transition ends it. A clean-up creates the node anew and runs `run` again.
/// The exit status is 0 after a clean shutdown, 1 after an error, which is printed in one line, and 2 for an unknown
/// argument.
///
/// The node has `table`, which holds the parameter `enabled`, and the parameters that all nodes have.
pub(crate) fn run(
    name: &str,
    about: &str,
    mut table: Vec<Parameter>,
    run: impl Fn(Runtime, &Shutdown) -> anyhow::Result<()>,
) -> ExitCode {
    table.extend([lifecycle::parameter(), topic_statistics::parameter()]);
    // The simulator declares its own.
    if table.iter().all(|parameter| parameter.name != USE_SIM_TIME) {
        table.push(Parameter::use_sim_time());
    }
    run_program(about, &table, |shutdown| {
        let lifecycle = Lifecycle::new(shutdown);
        let mut parameters: Option<Arc<Parameters>> = None;
        loop {
            let mut runtime = create(name, &table, parameters.as_deref())?;
            let is_first = parameters.is_none();
            parameters = Some(Arc::clone(runtime.parameters()));
            let node = lifecycle.serve(&mut runtime)?;
            runtime.set_follower(lifecycle.clone());
            let log = runtime.log().clone();
            let waits = !(is_first && runtime.parameters().get::<bool>("autostart"));
            if waits {
                log.info("unconfigured: waits for ~/change_state");
                if !lifecycle.wait_for_configuration(&mut runtime, &node) {
                    return Ok(());
                }
                let setter = runtime.extension::<Rc<Setter>>().context("the node has no parameter services")?;
                setter.set_one("enabled", false).map_err(anyhow::Error::msg)?;
            }
            match run(runtime, &node) {
                Ok(()) if !lifecycle.was_cleaned_up() => return Ok(()),
                Ok(()) => {}
                Err(error) if waits && !lifecycle.is_configured() => {
                    tell(format_args!("the configuration failed: {}", error_chain(error.as_ref())));
                }
                Err(error) => return Err(error),
            }
        }
    })
}

/// Reads the program's own arguments; without any, runs `run` until it ends.
fn run_program(about: &str, table: &[Parameter], run: impl FnOnce(&Shutdown) -> anyhow::Result<()>) -> ExitCode {
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
        run(&shutdown)
    };
    match run() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            tell(format_args!("{}", error_chain(error.as_ref())));
            ExitCode::FAILURE
        }
    }
}
