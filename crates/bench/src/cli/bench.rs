//! `egotac bench`: time, memory and accuracy, measured on this machine.

mod draw;
mod effects;
mod faults;
mod glove;
mod gpu;
mod guards;
mod hard_cases;
mod import;
mod label;
mod layers;
mod model;
#[cfg(all(feature = "ros", feature = "sim"))]
mod node;
mod physics;
mod ranks;
mod retarget;
mod sim;
mod train;

use std::process::ExitCode;

/// Arguments of `egotac bench`.
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(subcommand)]
    subject: Subject,
}

#[derive(Debug, clap::Subcommand)]
enum Subject {
    /// Measure the network: latency and memory by preset, precision and threads, beside accuracy.
    Model(Box<model::Args>),
    /// Measure each step of the encoder, beside the most that the processor computes and reads.
    Layers(layers::Args),
    /// Measure a training step, beside another program's.
    Train(train::Args),
    /// Measure network and training step on a GPU, beside another program's.
    Gpu(gpu::Args),
    /// Measure training on several processes, and compute it for more machines.
    Ranks(ranks::Args),
    /// Measure what labelling adds to the network's time: reading, writing, geometry.
    Label(label::Args),
    /// Measure imports: contact by distance, and readers of data sets against reading their bytes.
    Import(import::Args),
    /// Measure accuracy against time in simulation: errors against fine references, times, a Pareto plot.
    Sim(sim::Args),
    /// Measure time and accuracy of retargeting, beside other programs.
    Retarget(retarget::Args),
    /// Measure what each effect costs in each scene.
    Effects(effects::Args),
    /// Run every hard case as written, with the guards, and with its remedy.
    HardCases(hard_cases::Args),
    /// Measure the guards: a step with and without them.
    Guards(guards::Args),
    /// Measure what a glove costs: force on vertices from simulated taxels, by resolution and floor.
    Glove(glove::Args),
    /// Measure forces from motion against the simulator's contacts: noise, frame rates, masses.
    Physics(physics::Args),
    /// Disturb commands while they write their outputs: kills, full disks, two runs at once.
    Faults(faults::Args),
    /// Measure nothing: draw the plots of earlier measurements again, beside their JSON files.
    Draw(draw::Args),
    /// Load and disturb the ROS 2 nodes: latency, overload, memory over time, faults, kills.
    #[cfg(all(feature = "ros", feature = "sim"))]
    Node(node::Args),
}

/// Runs the command.
#[cfg(not(feature = "sim"))]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    let name = match args.subject {
        Subject::Model(args) => return status(model::run(&args)?),
        Subject::Layers(args) => return layers::run(&args).map(|()| ExitCode::SUCCESS),
        Subject::Train(args) => return train::run(&args).map(|()| ExitCode::SUCCESS),
        Subject::Gpu(args) => return gpu::run(&args).map(|()| ExitCode::SUCCESS),
        Subject::Ranks(args) => return ranks::run(&args).map(|()| ExitCode::SUCCESS),
        Subject::Label(args) => return status(label::run(&args)?),
        Subject::Import(args) => return status(import::run(&args)?),
        Subject::Faults(args) => return status(faults::run(&args)?),
        Subject::Sim(_) => "bench sim",
        Subject::Retarget(_) => "bench retarget",
        Subject::Effects(_) => "bench effects",
        Subject::HardCases(_) => "bench hard-cases",
        Subject::Guards(_) => "bench guards",
        Subject::Glove(_) => "bench glove",
        Subject::Physics(_) => "bench physics",
        Subject::Draw(_) => "bench draw",
    };
    Err(super::feature_off(name))
}

/// Runs the command; the exit status is 1 if a hard case fails silently, a fault does harm, a node misses a goal, if guards or labelling cost more than they may,
/// or if a stream's memory grows.
#[cfg(feature = "sim")]
pub fn run(args: Args) -> anyhow::Result<ExitCode> {
    status(match args.subject {
        Subject::Model(args) => model::run(&args)?,
        Subject::Layers(args) => layers::run(&args).map(|()| true)?,
        Subject::Train(args) => train::run(&args).map(|()| true)?,
        Subject::Gpu(args) => gpu::run(&args).map(|()| true)?,
        Subject::Ranks(args) => ranks::run(&args).map(|()| true)?,
        Subject::Label(args) => label::run(&args)?,
        Subject::Import(args) => import::run(&args)?,
        Subject::Sim(args) => sim::run(&args).map(|()| true)?,
        Subject::Retarget(args) => retarget::run(&args).map(|()| true)?,
        Subject::Effects(args) => effects::run(&args).map(|()| true)?,
        Subject::HardCases(args) => hard_cases::run(&args)?,
        Subject::Guards(args) => guards::run(&args)?,
        Subject::Glove(args) => glove::run(&args).map(|()| true)?,
        Subject::Physics(args) => physics::run(&args).map(|()| true)?,
        Subject::Faults(args) => faults::run(&args)?,
        Subject::Draw(args) => draw::run(&args).map(|()| true)?,
        #[cfg(feature = "ros")]
        Subject::Node(args) => node::run(&args)?,
    })
}

fn status(good: bool) -> anyhow::Result<ExitCode> {
    Ok(if good { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Loads the scenes of these names, or all shipped ones if there are none.
#[cfg(feature = "sim")]
fn load_scenes(names: &[String]) -> egotac::Result<Vec<egotac::sim::Scene>> {
    use egotac::sim::{SHIPPED, Scene};
    match names {
        [] => SHIPPED.iter().map(|(name, _)| Scene::load(name)).collect(),
        names => names.iter().map(|name| Scene::load(name)).collect(),
    }
}

/// Shows on a bar which part is being measured, and how many of all are done.
#[cfg(feature = "sim")]
fn show(bar: &indicatif::ProgressBar, what: &str, done: usize, all: usize) {
    egotac::cli::progress::step(bar, done, all);
    bar.set_message(what.to_owned());
}
