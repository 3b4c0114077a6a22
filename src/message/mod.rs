//! Wire form of the messages: plain structs, their CDR bytes and their schemas; needs no ROS.
//!
//! This is the one home of the layout: nodes publish and take these bytes, recordings hold them. Units, frames and the
//! meaning of "unknown" stand in `msg/*.msg`; a test holds each struct against its file, and bytes that ROS itself
//! serialised against each struct.

mod cdr;
mod convert;
mod own;
mod standard;

use crate::error::Result;

pub use cdr::{Reader, Wire, Writer};
pub use own::{
    HandModelInfo, HandPose, HandTactile, LinkTouch, RobotTouch, TactileFrame, TactileMetrics, TactileTruth,
    TrainerStatus,
};
pub use standard::{
    CameraInfo, Clock, CompressedImage, DiagnosticArray, DiagnosticStatus, Duration, Header, Image, JointState,
    JointTrajectory, JointTrajectoryPoint, KeyValue, Log, Point, Point32, PointCloud2, PointField, Pose, PoseArray,
    PoseStamped, Quaternion, RegionOfInterest, Time, Vector3, Wrench,
};

/// A message that topics and recordings carry.
pub trait Message: Wire {
    /// Full name, for instance `egotac_msgs/msg/TactileFrame`.
    const TYPE: &'static str;

    /// Its own fields, in the form of a `.msg` file.
    fn definition() -> String;

    /// The payload as ROS 2 serialises it: encapsulation header and CDR.
    fn to_cdr(&self) -> Vec<u8> {
        Writer::payload(self)
    }

    /// Reads a payload; every input yields a message or an error, never more memory than the payload's size warrants.
    ///
    /// # Errors
    /// If the payload is truncated, too long, or holds what a field does not allow; the error names the field.
    fn from_cdr(payload: &[u8]) -> Result<Self> {
        Reader::payload(Self::TYPE, payload)
    }

    /// The schema in recordings' `ros2msg` form: the definition, then those of all message types it is made of.
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

/// Defines a struct with its wire form; the fields' order is that on the wire.
///
/// `field: Vec<T> [<= N]` is a bounded sequence. `from "path"` takes the definition's text from a `.msg` file, otherwise
/// it is written from the fields.
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
            #[allow(unreachable_code)] // The written form is not reached where a file is given.
            fn definition() -> String {
                $( return include_str!($file).to_owned(); )?
                Self::fields()
            }
        }

        impl $name {
            /// The fields in the order on the wire, one `type name` per line.
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
