//! Wire form of the messages: plain structs, their CDR bytes and their schemas; needs no ROS.
//!
//! Nodes publish and subscribe to these bytes, and recordings hold them. `msg/*.msg` states units, frames and the meaning of
//! "unknown". Tests compare each struct with its file, and with bytes that ROS itself serialised.

mod cdr;
mod convert;
mod own;
mod standard;

use crate::error::Result;

pub use cdr::{Reader, Wire, Writer};
pub use own::{
    GloveReading, HandKeypoints, HandModelInfo, HandPose, HandPoses, HandTactile, LinkTouch, RobotTouch,
    TactileContact, TactileContacts, TactileFrame, TactileMetrics, TactileRegions, TactileTruth, TrainerStatus,
};
pub use standard::{
    Bool, CameraInfo, Clock, ColorRGBA, CompressedImage, DiagnosticArray, DiagnosticStatus, Duration,
    Float32MultiArray, Float64MultiArray, Header, Image, JointState, JointTrajectory, JointTrajectoryPoint, KeyValue,
    Log, Marker, MarkerArray, MeshFile, MetricsMessage, MultiArrayDimension, MultiArrayLayout, Point, PointCloud2,
    PointField, Pose, PoseArray, PoseStamped, Quaternion, RegionOfInterest, StatisticDataPoint, TFMessage, Time,
    Transform, TransformStamped, UVCoordinate, Vector3, Wrench, WrenchStamped,
};

/// A message of topics and recordings.
pub trait Message: Wire {
    /// Full name, for instance `egotac_msgs/msg/TactileFrame`.
    const TYPE: &'static str;

    /// Returns the message's own fields in the form of a `.msg` file.
    fn definition() -> String;

    /// Returns the payload as ROS 2 serialises it: encapsulation header and CDR.
    fn to_cdr(&self) -> Vec<u8> {
        Writer::payload(self)
    }

    /// Reads a payload. Any input gives a message or an error, and memory proportional to the size of the payload.
    ///
    /// # Errors
    /// If the payload is truncated, too long, or a field holds an invalid value; the error names the field.
    fn from_cdr(payload: &[u8]) -> Result<Self> {
        Reader::payload(Self::TYPE, payload)
    }

    /// Returns the schema in the `ros2msg` form of recordings: the definition, then those of all message types within it.
    fn schema() -> String {
        let mut definitions = Vec::new();
        Self::collect_definitions(&mut definitions);
        let mut schema = String::new();
        for (index, (name, text)) in definitions.iter().enumerate() {
            if index > 0 {
                schema += &"=".repeat(80);
                schema += "\nMSG: ";
                schema += &name.replacen("/msg/", "/", 1);
                schema.push('\n');
            }
            schema += text.trim_end();
            schema.push('\n');
        }
        schema
    }
}

/// Defines a struct with its wire form; fields are in the order of the wire.
///
/// `field: Vec<T> [<= N]` is a bounded sequence. `from "path"` takes the definition's text from a `.msg` file; without it,
/// the macro writes the definition from the fields.
macro_rules! message {
    ($(
        $(#[$meta:meta])*
        $name:ident = $type:literal $(from $file:literal)? {
            $( $(#[$field_meta:meta])* $field:ident: $field_type:ty $([<= $max:literal])? ),* $(,)?
        }
    )*) => {$(
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq)]
        pub struct $name {
            $( $(#[$field_meta])* pub $field: $field_type, )*
        }

        impl $crate::message::Wire for $name {
            fn ros_type() -> String {
                $type.replacen("/msg/", "/", 1)
            }
            fn write(&self, out: &mut $crate::message::Writer) {
                $( $crate::message::Wire::write(&self.$field, out); )*
            }
            fn read(input: &mut $crate::message::Reader) -> $crate::error::Result<Self> {
                Ok(Self { $( $field: $crate::message::message!(@read input $field $($max)?), )* })
            }
            fn collect_definitions(list: &mut Vec<(&'static str, String)>) {
                if list.iter().any(|(name, _)| *name == $type) {
                    return;
                }
                list.push(($type, <Self as $crate::message::Message>::definition()));
                $( <$field_type as $crate::message::Wire>::collect_definitions(list); )*
            }
        }

        impl $crate::message::Message for $name {
            const TYPE: &'static str = $type;
            #[allow(unreachable_code)] // With a file, the generated definition is unreachable.
            fn definition() -> String {
                $( return include_str!($file).to_owned(); )?
                Self::fields()
            }
        }

        impl $name {
            /// Returns the fields in the order of the wire, one `type name` per line.
            pub fn fields() -> String {
                let mut text = String::new();
                $(
                    let kind = <$field_type as $crate::message::Wire>::ros_type();
                    $( let kind = kind.replace("[]", concat!("[<=", $max, "]")); )?
                    text += &format!("{kind} {}\n", stringify!($field));
                )*
                text
            }
        }
    )*};
    (@read $input:ident $field:ident) => {
        $input.field(stringify!($field))?
    };
    (@read $input:ident $field:ident $max:literal) => {
        $input.bounded(stringify!($field), $max)?
    };
}
use message;
