//! The ROS 2 nodes: thin shells around the library, each a `run(dependencies, shutdown)` that a test can start.
//!
//! A node has three kinds of threads. The one that calls `run` owns the ROS node and spins: it takes messages, answers
//! services and does nothing slow. Messages travel as bytes that [`crate::message`] reads and writes. One worker per
//! node takes the newest message from a [`mailbox`], computes and publishes. Shutdown runs the other way: the flag is
//! set, spinning ends, the worker is joined, then the ROS node is dropped; leaving it to process exit crashes in DDS.

#[cfg(feature = "sim")]
mod approximate_sync;
pub mod bag_recorder;
pub mod diagnostics;
mod episode_recorder;
mod exact_sync;
#[cfg(feature = "sim")]
mod held_object;
mod images;
pub mod log;
pub mod mailbox;
mod names;
mod parameter_services;
pub mod params;
mod points;
pub mod predictor;
pub mod qos;
#[cfg(feature = "sim")]
pub mod retargeter;
mod runtime;
mod shutdown;
#[cfg(feature = "sim")]
pub mod simulator;
pub mod trainer;
pub mod verifier;

pub use exact_sync::Pairing;
pub use runtime::{Publisher, RosClock, Runtime};
pub use shutdown::Shutdown;

use std::process::ExitCode;

use params::Parameter;

/// A node's `main`: `--help` and `--describe-parameters` without ROS, otherwise `run` until a signal; exit status 0
/// after a clean shutdown, 1 after an error, which it prints in one line.
pub fn main(about: &str, table: &[Parameter], run: impl FnOnce(&Shutdown) -> anyhow::Result<()>) -> ExitCode {
    // What follows --ros-args is for ROS to check.
    let own = std::env::args().skip(1).take_while(|argument| argument != "--ros-args");
    if let Some(argument) = own.into_iter().next() {
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
                eprintln!("unknown argument {other:?}; options of ROS come after --ros-args, see --help");
                ExitCode::from(2)
            }
        };
    }
    let shutdown = Shutdown::default();
    let result = shutdown.on_signals().and_then(|()| run(&shutdown));
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error:#}");
            ExitCode::FAILURE
        }
    }
}
