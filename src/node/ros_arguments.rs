//! Arguments of the command line that are for ROS: those between `--ros-args` and `--`.

/// An argument for ROS that the nodes read themselves, with its value as it was given.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum RosArgument {
    /// Path of a parameter file.
    ParameterFile(String),
    /// Rule of a parameter: `[node:]name:=value`.
    Parameter(String),
    /// Rule of a name: `[node:]from:=to`.
    Remap(String),
    /// Level of the log: `level`, or `logger:=level`.
    LogLevel(String),
}

/// Returns the arguments for ROS in the order in which they are given. An option at the end, without a value, is left out: ROS
/// has refused it before.
pub(crate) fn ros_arguments(arguments: impl IntoIterator<Item = String>) -> impl Iterator<Item = RosArgument> {
    let mut arguments = arguments.into_iter();
    let mut for_ros = false;
    std::iter::from_fn(move || {
        loop {
            let kind = match arguments.next()?.as_str() {
                "--ros-args" => {
                    for_ros = true;
                    continue;
                }
                "--" => {
                    for_ros = false;
                    continue;
                }
                "--params-file" => RosArgument::ParameterFile,
                "-p" | "--param" => RosArgument::Parameter,
                "-r" | "--remap" => RosArgument::Remap,
                "--log-level" => RosArgument::LogLevel,
                _ => continue,
            };
            if for_ros {
                return Some(kind(arguments.next()?));
            }
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(line: &str) -> Vec<RosArgument> {
        ros_arguments(line.split_whitespace().map(String::from)).collect()
    }

    #[test]
    fn arguments_count_between_the_marks_and_keep_their_order() {
        let line =
            "-p a:=1 --ros-args --remap b:=c -p d:=2 --params-file e.yaml -- -r f:=g --ros-args --log-level warn";
        let expected = [
            RosArgument::Remap("b:=c".into()),
            RosArgument::Parameter("d:=2".into()),
            RosArgument::ParameterFile("e.yaml".into()),
            RosArgument::LogLevel("warn".into()),
        ];
        assert_eq!(of(line), expected);
    }

    #[test]
    fn an_option_without_a_value_is_left_out() {
        assert_eq!(of("--ros-args -r a:=b -p"), [RosArgument::Remap("a:=b".into())]);
        assert_eq!(of(""), []);
    }
}
