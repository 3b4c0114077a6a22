//! State of nodes, log lines and topic statistics: `diagnostic_msgs`, `rcl_interfaces`, `statistics_msgs`.

use super::common::{Header, Time};
use crate::message::message;

message! {
    /// One statistic: 1 average, 2 minimum, 3 maximum, 4 standard deviation, 5 number of samples.
    #[derive(Copy)]
    StatisticDataPoint = "statistics_msgs/msg/StatisticDataPoint" {
        /// Code of the statistic.
        data_type: u8,
        /// Its value, in the unit of the message.
        data: f64,
    }

    /// Statistics of one quantity over one window of time.
    MetricsMessage = "statistics_msgs/msg/MetricsMessage" {
        /// Source of the measurement, for instance a node and a topic.
        measurement_source_name: String,
        /// Name of the quantity, for instance `message_age`.
        metrics_source: String,
        /// Unit of the values.
        unit: String,
        /// Start of the window.
        window_start: Time,
        /// End of the window.
        window_stop: Time,
        /// The statistics.
        statistics: Vec<StatisticDataPoint>,
    }

    /// A name with a value.
    KeyValue = "diagnostic_msgs/msg/KeyValue" {
        /// Name.
        key: String,
        /// Value.
        value: String,
    }

    /// State of one part of a node.
    DiagnosticStatus = "diagnostic_msgs/msg/DiagnosticStatus" {
        /// Level: 0 OK, 1 WARN, 2 ERROR, 3 STALE.
        level: u8,
        /// `<node>: <task>`.
        name: String,
        /// State as text.
        message: String,
        /// The hardware or model concerned.
        hardware_id: String,
        /// Values that explain the state.
        values: Vec<KeyValue>,
    }

    /// States of a node's parts.
    DiagnosticArray = "diagnostic_msgs/msg/DiagnosticArray" {
        /// Time of the states.
        header: Header,
        /// One per part.
        status: Vec<DiagnosticStatus>,
    }

    /// A line of a node's log.
    Log = "rcl_interfaces/msg/Log" {
        /// Time of the line.
        stamp: Time,
        /// Level: 10 debug, 20 info, 30 warn, 40 error, 50 fatal.
        level: u8,
        /// Name of the logger.
        name: String,
        /// Text of the line.
        msg: String,
        /// Source file.
        file: String,
        /// Source function.
        function: String,
        /// Source line.
        line: u32,
    }
}
