//! A node's parameters: one table with description, default and range, and the values checked against it.

use std::fmt;
use std::sync::{Mutex, PoisonError};

use anyhow::bail;
use serde_json::json;

/// A parameter as it is declared.
#[derive(Debug, Clone)]
pub struct Parameter {
    /// Name.
    pub name: &'static str,
    /// What it does, with its unit.
    pub description: &'static str,
    /// Value when nobody gives one; also its type.
    pub default: Value,
    /// Which values are fit.
    pub allowed: Allowed,
    /// Whether it is fixed once the node runs.
    pub read_only: bool,
}

/// A parameter's value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// True or false.
    Bool(bool),
    /// A whole number.
    Integer(i64),
    /// A number; whole ones are accepted.
    Double(f64),
    /// A text.
    Text(String),
    /// Whole numbers.
    Integers(Vec<i64>),
    /// Texts.
    Texts(Vec<String>),
}

/// Which values of a parameter's type are fit.
#[derive(Debug, Clone, PartialEq)]
pub enum Allowed {
    /// All of the type.
    Any,
    /// From the first to the second, inclusive; also for each of several integers.
    Integers(i64, i64),
    /// From the first to the second, inclusive.
    Doubles(f64, f64),
    /// One of these texts.
    OneOf(&'static [&'static str]),
}

impl Parameter {
    /// A parameter that can be set while the node runs.
    pub fn new(name: &'static str, default: impl Into<Value>, allowed: Allowed, description: &'static str) -> Self {
        Self { name, description, default: default.into(), allowed, read_only: false }
    }

    /// A parameter that is fixed once the node runs.
    pub fn fixed(name: &'static str, default: impl Into<Value>, allowed: Allowed, description: &'static str) -> Self {
        Self { read_only: true, ..Self::new(name, default, allowed, description) }
    }

    /// `use_sim_time`, which each node has.
    pub fn use_sim_time() -> Self {
        Self::fixed("use_sim_time", false, Allowed::Any, "Take the time from /clock instead of the wall clock.")
    }

    /// The value as this parameter's type, if it is fit.
    fn check(&self, value: Value) -> std::result::Result<Value, String> {
        let value = match (&self.default, value) {
            (Value::Double(_), Value::Integer(whole)) => Value::Double(whole as f64),
            // A single one serves as a list.
            (Value::Texts(_), Value::Text(text)) => Value::Texts(vec![text]),
            (Value::Integers(_), Value::Integer(whole)) => Value::Integers(vec![whole]),
            (_, value) => value,
        };
        if std::mem::discriminant(&value) != std::mem::discriminant(&self.default) {
            return Err(format!("{}: expected {}, got {} {value}", self.name, self.type_name(), value.type_name()));
        }
        let fit = match (&self.allowed, &value) {
            (Allowed::Integers(low, high), Value::Integer(value)) => (low..=high).contains(&value),
            (Allowed::Integers(low, high), Value::Integers(values)) => {
                values.iter().all(|value| (low..=high).contains(&value))
            }
            (Allowed::Doubles(low, high), Value::Double(value)) => (low..=high).contains(&value),
            (Allowed::OneOf(known), Value::Text(text)) => known.contains(&text.as_str()),
            _ => true,
        };
        match fit {
            true => Ok(value),
            false => Err(format!("{}: expected {}, got {value}", self.name, self.constraint())),
        }
    }

    /// The parameter's type in words.
    pub fn type_name(&self) -> &'static str {
        self.default.type_name()
    }

    /// What is fit beyond the type, in words; empty when all is.
    pub fn constraint(&self) -> String {
        match &self.allowed {
            Allowed::Any => String::new(),
            Allowed::Integers(low, high) => format!("{low} to {high}"),
            Allowed::Doubles(low, high) => format!("{low} to {high}"),
            Allowed::OneOf(known) => format!("one of {}", known.join(", ")),
        }
    }
}

impl Value {
    fn type_name(&self) -> &'static str {
        match self {
            Value::Bool(_) => "bool",
            Value::Integer(_) => "integer",
            Value::Double(_) => "double",
            Value::Text(_) => "string",
            Value::Integers(_) => "integer array",
            Value::Texts(_) => "string array",
        }
    }

    fn to_json(&self) -> serde_json::Value {
        match self {
            Value::Bool(value) => json!(value),
            Value::Integer(value) => json!(value),
            Value::Double(value) => json!(value),
            Value::Text(value) => json!(value),
            Value::Integers(values) => json!(values),
            Value::Texts(values) => json!(values),
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.to_json())
    }
}

/// A Rust type that parameters come in.
pub trait Typed: Sized {
    /// The value, if it is of this type.
    fn from_value(value: &Value) -> Option<Self>;
}

macro_rules! typed {
    ($($variant:ident: $type:ty),*) => {$(
        impl From<$type> for Value {
            fn from(value: $type) -> Self {
                Value::$variant(value)
            }
        }
        impl Typed for $type {
            fn from_value(value: &Value) -> Option<Self> {
                match value {
                    Value::$variant(value) => Some(value.clone()),
                    _ => None,
                }
            }
        }
    )*};
}
typed!(Bool: bool, Integer: i64, Double: f64, Text: String, Integers: Vec<i64>, Texts: Vec<String>);

impl From<&str> for Value {
    fn from(text: &str) -> Self {
        Value::Text(text.to_owned())
    }
}

/// The parameters of a running node.
#[derive(Debug)]
pub struct Parameters {
    table: Vec<Parameter>,
    values: Mutex<Vec<Value>>,
}

impl Parameters {
    /// Values from what was given at start, else the defaults. Also returns the given names that the table lacks.
    ///
    /// # Errors
    /// If a given value is unfit.
    pub fn new<'a>(
        table: &[Parameter],
        given: impl IntoIterator<Item = (&'a str, &'a r2r::ParameterValue)>,
    ) -> anyhow::Result<(Self, Vec<String>)> {
        let mut values: Vec<_> = table.iter().map(|parameter| parameter.default.clone()).collect();
        let mut unknown = Vec::new();
        for (name, value) in given {
            let Some(index) = table.iter().position(|parameter| parameter.name == name) else {
                unknown.push(name.to_owned());
                continue;
            };
            let Some(value) = from_ros(value) else {
                bail!("parameter {name}: expected {}, got {value:?}", table[index].type_name());
            };
            values[index] = table[index].check(value).map_err(|reason| anyhow::anyhow!("parameter {reason}"))?;
        }
        Ok((Self { table: table.to_vec(), values: Mutex::new(values) }, unknown))
    }

    /// The table.
    pub fn table(&self) -> &[Parameter] {
        &self.table
    }

    /// All names, comma separated.
    pub fn names(&self) -> String {
        self.table.iter().map(|parameter| parameter.name).collect::<Vec<_>>().join(", ")
    }

    /// A value by name, if the table has it.
    pub fn value(&self, name: &str) -> Option<Value> {
        let index = self.table.iter().position(|parameter| parameter.name == name)?;
        self.values.lock().unwrap_or_else(PoisonError::into_inner).get(index).cloned()
    }

    /// A value of the node's own table.
    ///
    /// # Panics
    /// If the table has no such parameter of this type: a mistake in the node's source, not in anybody's input.
    pub fn get<T: Typed>(&self, name: &str) -> T {
        let value = self.value(name);
        let Some(value) = value.as_ref().and_then(T::from_value) else {
            panic!("the node has no parameter {name} of this type");
        };
        value
    }

    /// Sets values on a running node, all or none.
    ///
    /// # Errors
    /// The reason why the first unfit one can't be set.
    pub fn set(&self, changes: impl IntoIterator<Item = (String, Value)>) -> std::result::Result<(), String> {
        let mut values = self.values.lock().unwrap_or_else(PoisonError::into_inner);
        let mut changed = values.clone();
        for (name, value) in changes {
            let Some(index) = self.table.iter().position(|parameter| parameter.name == name) else {
                return Err(format!("{name} is unknown; known: {}", self.names()));
            };
            let parameter = &self.table[index];
            let value = parameter.check(value)?;
            if parameter.read_only && value != values[index] {
                return Err(format!("{name} is fixed once the node runs; give it at start"));
            }
            changed[index] = value;
        }
        *values = changed;
        Ok(())
    }
}

/// The table as JSON: by name, type, default, description, constraint, read_only.
pub fn describe(table: &[Parameter]) -> String {
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

/// A node's help text.
pub fn help(about: &str, table: &[Parameter]) -> String {
    let mut text = format!(
        "{about}\n\nUsage: [--describe-parameters] [--ros-args [-p NAME:=VALUE] [-r FROM:=TO] [--params-file FILE] ...]\n\n\
         Parameters:\n"
    );
    for parameter in table {
        let constraint = match parameter.constraint() {
            none if none.is_empty() => none,
            some => format!(", {some}"),
        };
        let fixed = if parameter.read_only { ", fixed once the node runs" } else { "" };
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

/// A value as r2r gives it; None for a type that no parameter has.
fn from_ros(value: &r2r::ParameterValue) -> Option<Value> {
    use r2r::ParameterValue as Ros;
    Some(match value {
        Ros::Bool(value) => Value::Bool(*value),
        Ros::Integer(value) => Value::Integer(*value),
        Ros::Double(value) => Value::Double(*value),
        Ros::String(value) => Value::Text(value.clone()),
        Ros::IntegerArray(values) => Value::Integers(values.clone()),
        Ros::StringArray(values) => Value::Texts(values.clone()),
        Ros::NotSet | Ros::BoolArray(_) | Ros::ByteArray(_) | Ros::DoubleArray(_) => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Vec<Parameter> {
        vec![
            Parameter::new("threshold", 0.5, Allowed::Doubles(0.0, 1.0), "A threshold."),
            Parameter::new("enabled", true, Allowed::Any, "Whether to."),
            Parameter::fixed("device", "cpu", Allowed::OneOf(&["cpu", "cuda"]), "Where."),
            Parameter::new("seeds", vec![1i64], Allowed::Integers(0, i64::MAX), "Seeds."),
        ]
    }

    fn parameters() -> Parameters {
        Parameters::new(&table(), []).unwrap().0
    }

    fn set(parameters: &Parameters, name: &str, value: impl Into<Value>) -> std::result::Result<(), String> {
        parameters.set([(name.to_owned(), value.into())])
    }

    #[test]
    fn a_whole_number_serves_as_a_double_and_a_single_one_as_a_list() {
        let parameters = parameters();
        set(&parameters, "threshold", 1i64).unwrap();
        assert_eq!(parameters.get::<f64>("threshold"), 1.0);
        set(&parameters, "seeds", 7i64).unwrap();
        assert_eq!(parameters.get::<Vec<i64>>("seeds"), [7]);
    }

    #[test]
    fn an_unfit_value_is_refused_with_the_reason() {
        let parameters = parameters();
        let refused = |name, value: Value, reason| {
            assert_eq!(set(&parameters, name, value).unwrap_err(), reason);
        };
        refused("threshold", 1.5.into(), "threshold: expected 0 to 1, got 1.5");
        refused("threshold", f64::NAN.into(), "threshold: expected 0 to 1, got null");
        refused("threshold", "high".into(), "threshold: expected double, got string \"high\"");
        refused("seeds", vec![3i64, -1].into(), "seeds: expected 0 to 9223372036854775807, got [3,-1]");
        refused("device", "cuda".into(), "device is fixed once the node runs; give it at start");
        refused("x", 1i64.into(), "x is unknown; known: threshold, enabled, device, seeds");
    }

    #[test]
    fn several_values_are_set_all_or_none() {
        let parameters = parameters();
        let both = [("enabled".to_owned(), false.into()), ("threshold".to_owned(), 2.0.into())];
        assert!(parameters.set(both).is_err());
        assert!(parameters.get::<bool>("enabled"));
    }

    #[test]
    fn values_given_at_start_are_checked_and_unknown_names_reported() {
        use r2r::ParameterValue as Ros;
        let given = [("threshold", &Ros::Integer(1)), ("device", &Ros::String("cuda".into())), ("y", &Ros::Bool(true))];
        let (parameters, unknown) = Parameters::new(&table(), given).unwrap();
        assert_eq!(parameters.get::<f64>("threshold"), 1.0);
        assert_eq!(parameters.get::<String>("device"), "cuda");
        assert_eq!(unknown, ["y"]);
        let error = Parameters::new(&table(), [("device", &Ros::String("tpu".into()))]).unwrap_err().to_string();
        assert_eq!(error, "parameter device: expected one of cpu, cuda, got \"tpu\"");
    }

    #[test]
    fn the_description_is_json_with_each_parameter() {
        let described: serde_json::Value = serde_json::from_str(&describe(&table())).unwrap();
        assert_eq!(described["threshold"]["maximum"], 1.0);
        assert_eq!(described["device"]["one_of"][1], "cuda");
        assert_eq!(described["device"]["read_only"], true);
    }
}
