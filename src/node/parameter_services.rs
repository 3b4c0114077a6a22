//! The six parameter services and `/parameter_events`, as `ros2 param` and `rqt` expect them.
//!
//! r2r's own handlers support neither ranges nor read-only parameters, and refuse an integer for a double.

use std::rc::Rc;
use std::sync::Arc;

use r2r::rcl_interfaces::{msg, srv};

use super::clock::RosClock;
use super::params::{Allowed, Parameter, Parameters, Value};
use super::runtime::Runtime;

/// Codes of `rcl_interfaces/msg/ParameterType`.
mod code {
    pub(crate) const NOT_SET: u8 = 0;
    pub(crate) const BOOL: u8 = 1;
    pub(crate) const INTEGER: u8 = 2;
    pub(crate) const DOUBLE: u8 = 3;
    pub(crate) const TEXT: u8 = 4;
    pub(crate) const INTEGERS: u8 = 7;
    pub(crate) const TEXTS: u8 = 9;
}

/// Offers the services for the parameters of a node and publishes their changes.
///
/// # Errors
/// If ROS refuses a service or the topic.
pub(crate) fn serve(runtime: &mut Runtime, node: String) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let events = runtime.native_publisher("/parameter_events", r2r::QosProfile::parameter_events())?;
    let setter = Setter { parameters: Arc::clone(&parameters), events, clock: runtime.clock().clone(), node };
    setter.announce_all();

    serve_getters(runtime, &parameters)?;

    let one_by_one = Rc::new(setter);
    let at_once = Rc::clone(&one_by_one);
    runtime.set_extension(Rc::clone(&one_by_one));
    runtime.service::<srv::SetParameters::Service>("~/set_parameters", move |request| {
        let results = request.parameters.iter().map(|p| one_by_one.set(std::slice::from_ref(p)));
        srv::SetParameters::Response { results: results.collect() }
    })?;
    runtime.service::<srv::SetParametersAtomically::Service>("~/set_parameters_atomically", move |request| {
        srv::SetParametersAtomically::Response { result: at_once.set(&request.parameters) }
    })
}

/// Offers the services that list, read and describe parameters.
fn serve_getters(runtime: &mut Runtime, parameters: &Arc<Parameters>) -> anyhow::Result<()> {
    let table = Arc::clone(parameters);
    runtime.service::<srv::ListParameters::Service>("~/list_parameters", move |request| {
        let wanted = |name: &str| {
            let below = |prefix: &String| name == prefix || name.starts_with(&format!("{prefix}."));
            request.prefixes.is_empty() || request.prefixes.iter().any(below)
        };
        let names = table.table().iter().map(|p| p.name).filter(|name| wanted(name)).map(String::from).collect();
        srv::ListParameters::Response { result: msg::ListParametersResult { names, prefixes: Vec::new() } }
    })?;

    let table = Arc::clone(parameters);
    runtime.service::<srv::GetParameters::Service>("~/get_parameters", move |request| {
        let value = |name: &String| table.value(name).map(to_message).unwrap_or_default();
        srv::GetParameters::Response { values: request.names.iter().map(value).collect() }
    })?;

    let table = Arc::clone(parameters);
    runtime.service::<srv::GetParameterTypes::Service>("~/get_parameter_types", move |request| {
        let type_of = |name: &String| table.value(name).as_ref().map_or(code::NOT_SET, type_code);
        srv::GetParameterTypes::Response { types: request.names.iter().map(type_of).collect() }
    })?;

    let table = Arc::clone(parameters);
    runtime.service::<srv::DescribeParameters::Service>("~/describe_parameters", move |request| {
        let describe = |name: &String| match table.table().iter().find(|p| p.name == name) {
            Some(parameter) => descriptor(parameter),
            None => msg::ParameterDescriptor { name: name.clone(), ..Default::default() },
        };
        srv::DescribeParameters::Response { descriptors: request.names.iter().map(describe).collect() }
    })
}

/// Sets parameters and publishes the changes.
pub(crate) struct Setter {
    parameters: Arc<Parameters>,
    events: r2r::Publisher<msg::ParameterEvent>,
    clock: RosClock,
    node: String,
}

impl Setter {
    /// Parameters of the node.
    pub(crate) fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Sets one parameter and publishes the change.
    ///
    /// # Errors
    /// If the value is not allowed; the text gives the reason.
    pub(crate) fn set_one(&self, name: &str, value: impl Into<Value>) -> Result<(), String> {
        let result = self.set(&[msg::Parameter { name: name.to_owned(), value: to_message(value.into()) }]);
        if result.successful { Ok(()) } else { Err(result.reason) }
    }

    fn set(&self, wanted: &[msg::Parameter]) -> msg::SetParametersResult {
        let changes: Result<Vec<_>, String> = wanted
            .iter()
            .map(|parameter| {
                let value = from_message(&parameter.value);
                let value = value.ok_or_else(|| format!("{}: no parameter of egotac has this type", parameter.name));
                Ok((parameter.name.clone(), value?))
            })
            .collect();
        let result = changes.and_then(|changes| self.parameters.set(changes));
        if result.is_ok() {
            let mut event = self.event();
            event.changed_parameters = wanted.iter().filter_map(|p| self.current(&p.name)).collect();
            self.publish(&event);
        }
        msg::SetParametersResult { successful: result.is_ok(), reason: result.err().unwrap_or_default() }
    }

    /// Publishes all parameters as new ones, as a node does at start.
    fn announce_all(&self) {
        let mut event = self.event();
        event.new_parameters = self.parameters.table().iter().filter_map(|p| self.current(p.name)).collect();
        self.publish(&event);
    }

    /// Returns an event without changes.
    fn event(&self) -> msg::ParameterEvent {
        let now = self.clock.now();
        let stamp = r2r::builtin_interfaces::msg::Time { sec: now.sec, nanosec: now.nanosec };
        msg::ParameterEvent { stamp, node: self.node.clone(), ..Default::default() }
    }

    /// Returns a parameter with its present value; None if the table lacks it.
    fn current(&self, name: &str) -> Option<msg::Parameter> {
        Some(msg::Parameter { name: name.to_owned(), value: to_message(self.parameters.value(name)?) })
    }

    fn publish(&self, event: &msg::ParameterEvent) {
        // Ignore the error: the parameter is set, and the service still responds.
        let _ = self.events.publish(event);
    }
}

fn type_code(value: &Value) -> u8 {
    match value {
        Value::Bool(_) => code::BOOL,
        Value::Integer(_) => code::INTEGER,
        Value::Double(_) => code::DOUBLE,
        Value::Text(_) => code::TEXT,
        Value::Integers(_) => code::INTEGERS,
        Value::Texts(_) => code::TEXTS,
    }
}

fn to_message(value: Value) -> msg::ParameterValue {
    let mut message = msg::ParameterValue { type_: type_code(&value), ..Default::default() };
    match value {
        Value::Bool(value) => message.bool_value = value,
        Value::Integer(value) => message.integer_value = value,
        Value::Double(value) => message.double_value = value,
        Value::Text(value) => message.string_value = value,
        Value::Integers(values) => message.integer_array_value = values,
        Value::Texts(values) => message.string_array_value = values,
    }
    message
}

/// Converts a value from its message; None for a type that no parameter has.
fn from_message(message: &msg::ParameterValue) -> Option<Value> {
    Some(match message.type_ {
        code::BOOL => Value::Bool(message.bool_value),
        code::INTEGER => Value::Integer(message.integer_value),
        code::DOUBLE => Value::Double(message.double_value),
        code::TEXT => Value::Text(message.string_value.clone()),
        code::INTEGERS => Value::Integers(message.integer_array_value.clone()),
        code::TEXTS => Value::Texts(message.string_array_value.clone()),
        _ => return None,
    })
}

fn descriptor(parameter: &Parameter) -> msg::ParameterDescriptor {
    let mut descriptor = msg::ParameterDescriptor {
        name: parameter.name.to_owned(),
        type_: type_code(&parameter.default),
        description: parameter.description.to_owned(),
        read_only: parameter.read_only,
        ..Default::default()
    };
    match parameter.allowed {
        Allowed::Any => {}
        Allowed::Integers(from_value, to_value) => {
            descriptor.integer_range = vec![msg::IntegerRange { from_value, to_value, step: 0 }];
        }
        Allowed::Doubles(from_value, to_value) => {
            descriptor.floating_point_range = vec![msg::FloatingPointRange { from_value, to_value, step: 0.0 }];
        }
        Allowed::OneOf(_) => descriptor.additional_constraints = parameter.constraint(),
    }
    descriptor
}
