//! Level of a node's log: argument `--log-level`, and the services that other client libraries offer for it.

#[cfg(logger_levels)]
use r2r::rcl_interfaces::{msg, srv};

use super::ros_arguments::{RosArgument, ros_arguments};
use super::runtime::Runtime;

/// Levels of `rcl_interfaces/msg/Log` by the names that `--log-level` takes.
const LEVELS: [(&str, u8); 5] = [("debug", 10), ("info", 20), ("warn", 30), ("error", 40), ("fatal", 50)];
/// Level without an argument.
const DEFAULT: u8 = 20;
/// Level of a logger that has none of its own.
#[cfg(logger_levels)]
const UNSET: u8 = 0;

/// Returns the level that the program's arguments give to the logger `name`: `--log-level LEVEL` for all loggers, or
/// `--log-level LOGGER:=LEVEL` for one and those below it; the longest name counts. ROS has already checked the levels.
pub(super) fn from_arguments(arguments: impl IntoIterator<Item = String>, name: &str) -> u8 {
    let mut level = (0, DEFAULT);
    for argument in ros_arguments(arguments) {
        let RosArgument::LogLevel(rule) = argument else { continue };
        let (logger, word) = rule.split_once(":=").unwrap_or(("", &rule));
        let is_ours = logger.is_empty() || name == logger || name.starts_with(&format!("{logger}."));
        let found = LEVELS.iter().find(|(known, _)| known.eq_ignore_ascii_case(word));
        if let (true, Some((_, found))) = (is_ours && logger.len() >= level.0, found) {
            level = (logger.len(), *found);
        }
    }
    level.1
}

/// Offers `~/get_logger_levels` and `~/set_logger_levels` for the node's own logger. ROS 2 Humble has no such services.
///
/// # Errors
/// If ROS refuses a service name.
#[cfg(not(logger_levels))]
pub(super) fn serve(_: &mut Runtime) -> anyhow::Result<()> {
    Ok(())
}

/// Offers `~/get_logger_levels` and `~/set_logger_levels` for the node's own logger.
///
/// # Errors
/// If ROS refuses a service name.
#[cfg(logger_levels)]
pub(super) fn serve(runtime: &mut Runtime) -> anyhow::Result<()> {
    let log = runtime.log().clone();
    runtime.service::<srv::GetLoggerLevels::Service>("~/get_logger_levels", move |request| {
        let level = |name: &String| if *name == log.name() { log.level() } else { UNSET };
        let levels =
            request.names.iter().map(|name| msg::LoggerLevel { name: name.clone(), level: level(name).into() });
        srv::GetLoggerLevels::Response { levels: levels.collect() }
    })?;
    let log = runtime.log().clone();
    runtime.service::<srv::SetLoggerLevels::Service>("~/set_logger_levels", move |request| {
        let set = |wanted: &msg::LoggerLevel| {
            let known = LEVELS.iter().find(|(_, code)| u32::from(*code) == wanted.level);
            let reason = match known {
                _ if wanted.name != log.name() => format!("the node has one logger, {}", log.name()),
                None => format!("level: expected 10, 20, 30, 40 or 50, got {}", wanted.level),
                Some((_, code)) => {
                    log.set_level(*code);
                    String::new()
                }
            };
            msg::SetLoggerLevelsResult { successful: reason.is_empty(), reason }
        };
        srv::SetLoggerLevels::Response { results: request.levels.iter().map(set).collect() }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_level_of_the_longest_logger_name_counts() {
        let level = |words: &str| {
            let arguments = format!("program --log-level error --ros-args {words}");
            from_arguments(arguments.split(' ').map(str::to_owned), "robot.predictor")
        };
        assert_eq!(level("-p a:=b"), 20, "what stands before --ros-args is not for ROS");
        assert_eq!(level("--log-level WARN"), 30);
        assert_eq!(level("--log-level robot.predictor:=debug --log-level error"), 10);
        assert_eq!(level("--log-level robot:=error --log-level robot.verifier:=fatal"), 40);
    }
}
