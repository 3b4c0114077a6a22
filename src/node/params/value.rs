//! Value of a parameter.

use std::fmt;

use serde_json::json;

/// Value of a parameter, in one of the types that our parameters have.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Value {
    Bool(bool),
    Integer(i64),
    Double(f64),
    Text(String),
    Integers(Vec<i64>),
    Texts(Vec<String>),
}

impl Value {
    /// Returns the name that ROS gives the type.
    pub(crate) fn type_name(&self) -> &'static str {
        match self {
            Value::Bool(_) => "bool",
            Value::Integer(_) => "integer",
            Value::Double(_) => "double",
            Value::Text(_) => "string",
            Value::Integers(_) => "integer array",
            Value::Texts(_) => "string array",
        }
    }

    /// Returns the value as JSON.
    pub(crate) fn to_json(&self) -> serde_json::Value {
        match self {
            Value::Bool(value) => json!(value),
            Value::Integer(value) => json!(value),
            Value::Double(value) => json!(value),
            Value::Text(value) => json!(value),
            Value::Integers(values) => json!(values),
            Value::Texts(values) => json!(values),
        }
    }

    /// Converts a value given on the command line or in a parameter file; None for a type that no parameter has.
    pub(crate) fn from_ros(value: &r2r::ParameterValue) -> Option<Self> {
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
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.to_json())
    }
}

/// Rust type of a parameter's value.
pub(crate) trait Typed: Sized {
    /// Returns the value if it has this type.
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
