//! Time, header and plain values: `builtin_interfaces`, `std_msgs`, `rosgraph_msgs`.

use crate::message::message;

message! {
    /// An instant.
    #[derive(Copy, Default, Eq, Hash, PartialOrd, Ord)]
    Time = "builtin_interfaces/msg/Time" {
        /// Whole seconds.
        sec: i32,
        /// Nanoseconds within the second.
        nanosec: u32,
    }

    /// A span of time.
    #[derive(Copy, Default, Eq)]
    Duration = "builtin_interfaces/msg/Duration" {
        /// Whole seconds.
        sec: i32,
        /// Nanoseconds within the second.
        nanosec: u32,
    }

    /// Time and coordinate frame of a measurement.
    #[derive(Default)]
    Header = "std_msgs/msg/Header" {
        /// Time of the measurement.
        stamp: Time,
        /// Coordinate frame.
        frame_id: String,
    }

    /// Yes or no.
    #[derive(Copy, Default, Eq)]
    Bool = "std_msgs/msg/Bool" {
        /// The value.
        data: bool,
    }

    /// One dimension of an array.
    #[derive(Default)]
    MultiArrayDimension = "std_msgs/msg/MultiArrayDimension" {
        /// Name of the dimension.
        label: String,
        /// Number of elements along it.
        size: u32,
        /// Number of elements from the start of one of its slices to the next, times its size.
        stride: u32,
    }

    /// Layout of an array.
    #[derive(Default)]
    MultiArrayLayout = "std_msgs/msg/MultiArrayLayout" {
        /// Dimensions, outermost first; empty = one dimension without a name.
        dim: Vec<MultiArrayDimension>,
        /// Number of elements before the array.
        data_offset: u32,
    }

    /// An array of numbers.
    #[derive(Default)]
    Float32MultiArray = "std_msgs/msg/Float32MultiArray" {
        /// Layout of the numbers.
        layout: MultiArrayLayout,
        /// The numbers.
        data: Vec<f32>,
    }

    /// Numbers in an array.
    #[derive(Default)]
    Float64MultiArray = "std_msgs/msg/Float64MultiArray" {
        /// Layout of the numbers.
        layout: MultiArrayLayout,
        /// The numbers.
        data: Vec<f64>,
    }

    /// A colour with opacity, each from 0 to 1.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    ColorRGBA = "std_msgs/msg/ColorRGBA" { r: f32, g: f32, b: f32, a: f32 }

    /// The time of a simulation.
    Clock = "rosgraph_msgs/msg/Clock" {
        /// Present time.
        clock: Time,
    }
}

impl Time {
    /// Creates the time `nanos` nanoseconds after the epoch; saturates at the range of 32-bit seconds.
    pub fn from_nanos(nanos: i64) -> Self {
        let sec = nanos.div_euclid(1_000_000_000);
        let Ok(sec) = i32::try_from(sec) else {
            return Self { sec: if sec < 0 { i32::MIN } else { i32::MAX }, nanosec: 0 };
        };
        Self { sec, nanosec: nanos.rem_euclid(1_000_000_000) as u32 }
    }

    /// Returns the nanoseconds after the epoch.
    pub fn nanos(self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }

    /// Returns the seconds after the epoch.
    pub fn secs(self) -> f64 {
        f64::from(self.sec) + f64::from(self.nanosec) * 1e-9
    }

    /// True if the time is zero, which means that nobody set it.
    pub fn is_zero(self) -> bool {
        self == Self::default()
    }
}
