//! Parameters of a node: one table with descriptions, defaults and ranges, and the values checked against it.

mod describe;
mod parameter;
mod value;

use std::sync::Mutex;

use anyhow::bail;

use super::lock::lock;

pub(crate) use describe::{describe, help};
pub(crate) use parameter::{Allowed, Parameter, USE_SIM_TIME};
pub(crate) use value::{Typed, Value};

/// Parameters of a running node.
#[derive(Debug)]
pub(crate) struct Parameters {
    table: Vec<Parameter>,
    values: Mutex<Vec<Value>>,
}

impl Parameters {
    /// Takes the values given at start, else the defaults. Also returns the given names that the table lacks.
    ///
    /// # Errors
    /// If a given value has the wrong type or is out of range.
    pub(crate) fn new<'a>(
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
            let Some(value) = Value::from_ros(value) else {
                bail!("parameter {name}: expected {}, got {value:?}", table[index].type_name());
            };
            values[index] = table[index].check(value).map_err(|reason| anyhow::anyhow!("parameter {reason}"))?;
        }
        Ok((Self { table: table.to_vec(), values: Mutex::new(values) }, unknown))
    }

    /// Declarations of the parameters.
    pub(crate) fn table(&self) -> &[Parameter] {
        &self.table
    }

    /// Returns all names, separated by commas.
    pub(crate) fn names(&self) -> String {
        self.table.iter().map(|parameter| parameter.name).collect::<Vec<_>>().join(", ")
    }

    /// Returns the value of a parameter; None if the table lacks it.
    pub(crate) fn value(&self, name: &str) -> Option<Value> {
        let index = self.table.iter().position(|parameter| parameter.name == name)?;
        lock(&self.values).get(index).cloned()
    }

    /// Returns the value of a parameter of the node's own table.
    ///
    /// # Panics
    /// If the table has no such parameter of this type. This is a mistake in the node's source, never in its input.
    pub(crate) fn get<T: Typed>(&self, name: &str) -> T {
        let value = self.value(name);
        let Some(value) = value.as_ref().and_then(T::from_value) else {
            panic!("the node has no parameter {name} of this type");
        };
        value
    }

    /// Takes the values of another set of parameters with the same table.
    pub(crate) fn take_over(&self, other: &Parameters) {
        let values = lock(&other.values).clone();
        *lock(&self.values) = values;
    }

    /// Sets values on a running node, either all or none.
    ///
    /// # Errors
    /// If a value cannot be set; the text gives the reason for the first one.
    pub(crate) fn set(&self, changes: impl IntoIterator<Item = (String, Value)>) -> std::result::Result<(), String> {
        let mut values = lock(&self.values);
        let mut changed = values.clone();
        for (name, value) in changes {
            let Some(index) = self.table.iter().position(|parameter| parameter.name == name) else {
                return Err(format!("{name} is unknown; known: {}", self.names()));
            };
            let parameter = &self.table[index];
            let value = parameter.check(value)?;
            if parameter.read_only && value != values[index] {
                return Err(format!("{name} is read-only while the node runs; set it at start"));
            }
            changed[index] = value;
        }
        *values = changed;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Vec<Parameter> {
        vec![
            Parameter::new("threshold", 0.5, Allowed::Doubles(0.0, 1.0), "A threshold."),
            Parameter::new("enabled", true, Allowed::Any, "Enables it."),
            Parameter::fixed("device", "cpu", Allowed::OneOf(&["cpu", "cuda"]), "Device."),
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
    fn an_integer_is_accepted_as_a_double_and_a_scalar_as_an_array() {
        let parameters = parameters();
        set(&parameters, "threshold", 1i64).unwrap();
        assert_eq!(parameters.get::<f64>("threshold"), 1.0);
        set(&parameters, "seeds", 7i64).unwrap();
        assert_eq!(parameters.get::<Vec<i64>>("seeds"), [7]);
    }

    #[test]
    fn a_value_out_of_range_or_of_another_type_is_refused_with_the_reason() {
        let parameters = parameters();
        let refused = |name, value: Value, reason| {
            assert_eq!(set(&parameters, name, value).unwrap_err(), reason);
        };
        refused("threshold", 1.5.into(), "threshold: expected 0 to 1, got 1.5");
        refused("threshold", f64::NAN.into(), "threshold: expected 0 to 1, got null");
        refused("threshold", "high".into(), "threshold: expected double, got string \"high\"");
        refused("seeds", vec![3i64, -1].into(), "seeds: expected 0 to 9223372036854775807, got [3,-1]");
        refused("device", "cuda".into(), "device is read-only while the node runs; set it at start");
        refused("x", 1i64.into(), "x is unknown; known: threshold, enabled, device, seeds");
    }

    #[test]
    fn several_values_are_set_atomically() {
        let parameters = parameters();
        let both = [("enabled".to_owned(), false.into()), ("threshold".to_owned(), 2.0.into())];
        assert!(parameters.set(both).is_err());
        assert!(parameters.get::<bool>("enabled"));
    }

    #[test]
    fn values_given_at_start_are_checked_and_unknown_names_returned() {
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
    fn describe_returns_json_with_each_parameter() {
        let described: serde_json::Value = serde_json::from_str(&describe(&table())).unwrap();
        assert_eq!(described["threshold"]["maximum"], 1.0);
        assert_eq!(described["device"]["one_of"][1], "cuda");
        assert_eq!(described["device"]["read_only"], true);
    }
}
