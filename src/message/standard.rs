//! Standard ROS 2 interface types in our messages, topics and recordings.
//!
//! Names and meaning of the fields follow `std_msgs`, `sensor_msgs`, `geometry_msgs` and the other ROS packages.

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

    /// A position, m.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    Point = "geometry_msgs/msg/Point" { x: f64, y: f64, z: f64 }

    /// A rotation.
    #[derive(Copy)]
    #[allow(missing_docs)]
    Quaternion = "geometry_msgs/msg/Quaternion" { x: f64, y: f64, z: f64, w: f64 }

    /// A position and a rotation.
    #[derive(Copy, Default)]
    Pose = "geometry_msgs/msg/Pose" {
        /// Position, m.
        position: Point,
        /// Orientation.
        orientation: Quaternion,
    }

    /// Three numbers with a direction.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    Vector3 = "geometry_msgs/msg/Vector3" { x: f64, y: f64, z: f64 }

    /// A force and a torque.
    #[derive(Copy, Default)]
    Wrench = "geometry_msgs/msg/Wrench" {
        /// Force, N.
        force: Vector3,
        /// Torque, N m.
        torque: Vector3,
    }

    /// A force and a torque at a time.
    #[derive(Default)]
    WrenchStamped = "geometry_msgs/msg/WrenchStamped" {
        /// Time, and coordinate frame of the wrench; the torque is about the frame's origin.
        header: Header,
        /// The wrench.
        wrench: Wrench,
    }

    /// A rotation and then a translation.
    #[derive(Copy, Default)]
    Transform = "geometry_msgs/msg/Transform" {
        /// Translation, m.
        translation: Vector3,
        /// Rotation.
        rotation: Quaternion,
    }

    /// Pose of a coordinate frame in its parent.
    #[derive(Default)]
    TransformStamped = "geometry_msgs/msg/TransformStamped" {
        /// Time, and name of the parent frame.
        header: Header,
        /// Name of the frame.
        child_frame_id: String,
        /// Pose of the frame in its parent.
        transform: Transform,
    }

    /// Transforms of a tree of coordinate frames.
    #[derive(Default)]
    TFMessage = "tf2_msgs/msg/TFMessage" {
        /// The transforms.
        transforms: Vec<TransformStamped>,
    }

    /// A colour with opacity, each from 0 to 1.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    ColorRGBA = "std_msgs/msg/ColorRGBA" { r: f32, g: f32, b: f32, a: f32 }

    /// Coordinates in a texture, 0 to 1.
    #[derive(Copy, Default)]
    #[allow(missing_docs)]
    UVCoordinate = "visualization_msgs/msg/UVCoordinate" { u: f32, v: f32 }

    /// A mesh file within a message.
    #[derive(Default)]
    MeshFile = "visualization_msgs/msg/MeshFile" {
        /// Name of the file.
        filename: String,
        /// Content of the file.
        data: Vec<u8>,
    }

    /// A shape to display.
    #[derive(Default)]
    Marker = "visualization_msgs/msg/Marker" {
        /// Time, and coordinate frame of `pose`.
        header: Header,
        /// Namespace of `id`.
        ns: String,
        /// Name of the marker in its namespace.
        id: i32,
        /// Kind of shape: 11 = list of triangles.
        kind: i32,
        /// 0 = add or replace, 2 = delete, 3 = delete all.
        action: i32,
        /// Pose of the shape.
        pose: Pose,
        /// Size of the shape; 1 = as given.
        scale: Vector3,
        /// Colour of the whole shape.
        color: ColorRGBA,
        /// Time for which it is shown; 0 = until it is replaced.
        lifetime: Duration,
        /// True if the shape moves with its frame.
        frame_locked: bool,
        /// Points of lists, three per triangle, m.
        points: Vec<Point>,
        /// Colour of each point; empty = that of the shape.
        colors: Vec<ColorRGBA>,
        /// Texture's address.
        texture_resource: String,
        /// Texture.
        texture: CompressedImage,
        /// Texture coordinates of each point.
        uv_coordinates: Vec<UVCoordinate>,
        /// Text of a text marker.
        text: String,
        /// Mesh's address.
        mesh_resource: String,
        /// Mesh.
        mesh_file: MeshFile,
        /// True if the mesh's own materials are used.
        mesh_use_embedded_materials: bool,
    }

    /// Shapes to display.
    #[derive(Default)]
    MarkerArray = "visualization_msgs/msg/MarkerArray" {
        /// The shapes.
        markers: Vec<Marker>,
    }

    /// A pose at a time.
    PoseStamped = "geometry_msgs/msg/PoseStamped" {
        /// Time, and coordinate frame of the pose.
        header: Header,
        /// The pose.
        pose: Pose,
    }

    /// Several poses.
    PoseArray = "geometry_msgs/msg/PoseArray" {
        /// Time, and coordinate frame of the poses.
        header: Header,
        /// The poses.
        poses: Vec<Pose>,
    }

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

    /// The time of a simulation.
    Clock = "rosgraph_msgs/msg/Clock" {
        /// Present time.
        clock: Time,
    }

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
        /// What was measured, for instance a node and a topic.
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

impl Default for Quaternion {
    /// Returns the identity.
    fn default() -> Self {
        Self { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }
    }
}
