//! Creation of a node with parameters, clock, log and parameter services.

use std::panic;
use std::sync::Arc;

use anyhow::{Context as _, bail};

use super::clock::RosClock;
use super::lock::lock;
use super::log::Log;
use super::params::{Parameter, Parameters};
use super::publisher::Publisher;
use super::qos_overrides::{self, QosOverrides};
use super::runtime::Runtime;
use super::topic_names::TopicNames;
use super::{log_level, parameter_files, parameter_services, qos, sim_time};

/// Creates the node `name` (remappable) with parameter services for `table`, `/rosout` and `/parameter_events`. `before`: parameters
/// of an earlier node of this program, whose values it takes over.
///
/// # Errors
/// If ROS refuses its arguments, or a parameter given at start is not allowed; the error names it and its range.
pub(crate) fn create(name: &str, table: &[Parameter], before: Option<&Parameters>) -> anyhow::Result<Runtime> {
    let context = context()?;
    let mut node = r2r::Node::create(context, name, "").with_context(|| format!("cannot create node {name}"))?;
    let full_name = node.fully_qualified_name()?;
    let names = TopicNames::new(&node.namespace()?, &node.name()?, std::env::args().skip(1));
    let given = given(&node, &full_name)?;
    let given = || given.iter().map(|(name, value)| (name.as_str(), value));
    let (parameters, unknown) = Parameters::new(table, given())?;
    if let Some(before) = before {
        parameters.take_over(before);
    }
    let overrides = QosOverrides::new(given())?;
    if parameters.get::<bool>("use_sim_time") {
        let time_source = node.get_time_source();
        time_source.enable_sim_time(&mut node)?;
    }
    let clock = RosClock::new(node.get_ros_clock());
    let rosout = Publisher::create(&mut node, "/rosout", qos::rosout())?;
    let logger = logger_name(&full_name);
    let level = log_level::from_arguments(std::env::args(), &logger);
    let log = Log::new(logger, level, clock.clone(), rosout);
    for name in unknown.into_iter().filter(|name| !qos_overrides::is_override(name)) {
        log.warn(format!("parameter {name} is unknown and ignored; known: {}", parameters.names()));
    }
    let mut runtime = Runtime::new(node, names, clock, log, Arc::new(parameters), overrides);
    parameter_services::serve(&mut runtime, full_name)?;
    log_level::serve(&mut runtime)?;
    sim_time::follow_parameter(&mut runtime);
    Ok(runtime)
}

/// Returns the parameters given at start, on the command line and in files.
fn given(node: &r2r::Node, full_name: &str) -> anyhow::Result<Vec<(String, r2r::ParameterValue)>> {
    let passed_on = lock(&node.params).iter().map(|(name, given)| (name.clone(), given.value.clone())).collect();
    parameter_files::given(passed_on, full_name, std::env::args().skip(1))
}

/// Creates the ROS context of the process. r2r panics on arguments that ROS refuses; the panic becomes an error.
fn context() -> anyhow::Result<r2r::Context> {
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let created = panic::catch_unwind(r2r::Context::create);
    panic::set_hook(hook);
    match created {
        Ok(context) => Ok(context.context("cannot start ROS")?),
        Err(reason) => {
            let reason = reason.downcast_ref::<String>().map_or("ROS refused its arguments", String::as_str);
            // The text after ", at /" is the position in ROS's own source file.
            bail!("ROS arguments: {}", reason.split(", at /").next().unwrap_or(reason))
        }
    }
}

/// Returns the logger name of a node: its full name with dots.
fn logger_name(full_name: &str) -> String {
    full_name.trim_start_matches('/').replace('/', ".")
}
