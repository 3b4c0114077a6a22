//! The ROS 2 interface types that our messages are made of, that nodes exchange, and that recordings hold.
//!
//! Field names and their meaning are those of `std_msgs`, `sensor_msgs`, `geometry_msgs` and their kin.

use super::message;

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

    /// When and in which frame something was measured.
    #[derive(Default)]
    Header = "std_msgs/msg/Header" {
        /// When.
        stamp: Time,
        /// In which frame.
        frame_id: String,
    }

    /// A position, m.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    Point = "geometry_msgs/msg/Point" { x: f64, y: f64, z: f64 }

    /// A position in single precision, m.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    Point32 = "geometry_msgs/msg/Point32" { x: f32, y: f32, z: f32 }

    /// A rotation.
    #[derive(Copy)]
    #[allow(missing_docs)]
    Quaternion = "geometry_msgs/msg/Quaternion" { x: f64, y: f64, z: f64, w: f64 }

    /// A position and a rotation.
    #[derive(Copy, Default)]
    Pose = "geometry_msgs/msg/Pose" {
        /// Where, m.
        position: Point,
        /// Turned how.
        orientation: Quaternion,
    }

    /// Three numbers with a direction.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    Vector3 = "geometry_msgs/msg/Vector3" { x: f64, y: f64, z: f64 }

    /// A force and a torque.
    #[derive(Copy, Default)]
    Wrench = "geometry_msgs/msg/Wrench" {
        /// N.
        force: Vector3,
        /// N m.
        torque: Vector3,
    }

    /// A pose at a time.
    PoseStamped = "geometry_msgs/msg/PoseStamped" {
        /// When; the frame of the pose.
        header: Header,
        /// The pose.
        pose: Pose,
    }

    /// Several poses.
    PoseArray = "geometry_msgs/msg/PoseArray" {
        /// When; the frame of the poses.
        header: Header,
        /// The poses.
        poses: Vec<Pose>,
    }

    /// Positions of joints.
    JointState = "sensor_msgs/msg/JointState" {
        /// When.
        header: Header,
        /// Names of the joints.
        name: Vec<String>,
        /// rad or m; empty = unknown.
        position: Vec<f64>,
        /// rad/s or m/s; empty = unknown.
        velocity: Vec<f64>,
        /// N m or N; empty = unknown.
        effort: Vec<f64>,
    }

    /// Where joints are to be at a time.
    JointTrajectoryPoint = "trajectory_msgs/msg/JointTrajectoryPoint" {
        /// rad or m.
        positions: Vec<f64>,
        /// rad/s or m/s; empty = left open.
        velocities: Vec<f64>,
        /// rad/s² or m/s²; empty = left open.
        accelerations: Vec<f64>,
        /// N m or N; empty = left open.
        effort: Vec<f64>,
        /// From the trajectory's stamp on.
        time_from_start: Duration,
    }

    /// A way for joints to go.
    JointTrajectory = "trajectory_msgs/msg/JointTrajectory" {
        /// When it begins; zero = at once.
        header: Header,
        /// Names of the joints.
        joint_names: Vec<String>,
        /// Where they are to be.
        points: Vec<JointTrajectoryPoint>,
    }

    /// An uncompressed image.
    Image = "sensor_msgs/msg/Image" {
        /// When taken; the camera's optical frame.
        header: Header,
        /// Rows.
        height: u32,
        /// Columns.
        width: u32,
        /// Meaning of the bytes, for instance `rgb8`.
        encoding: String,
        /// Not 0 = numbers of several bytes are big endian.
        is_bigendian: u8,
        /// Bytes from one row to the next.
        step: u32,
        /// The rows.
        data: Vec<u8>,
    }

    /// A JPEG or PNG file.
    CompressedImage = "sensor_msgs/msg/CompressedImage" {
        /// When taken; the camera's optical frame.
        header: Header,
        /// For instance `rgb8; jpeg compressed bgr8`, `jpeg`, or empty.
        format: String,
        /// The file.
        data: Vec<u8>,
    }

    /// The part of a sensor that an image shows.
    #[derive(Default)]
    RegionOfInterest = "sensor_msgs/msg/RegionOfInterest" {
        /// First column.
        x_offset: u32,
        /// First row.
        y_offset: u32,
        /// Rows; 0 = all.
        height: u32,
        /// Columns; 0 = all.
        width: u32,
        /// Whether the image is to be rectified for the region.
        do_rectify: bool,
    }

    /// A camera's geometry.
    CameraInfo = "sensor_msgs/msg/CameraInfo" {
        /// As the image's.
        header: Header,
        /// Rows of the calibrated image.
        height: u32,
        /// Columns of the calibrated image.
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
        /// Pixels added up horizontally; 0 = 1.
        binning_x: u32,
        /// Pixels added up vertically; 0 = 1.
        binning_y: u32,
        /// The part of the sensor.
        roi: RegionOfInterest,
    }

    /// A number of each point of a cloud.
    PointField = "sensor_msgs/msg/PointField" {
        /// For instance `x`.
        name: String,
        /// Bytes from the point's start.
        offset: u32,
        /// Type: 7 = float32.
        datatype: u8,
        /// Numbers under this name.
        count: u32,
    }

    /// Points with named numbers.
    PointCloud2 = "sensor_msgs/msg/PointCloud2" {
        /// When, and the frame of x, y, z.
        header: Header,
        /// 1 for an unordered cloud.
        height: u32,
        /// Points per row.
        width: u32,
        /// What a point is made of.
        fields: Vec<PointField>,
        /// Whether numbers are big endian.
        is_bigendian: bool,
        /// Bytes per point.
        point_step: u32,
        /// Bytes per row.
        row_step: u32,
        /// The points.
        data: Vec<u8>,
        /// Whether all points are valid.
        is_dense: bool,
    }

    /// The time of a simulation.
    Clock = "rosgraph_msgs/msg/Clock" {
        /// Now.
        clock: Time,
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
        /// 0 OK, 1 WARN, 2 ERROR, 3 STALE.
        level: u8,
        /// `<node>: <task>`.
        name: String,
        /// The state in words.
        message: String,
        /// The hardware or model concerned.
        hardware_id: String,
        /// Numbers behind it.
        values: Vec<KeyValue>,
    }

    /// States of a node's parts.
    DiagnosticArray = "diagnostic_msgs/msg/DiagnosticArray" {
        /// When.
        header: Header,
        /// One per part.
        status: Vec<DiagnosticStatus>,
    }

    /// A line of a node's log.
    Log = "rcl_interfaces/msg/Log" {
        /// When.
        stamp: Time,
        /// 10 debug, 20 info, 30 warn, 40 error, 50 fatal.
        level: u8,
        /// Logger.
        name: String,
        /// The line.
        msg: String,
        /// Source file.
        file: String,
        /// Source function.
        function: String,
        /// Source line.
        line: u32,
    }
}

impl Time {
    /// The instant `nanos` nanoseconds after the epoch; beyond 32 bits of seconds it stays at the last one.
    pub fn from_nanos(nanos: i64) -> Self {
        let sec = nanos.div_euclid(1_000_000_000);
        let Ok(sec) = i32::try_from(sec) else {
            return Self { sec: if sec < 0 { i32::MIN } else { i32::MAX }, nanosec: 0 };
        };
        Self { sec, nanosec: nanos.rem_euclid(1_000_000_000) as u32 }
    }

    /// Nanoseconds after the epoch.
    pub fn nanos(self) -> i64 {
        i64::from(self.sec) * 1_000_000_000 + i64::from(self.nanosec)
    }

    /// Seconds after the epoch.
    pub fn secs(self) -> f64 {
        f64::from(self.sec) + f64::from(self.nanosec) * 1e-9
    }

    /// Whether nobody set it.
    pub fn is_zero(self) -> bool {
        self == Self::default()
    }
}

impl Default for Quaternion {
    /// No rotation.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}
