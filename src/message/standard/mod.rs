//! Standard ROS 2 interface types in our messages, topics and recordings.
//!
//! Names and meaning of the fields follow `std_msgs`, `sensor_msgs`, `geometry_msgs` and the other ROS packages.

mod common;
mod diagnostic;
mod geometry;
mod sensor;
mod visualization;

pub use common::{
    Bool, Clock, ColorRGBA, Duration, Float32MultiArray, Float64MultiArray, Header, MultiArrayDimension,
    MultiArrayLayout, Time,
};
pub use diagnostic::{DiagnosticArray, DiagnosticStatus, KeyValue, Log, MetricsMessage, StatisticDataPoint};
pub use geometry::{
    Point, Pose, PoseArray, PoseStamped, Quaternion, TFMessage, Transform, TransformStamped, Vector3, Wrench,
    WrenchStamped,
};
pub use sensor::{
    CameraInfo, CompressedImage, Image, JointState, JointTrajectory, JointTrajectoryPoint, PointCloud2, PointField,
    RegionOfInterest,
};
pub use visualization::{Marker, MarkerArray, MeshFile, UVCoordinate};
