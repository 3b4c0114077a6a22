//! Images, cameras, point clouds and joints: `sensor_msgs`, `trajectory_msgs`.

use super::common::{Duration, Header};
use crate::message::message;

message! {
    /// Positions of joints.
    JointState = "sensor_msgs/msg/JointState" {
        /// Time of the measurement.
        header: Header,
        /// Names of the joints.
        name: Vec<String>,
        /// Positions, rad or m; empty = unknown.
        position: Vec<f64>,
        /// Velocities, rad/s or m/s; empty = unknown.
        velocity: Vec<f64>,
        /// Efforts, N m or N; empty = unknown.
        effort: Vec<f64>,
    }

    /// Desired state of joints at a time.
    JointTrajectoryPoint = "trajectory_msgs/msg/JointTrajectoryPoint" {
        /// Positions, rad or m.
        positions: Vec<f64>,
        /// Velocities, rad/s or m/s; empty = unspecified.
        velocities: Vec<f64>,
        /// Accelerations, rad/s² or m/s²; empty = unspecified.
        accelerations: Vec<f64>,
        /// Efforts, N m or N; empty = unspecified.
        effort: Vec<f64>,
        /// Time since the trajectory's stamp.
        time_from_start: Duration,
    }

    /// A trajectory of joints.
    JointTrajectory = "trajectory_msgs/msg/JointTrajectory" {
        /// Start of the trajectory; zero = at once.
        header: Header,
        /// Names of the joints.
        joint_names: Vec<String>,
        /// Desired states in order of time.
        points: Vec<JointTrajectoryPoint>,
    }

    /// An uncompressed image.
    Image = "sensor_msgs/msg/Image" {
        /// Time of exposure, and the camera's optical frame.
        header: Header,
        /// Number of rows.
        height: u32,
        /// Number of columns.
        width: u32,
        /// Meaning of the bytes, for instance `rgb8`.
        encoding: String,
        /// Other than 0 = values of several bytes are big endian.
        is_bigendian: u8,
        /// Length of a row, bytes.
        step: u32,
        /// Content of the rows.
        data: Vec<u8>,
    }

    /// A JPEG or PNG file.
    #[derive(Default)]
    CompressedImage = "sensor_msgs/msg/CompressedImage" {
        /// Time of exposure, and the camera's optical frame.
        header: Header,
        /// Format, for instance `rgb8; jpeg compressed bgr8`, `jpeg`, or empty.
        format: String,
        /// Content of the file.
        data: Vec<u8>,
    }

    /// The part of a sensor that an image shows.
    #[derive(Default)]
    RegionOfInterest = "sensor_msgs/msg/RegionOfInterest" {
        /// First column.
        x_offset: u32,
        /// First row.
        y_offset: u32,
        /// Number of rows; 0 = all.
        height: u32,
        /// Number of columns; 0 = all.
        width: u32,
        /// True if the image has to be rectified for the region.
        do_rectify: bool,
    }

    /// Calibration of a camera.
    CameraInfo = "sensor_msgs/msg/CameraInfo" {
        /// Header of the image.
        header: Header,
        /// Number of rows of the calibrated image.
        height: u32,
        /// Number of columns of the calibrated image.
        width: u32,
        /// Distortion model, for instance `plumb_bob`.
        distortion_model: String,
        /// Distortion parameters; empty = none.
        d: Vec<f64>,
        /// (3, 3) row-major camera matrix, pixels.
        k: [f64; 9],
        /// (3, 3) row-major rectification.
        r: [f64; 9],
        /// (3, 4) row-major projection, pixels.
        p: [f64; 12],
        /// Number of sensor pixels per image column; 0 means 1.
        binning_x: u32,
        /// Number of sensor pixels per image row; 0 means 1.
        binning_y: u32,
        /// The part of the sensor.
        roi: RegionOfInterest,
    }

    /// A field of the points of a cloud.
    PointField = "sensor_msgs/msg/PointField" {
        /// Name, for instance `x`.
        name: String,
        /// Offset from the start of the point, bytes.
        offset: u32,
        /// Type of the values; 7 = float32.
        datatype: u8,
        /// Number of values.
        count: u32,
    }

    /// Points with named fields.
    PointCloud2 = "sensor_msgs/msg/PointCloud2" {
        /// Time, and coordinate frame of x, y, z.
        header: Header,
        /// 1 for an unordered cloud.
        height: u32,
        /// Number of points per row.
        width: u32,
        /// Fields of a point.
        fields: Vec<PointField>,
        /// True if values are big endian.
        is_bigendian: bool,
        /// Size of a point, bytes.
        point_step: u32,
        /// Size of a row, bytes.
        row_step: u32,
        /// Content of the points.
        data: Vec<u8>,
        /// True if all points are valid.
        is_dense: bool,
    }
}
