//! Declaration of a parameter.

use super::value::Value;

/// Name of the parameter that takes the time from `/clock`.
pub(crate) const USE_SIM_TIME: &str = "use_sim_time";

/// Declaration of a parameter.
#[derive(Debug, Clone)]
pub(crate) struct Parameter {
    /// Name of the parameter.
    pub(crate) name: &'static str,
    /// Effect and unit.
    pub(crate) description: &'static str,
    /// Default; also sets the type.
    pub(crate) default: Value,
    /// Range of allowed values.
    pub(crate) allowed: Allowed,
    /// True if the value cannot change while the node runs.
    pub(crate) read_only: bool,
}

/// Allowed values of a parameter's type.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Allowed {
    /// All values of the type.
    Any,
    /// Integers from the first to the second, inclusive; for an array, each element.
    Integers(i64, i64),
    /// Numbers from the first to the second, inclusive.
    Doubles(f64, f64),
    /// One of these texts.
    OneOf(&'static [&'static str]),
}

impl Parameter {
    /// Declares a parameter that can be set while the node runs.
    pub(crate) fn new(
        name: &'static str,
        default: impl Into<Value>,
        allowed: Allowed,
        description: &'static str,
    ) -> Self {
        Self { name, description, default: default.into(), allowed, read_only: false }
    }

    /// Declares a parameter that can only be set at start.
    pub(crate) fn fixed(
        name: &'static str,
        default: impl Into<Value>,
        allowed: Allowed,
        description: &'static str,
    ) -> Self {
        Self { read_only: true, ..Self::new(name, default, allowed, description) }
    }

    /// Declares `use_sim_time`, which every node has.
    pub(crate) fn use_sim_time() -> Self {
        Self::new(USE_SIM_TIME, false, Allowed::Any, "Take the time from /clock instead of the wall clock.")
    }

    /// Converts `value` to the type of this parameter and checks its range.
    ///
    /// # Errors
    /// If the type or the range does not fit; the text names the parameter, what was expected and what came.
    pub(super) fn check(&self, value: Value) -> std::result::Result<Value, String> {
        let value = match (&self.default, value) {
            (Value::Double(_), Value::Integer(whole)) => Value::Double(whole as f64),
            // A single value counts as an array of one.
            (Value::Texts(_), Value::Text(text)) => Value::Texts(vec![text]),
            (Value::Integers(_), Value::Integer(whole)) => Value::Integers(vec![whole]),
            (_, value) => value,
        };
        if std::mem::discriminant(&value) != std::mem::discriminant(&self.default) {
            return Err(format!("{}: expected {}, got {} {value}", self.name, self.type_name(), value.type_name()));
        }
        match self.allowed.contains(&value) {
            true => Ok(value),
            false => Err(format!("{}: expected {}, got {value}", self.name, self.constraint())),
        }
    }

    /// Returns the name that ROS gives the type.
    pub(crate) fn type_name(&self) -> &'static str {
        self.default.type_name()
    }

    /// Describes the allowed values; empty if all values of the type are allowed.
    pub(crate) fn constraint(&self) -> String {
        match &self.allowed {
            Allowed::Any => String::new(),
            Allowed::Integers(low, high) => format!("{low} to {high}"),
            Allowed::Doubles(low, high) => format!("{low} to {high}"),
            Allowed::OneOf(known) => format!("one of {}", known.join(", ")),
        }
    }
}

impl Allowed {
    fn contains(&self, value: &Value) -> bool {
        match (self, value) {
            (Allowed::Integers(low, high), Value::Integer(value)) => (low..=high).contains(&value),
            (Allowed::Integers(low, high), Value::Integers(values)) => {
                values.iter().all(|value| (low..=high).contains(&value))
            }
            (Allowed::Doubles(low, high), Value::Double(value)) => (low..=high).contains(&value),
            (Allowed::OneOf(known), Value::Text(text)) => known.contains(&text.as_str()),
            _ => true,
        }
    }
}
