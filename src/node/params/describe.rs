//! Description of a node's parameters without ROS: `--describe-parameters` and `--help`.

use serde_json::json;

use super::parameter::{Allowed, Parameter};

/// Returns the table as JSON: per name `type`, `default`, `description`, `read_only` and the constraint.
pub(crate) fn describe(table: &[Parameter]) -> String {
    let entries = table.iter().map(|parameter| {
        let mut entry = json!({
            "type": parameter.type_name(),
            "default": parameter.default.to_json(),
            "description": parameter.description,
            "read_only": parameter.read_only,
        });
        match &parameter.allowed {
            Allowed::Any => {}
            Allowed::Integers(low, high) => {
                entry["minimum"] = json!(low);
                entry["maximum"] = json!(high);
            }
            Allowed::Doubles(low, high) => {
                entry["minimum"] = json!(low);
                entry["maximum"] = json!(high);
            }
            Allowed::OneOf(known) => entry["one_of"] = json!(known),
        }
        (parameter.name.to_owned(), entry)
    });
    format!("{:#}", serde_json::Value::Object(entries.collect()))
}

/// Returns the help text of a node's program.
pub(crate) fn help(about: &str, table: &[Parameter]) -> String {
    let mut text = format!(
        "{about}\n\nUsage: [--describe-parameters] [--ros-args [-p NAME:=VALUE] [-r FROM:=TO] [--params-file FILE] ...]\n\n\
         Parameters:\n"
    );
    for parameter in table {
        let constraint = match parameter.constraint() {
            constraint if constraint.is_empty() => constraint,
            constraint => format!(", {constraint}"),
        };
        let fixed = if parameter.read_only { ", read-only while the node runs" } else { "" };
        text += &format!(
            "  {} ({}{constraint}; default {}{fixed})\n      {}\n",
            parameter.name,
            parameter.type_name(),
            parameter.default,
            parameter.description
        );
    }
    text
}
