//! Parameters given for names of nodes with wildcards: `/*/predictor`, `/robot/**`. r2r passes on only those for `/**`, `**` and
//! the node's own name; rclcpp and rclpy match the others, too.

use std::collections::HashMap;
use std::path::Path;

use anyhow::{Context as _, bail};
use r2r::ParameterValue;
use serde_yaml::Value;

use super::ros_arguments::{RosArgument, ros_arguments};
use crate::file::{input, limits};
use crate::text::parse_yaml;

/// Name of all nodes.
const ALL: &str = "/**";

/// Parameters for one name of nodes, in the order in which they are given.
#[derive(Debug, PartialEq)]
struct Entry {
    node: String,
    parameters: Vec<(String, ParameterValue)>,
}

/// Returns the parameters given at start for the node of this full name. `passed_on`: those that r2r passes on; `arguments`: the
/// command line. Of several entries for one name, the last one counts; entries are in the order in which the names of nodes
/// appear first.
///
/// # Errors
/// If a parameter file can't be read, or a parameter has no value of one of ROS's types; names the file and the parameter.
pub(crate) fn given(
    passed_on: Vec<(String, ParameterValue)>,
    full_name: &str,
    arguments: impl IntoIterator<Item = String>,
) -> anyhow::Result<Vec<(String, ParameterValue)>> {
    let entries = entries(arguments)?;
    let name = full_name.rsplit('/').next().unwrap_or_default();
    // Value of each parameter by its last entry; None if r2r knows that entry.
    let mut last: HashMap<&str, Option<&ParameterValue>> = HashMap::new();
    for Entry { node, parameters } in &entries {
        let is_passed_on = [ALL, "**", full_name, name].contains(&node.as_str());
        if is_passed_on || matches(node, full_name) {
            last.extend(parameters.iter().map(|(name, value)| (name.as_str(), (!is_passed_on).then_some(value))));
        }
    }
    let replaced = |(name, value): (String, ParameterValue)| {
        let value = last.remove(name.as_str()).flatten().cloned().unwrap_or(value);
        (name, value)
    };
    let mut given: Vec<_> = passed_on.into_iter().map(replaced).collect();
    let mut others: Vec<_> =
        last.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?.clone()))).collect();
    others.sort_by(|(a, _), (b, _)| a.cmp(b));
    given.append(&mut others);
    Ok(given)
}

/// True if the pattern matches a full name: `*` is one part of a name, `**` any number of parts.
fn matches(pattern: &str, full_name: &str) -> bool {
    fn parts_match(pattern: &[&str], name: &[&str]) -> bool {
        match pattern {
            [] => name.is_empty(),
            ["**", rest @ ..] => (0..=name.len()).any(|skipped| parts_match(rest, &name[skipped..])),
            [first, rest @ ..] => {
                name.first().is_some_and(|part| *first == "*" || first == part) && parts_match(rest, &name[1..])
            }
        }
    }
    fn parts(name: &str) -> Vec<&str> {
        name.trim_start_matches('/').split('/').collect()
    }
    parts_match(&parts(pattern), &parts(full_name))
}

/// Returns the entries of the parameter files and rules on the command line.
fn entries(arguments: impl IntoIterator<Item = String>) -> anyhow::Result<Vec<Entry>> {
    let mut entries = Vec::new();
    for argument in ros_arguments(arguments) {
        match argument {
            RosArgument::ParameterFile(path) => {
                let text = input::read_text(Path::new(&path), limits::TEXT)?;
                let file: Value = parse_yaml(&text).with_context(|| format!("parameter file {path}"))?;
                read_nodes("", &file, &mut entries).with_context(|| format!("parameter file {path}"))?;
            }
            RosArgument::Parameter(rule) => {
                let Some((left, value)) = rule.split_once(":=") else { continue };
                let (node, name) = left.split_once(':').unwrap_or((ALL, left));
                let value: Value = parse_yaml(value).unwrap_or_else(|_| Value::String(value.to_owned()));
                // An empty value and the like: r2r knows what ROS makes of them.
                let value = to_ros(&value).unwrap_or(ParameterValue::NotSet);
                add(&mut entries, node, vec![(name.to_owned(), value)]);
            }
            RosArgument::Remap(_) | RosArgument::LogLevel(_) => {}
        }
    }
    Ok(entries)
}

/// Adds parameters to the entry of a node.
fn add(entries: &mut Vec<Entry>, node: &str, mut parameters: Vec<(String, ParameterValue)>) {
    match entries.iter_mut().find(|entry| entry.node == node) {
        Some(entry) => entry.parameters.append(&mut parameters),
        None => entries.push(Entry { node: node.to_owned(), parameters }),
    }
}

/// Reads the nodes of a parameter file; namespaces may be nested.
fn read_nodes(namespace: &str, content: &Value, entries: &mut Vec<Entry>) -> anyhow::Result<()> {
    let Value::Mapping(content) = content else { return Ok(()) };
    for (key, value) in content {
        let Some(key) = key.as_str() else { bail!("expected names of nodes, got {key:?}") };
        if key == "ros__parameters" {
            let mut parameters = Vec::new();
            read_parameters("", value, &mut parameters).with_context(|| format!("node {namespace}"))?;
            add(entries, namespace, parameters);
        } else {
            let separator = if namespace.is_empty() || key.starts_with('/') { "" } else { "/" };
            read_nodes(&format!("{namespace}{separator}{key}"), value, entries)?;
        }
    }
    Ok(())
}

/// Reads the parameters of a node; nested ones get a name with dots.
fn read_parameters(
    prefix: &str,
    content: &Value,
    parameters: &mut Vec<(String, ParameterValue)>,
) -> anyhow::Result<()> {
    let Value::Mapping(content) = content else { return Ok(()) };
    for (key, value) in content {
        let Some(key) = key.as_str() else { bail!("expected names of parameters, got {key:?}") };
        let name = format!("{prefix}{key}");
        match value {
            Value::Mapping(_) => read_parameters(&format!("{name}."), value, parameters)?,
            _ => match to_ros(value) {
                Some(value) => parameters.push((name, value)),
                None => bail!("parameter {name}: expected a value or an array of values of one type, got {value:?}"),
            },
        }
    }
    Ok(())
}

/// Converts a value; None if ROS has no such type.
fn to_ros(value: &Value) -> Option<ParameterValue> {
    let all = |values: &[Value]| values.iter().map(to_ros).collect::<Option<Vec<_>>>();
    Some(match value {
        Value::Bool(value) => ParameterValue::Bool(*value),
        Value::Number(number) => match number.as_i64() {
            Some(whole) => ParameterValue::Integer(whole),
            None => ParameterValue::Double(number.as_f64()?),
        },
        Value::String(text) => ParameterValue::String(text.clone()),
        Value::Sequence(values) => {
            let values = all(values)?;
            match values.first()? {
                ParameterValue::Bool(_) => ParameterValue::BoolArray(each(&values, |value| match value {
                    ParameterValue::Bool(value) => Some(*value),
                    _ => None,
                })?),
                ParameterValue::Integer(_) => ParameterValue::IntegerArray(each(&values, |value| match value {
                    ParameterValue::Integer(value) => Some(*value),
                    _ => None,
                })?),
                ParameterValue::Double(_) => ParameterValue::DoubleArray(each(&values, |value| match value {
                    ParameterValue::Double(value) => Some(*value),
                    _ => None,
                })?),
                ParameterValue::String(_) => ParameterValue::StringArray(each(&values, |value| match value {
                    ParameterValue::String(value) => Some(value.clone()),
                    _ => None,
                })?),
                _ => return None,
            }
        }
        _ => return None,
    })
}

fn each<T>(values: &[ParameterValue], of: impl Fn(&ParameterValue) -> Option<T>) -> Option<Vec<T>> {
    values.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_as_in_rclcpp() {
        for (pattern, full_name, expected) in [
            ("/*/predictor", "/robot/predictor", true),
            ("/*/predictor", "/predictor", false),
            ("/*/predictor", "/a/b/predictor", false),
            ("/robot/*", "/robot/predictor", true),
            ("/robot/**", "/robot/predictor", true),
            ("/robot/**", "/robot/arm/predictor", true),
            ("/robot/**", "/other/predictor", false),
            ("/**/predictor", "/predictor", true),
            ("/**/predictor", "/a/b/predictor", true),
            ("/**/predictor", "/a/b/verifier", false),
            ("/*", "/predictor", true),
            ("/*", "/robot/predictor", false),
        ] {
            assert_eq!(matches(pattern, full_name), expected, "{pattern} {full_name}");
        }
    }

    /// Parameters of `/robot/predictor` given by a file with this text and a rule.
    fn of_file(text: &str, passed_on: &[(&str, f64)]) -> anyhow::Result<Vec<(String, ParameterValue)>> {
        let file = tempfile::NamedTempFile::new()?;
        std::fs::write(file.path(), text)?;
        let path = file.path().display().to_string();
        let arguments = ["--ros-args", "--params-file", &path, "-p", "rule:=2.5"].map(String::from);
        let passed_on = passed_on.iter().map(|(name, value)| ((*name).to_owned(), ParameterValue::Double(*value)));
        given(passed_on.collect(), "/robot/predictor", arguments)
    }

    #[test]
    fn the_last_matching_entry_of_a_file_counts() {
        let text = "
/**: { ros__parameters: { first: 1.0, second: 1.0 } }
/*/predictor: { ros__parameters: { second: 2.0, nested: { deep: [a, b] }, third: 2.0 } }
/robot: { predictor: { ros__parameters: { third: 3.0 } } }
/other/**: { ros__parameters: { first: 9.0 } }
";
        let passed_on = [("first", 1.0), ("second", 1.0), ("third", 3.0), ("rule", 2.5)];
        let number = |name: &str, value| (name.to_owned(), ParameterValue::Double(value));
        let expected = [
            number("first", 1.0),
            number("second", 2.0),
            number("third", 3.0),
            number("rule", 2.5),
            ("nested.deep".to_owned(), ParameterValue::StringArray(vec!["a".into(), "b".into()])),
        ];
        assert_eq!(of_file(text, &passed_on).unwrap(), expected);
    }

    #[test]
    fn a_value_of_no_type_of_ros_is_refused_by_name() {
        let error = of_file("/*/predictor: { ros__parameters: { odd: [1, x] } }", &[]).unwrap_err();
        let text = format!("{error:#}");
        assert!(text.contains("parameter file ") && text.contains("parameter odd"), "{text}");
    }
}
