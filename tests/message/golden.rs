//! Messages serialise to the same bytes as in ROS 2: rclpy wrote `tests/data/message/*.cdr` (`make_golden.py`).

use std::fmt::Debug;
use std::path::Path;

use egotac::message::*;

fn header(frame_id: &str) -> Header {
    Header { stamp: Time { sec: 1_700_000_000, nanosec: 123_456_789 }, frame_id: frame_id.into() }
}

fn left() -> HandTactile {
    HandTactile {
        side: HandTactile::LEFT,
        score: 0.75,
        force: std::array::from_fn(|i| i as f32 / 128.0),
        contact: std::array::from_fn(|i| (i % 5) as f32 / 4.0),
        total_force: (0..778).sum::<i32>() as f32 / 128.0,
    }
}

fn frame() -> TactileFrame {
    let right = HandTactile {
        side: HandTactile::RIGHT,
        score: f32::NAN,
        force: [f32::NAN; 778],
        contact: [0.0; 778],
        total_force: f32::NAN,
    };
    TactileFrame {
        header: header("camera_optical"),
        hands: vec![left(), right],
        sequence: (1 << 40) + 7,
        inference_secs: 0.015625,
        model_id: "egotac-small/0123456789ab".into(),
        topology: "egotac-hand-1".into(),
        warming_up: true,
        familiarity: 0.625,
        reason: "left: no hand".into(),
    }
}

fn hand_pose() -> HandPose {
    HandPose {
        header: header("world"),
        side: 1,
        topology: "egotac-hand-1".into(),
        wrist: Pose {
            position: Point { x: 0.25, y: -0.5, z: 0.75 },
            orientation: Quaternion { x: 0.5, y: -0.5, z: 0.5, w: 0.5 },
        },
        hand_pose: std::array::from_fn(|i| i as f32 / 64.0),
        betas: std::array::from_fn(|i| 0.0 - i as f32 / 8.0),
        confidence: 0.875,
    }
}

/// Checks that we write the same bytes as ROS, but for padding at the end, and that the bytes of ROS read back to the same message.
fn agrees<M: Message + Debug>(name: &str, message: &M) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/message").join(format!("{name}.cdr"));
    let golden = std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let written = message.to_cdr();
    let differs = golden.iter().zip(&written).position(|(a, b)| a != b);
    assert_eq!(differs, None, "{name}: first different byte");
    // ROS pads a message of fixed size to a multiple of four bytes.
    let padding = golden
        .get(written.len()..)
        .unwrap_or_else(|| panic!("{name}: {} bytes too many", written.len() - golden.len()));
    assert!(padding.len() < 4 && padding.iter().all(|byte| *byte == 0), "{name}: {padding:?} is missing");
    let read = M::from_cdr(&golden).unwrap();
    // Compare debug text, in which NaN equals NaN.
    assert_eq!(format!("{read:?}"), format!("{message:?}"), "{name}");
}

#[test]
fn own_messages_have_the_bytes_of_ros() {
    agrees("tactile_frame", &frame());
    agrees(
        "tactile_frame_empty",
        &TactileFrame {
            header: Header::default(),
            hands: vec![],
            sequence: 0,
            inference_secs: f64::NAN,
            model_id: String::new(),
            topology: String::new(),
            warming_up: false,
            familiarity: f32::NAN,
            reason: String::new(),
        },
    );
    agrees("hand_tactile", &left());
    agrees(
        "tactile_truth",
        &TactileTruth {
            header: header("camera_optical"),
            frame: frame(),
            validity: 4,
            reason: "too deep: 7 mm".into(),
        },
    );
    agrees(
        "tactile_regions",
        &TactileRegions {
            header: header("camera_optical"),
            force: std::array::from_fn(|i| i as f32 / 8.0),
            contact: std::array::from_fn(|i| (i % 5) as f32 / 4.0),
            presence: [1.0, f32::NAN],
        },
    );
    agrees(
        "hand_model_info",
        &HandModelInfo {
            interface_version: HandModelInfo::INTERFACE_VERSION,
            header: header(""),
            model_id: "m".into(),
            model_name: "Modell für Hände".into(),
            weights_sha256: "0".repeat(64),
            hand_model: "egotac built-in hand".into(),
            topology: "mano".into(),
            vertex_count: 778,
            vertex_region: ["thumb_tip", "palm", "", "dorsal"].map(String::from).to_vec(),
            region_names: ["left_thumb_tip", "right_palm"].map(String::from).to_vec(),
            horizon: 4,
            frame_dt: 0.04,
            input_size: 98,
            force_scale: 1.5,
        },
    );
    agrees("hand_pose", &hand_pose());
    let right = HandPose { side: 1, ..hand_pose() };
    let left = HandPose { side: 0, confidence: f32::NAN, ..right.clone() };
    agrees("hand_poses", &HandPoses { header: header("world"), poses: vec![left, right] });
    agrees(
        "glove_reading",
        &GloveReading {
            header: header("glove"),
            side: HandTactile::RIGHT,
            values: vec![0.5, f32::NAN, 3.0],
            rest: vec![0.25],
            newtons_per_unit: vec![-2.0],
            full: vec![8.0],
        },
    );
    let contact = TactileContact {
        header: header("world"),
        name: "left_index_tip".into(),
        position: Point { x: 0.25, y: -0.5, z: 0.75 },
        normal: Vector3 { x: 0.0, y: 0.0, z: -1.0 },
        wrench: Wrench { force: Vector3 { x: 0.0, y: 0.0, z: 2.0 }, torque: Vector3 { x: -1.0, y: -0.5, z: 0.0 } },
    };
    let unknown = Vector3 { x: f64::NAN, y: f64::NAN, z: f64::NAN };
    let other = TactileContact {
        header: header("world"),
        name: "left_palm".into(),
        position: Point::default(),
        normal: Vector3::default(),
        wrench: Wrench { force: unknown, torque: Vector3::default() },
    };
    agrees(
        "tactile_contacts",
        &TactileContacts { header: header("world"), known: [true, false], contacts: vec![contact, other] },
    );
    agrees(
        "hand_keypoints",
        &HandKeypoints {
            header: header("camera_optical"),
            width: 640,
            height: 480,
            presence: [0.875, 0.5],
            x: std::array::from_fn(|i| i as f32 / 4.0),
            y: std::array::from_fn(|i| i as f32 / 8.0),
            confidence: std::array::from_fn(|i| if i < 21 { f32::NAN } else { i as f32 / 64.0 }),
        },
    );
    agrees(
        "trainer_status",
        &TrainerStatus {
            header: header(""),
            state: TrainerStatus::TRAINING.into(),
            message: "".into(),
            recorded_frames: 1000,
            recorded_episodes: 10,
            evicted_episodes: 3,
            recorded_bytes: 1 << 33,
            step: 40,
            steps: 200,
            names: vec!["loss".into(), "pooled.f1".into()],
            values: vec![0.5, f64::NAN],
            windows_per_s: 62.5,
            remaining_secs: 12.25,
        },
    );
    agrees(
        "tactile_metrics",
        &TactileMetrics {
            header: header("camera_optical"),
            window_pairs: 50,
            window_secs: 1.96,
            pairs: 100,
            unmatched_predictions: 1,
            unmatched_truths: 2,
            invalid_truths: 3,
            names: vec!["mae".into(), "pooled.f1".into()],
            values: vec![0.0125, f64::NAN],
        },
    );
}

#[test]
fn robot_messages_have_the_bytes_of_ros() {
    let thumb = LinkTouch {
        link: "thumb_distal".into(),
        normal_force: 2.0,
        wrench: Wrench {
            force: Vector3 { x: -2.0, y: 0.5, z: 0.25 },
            torque: Vector3 { x: 0.0, y: 0.125, z: -0.0625 },
        },
        position: Point { x: 0.5, y: 0.0, z: 0.03125 },
        contact: 0.75,
    };
    let palm = LinkTouch {
        link: "palm".into(),
        normal_force: 0.0,
        wrench: Wrench::default(),
        position: Point::default(),
        contact: 0.0,
    };
    agrees(
        "robot_touch",
        &RobotTouch {
            header: header("world"),
            robot: "four_finger".into(),
            hand_stamp: Time { sec: 1_700_000_000, nanosec: 120_000_000 },
            links: vec![thumb, palm],
            joint_names: vec!["thumb_cmc".into(), "index_mcp".into()],
            joint_torques: vec![0.25, -0.5],
            clipped: true,
            net_force: Vector3 { x: 1.0, y: -2.0, z: 3.0 },
            left_out: 0.5,
        },
    );
    let turned = Quaternion { x: 0.5, y: -0.5, z: 0.5, w: 0.5 };
    let poses = vec![
        Pose { position: Point { x: 0.25, y: -0.5, z: 0.75 }, ..Pose::default() },
        Pose { orientation: turned, ..Pose::default() },
    ];
    let pose = Pose { position: Point { x: 0.25, y: -0.5, z: 0.75 }, orientation: turned };
    agrees("pose_stamped", &PoseStamped { header: header("world"), pose });
    agrees("pose_array", &PoseArray { header: header("world"), poses });
    let names = vec!["a".to_owned(), "b".to_owned()];
    agrees(
        "joint_state",
        &JointState {
            header: header(""),
            name: names.clone(),
            position: vec![0.5, -0.25],
            velocity: vec![0.125, 2.0],
            effort: vec![1.0],
        },
    );
    let point = JointTrajectoryPoint {
        positions: vec![0.5, -0.25],
        velocities: vec![1.0],
        accelerations: vec![2.0, 4.0],
        effort: vec![3.0],
        time_from_start: Duration { sec: 2, nanosec: 16_666_667 },
    };
    agrees("bool", &Bool { data: true });
    let dim = vec![MultiArrayDimension { label: "joint".into(), size: 2, stride: 2 }];
    let layout = MultiArrayLayout { dim, data_offset: 1 };
    agrees("float64_multi_array", &Float64MultiArray { layout, data: vec![0.5, -0.25, 3.0] });
    let dim = vec![MultiArrayDimension { label: "taxel".into(), size: 3, stride: 3 }];
    let layout = MultiArrayLayout { dim, data_offset: 0 };
    agrees("float32_multi_array", &Float32MultiArray { layout, data: vec![0.5, -0.25, 3.0] });
    agrees("joint_trajectory", &JointTrajectory { header: Header::default(), joint_names: names, points: vec![point] });
}

#[test]
fn camera_messages_have_the_bytes_of_ros() {
    agrees(
        "image",
        &Image {
            header: header("camera_optical"),
            height: 2,
            width: 3,
            encoding: "rgb8".into(),
            is_bigendian: 0,
            step: 10,
            data: (0..20).collect(),
        },
    );
    agrees(
        "compressed_image",
        &CompressedImage { header: header("camera_optical"), format: "jpeg".into(), data: vec![255, 216, 255] },
    );
    agrees(
        "camera_info",
        &CameraInfo {
            header: header("camera_optical"),
            height: 240,
            width: 320,
            distortion_model: "plumb_bob".into(),
            d: vec![0.5, 0.25, 0.0, 0.0, 0.125],
            k: std::array::from_fn(|i| i as f64),
            r: std::array::from_fn(|i| (10 + i) as f64),
            p: std::array::from_fn(|i| (20 + i) as f64),
            binning_x: 1,
            binning_y: 2,
            roi: RegionOfInterest { x_offset: 1, y_offset: 2, height: 3, width: 4, do_rectify: true },
        },
    );
    agrees(
        "point_cloud2",
        &PointCloud2 {
            header: header("world"),
            height: 1,
            width: 2,
            fields: vec![PointField { name: "x".into(), offset: 0, datatype: 7, count: 1 }],
            is_bigendian: false,
            point_step: 4,
            row_step: 8,
            data: (0..8).collect(),
            is_dense: true,
        },
    );
}

#[test]
fn node_messages_have_the_bytes_of_ros() {
    agrees("clock", &Clock { clock: Time { sec: 12, nanosec: 40_000_000 } });
    agrees(
        "log",
        &Log {
            stamp: Time { sec: 3, nanosec: 4 },
            level: 30,
            name: "predictor".into(),
            msg: "image: step 5".into(),
            file: "f.rs".into(),
            function: String::new(),
            line: 7,
        },
    );
    let status = DiagnosticStatus {
        level: 1,
        name: "predictor: input".into(),
        message: "slow".into(),
        hardware_id: "cpu".into(),
        values: vec![KeyValue { key: "rate".into(), value: "24.9".into() }],
    };
    agrees("diagnostic_array", &DiagnosticArray { header: header(""), status: vec![status] });
}

#[test]
fn constants_have_the_values_of_their_msg_files() {
    let states = [
        ("IDLE", TrainerStatus::IDLE),
        ("WAITING", TrainerStatus::WAITING),
        ("TRAINING", TrainerStatus::TRAINING),
        ("SUCCEEDED", TrainerStatus::SUCCEEDED),
        ("CANCELLED", TrainerStatus::CANCELLED),
        ("FAILED", TrainerStatus::FAILED),
    ];
    for (name, value) in states {
        assert!(TrainerStatus::definition().contains(&format!("string {name}=\"{value}\"\n")), "{name}");
    }
    let version = format!("uint16 INTERFACE_VERSION={}\n", HandModelInfo::INTERFACE_VERSION);
    assert!(HandModelInfo::definition().contains(&version));
}

#[test]
fn display_messages_have_the_bytes_of_ros() {
    let vector = |x, y, z| Vector3 { x, y, z };
    let pose = Pose {
        position: Point { x: 0.25, y: -0.5, z: 0.75 },
        orientation: Quaternion { x: 0.5, y: -0.5, z: 0.5, w: 0.5 },
    };
    let wrench = Wrench { force: vector(1.0, -2.0, 3.0), torque: vector(0.5, 0.25, -0.125) };
    agrees("wrench_stamped", &WrenchStamped { header: header("left_thumb"), wrench });
    let transform = TransformStamped {
        header: header("world"),
        child_frame_id: "camera".into(),
        transform: Transform { translation: vector(0.25, -0.5, 0.75), rotation: pose.orientation },
    };
    let statistics = (1..=5).map(|data_type| StatisticDataPoint { data_type, data: 0.5 * f64::from(data_type) });
    let metrics = MetricsMessage {
        measurement_source_name: "/predictor:/image".into(),
        metrics_source: "message_age".into(),
        unit: "ms".into(),
        window_start: Time { sec: 1_700_000_000, nanosec: 5 },
        window_stop: Time { sec: 1_700_000_001, nanosec: 6 },
        statistics: statistics.collect(),
    };
    agrees("metrics_message", &metrics);
    agrees("tf_message", &TFMessage { transforms: vec![transform.clone(), transform] });
    let marker = Marker {
        header: header("world"),
        ns: "touch".into(),
        id: 1,
        kind: 11,
        action: 0,
        pose,
        scale: vector(1.0, 1.0, 1.0),
        color: ColorRGBA { r: 0.5, g: 0.25, b: 0.125, a: 1.0 },
        lifetime: Duration { sec: 1, nanosec: 500 },
        frame_locked: true,
        points: vec![Point { x: 1.0, y: 2.0, z: 3.0 }],
        colors: vec![ColorRGBA { r: 0.0, g: 1.0, b: 0.5, a: 0.75 }],
        texture_resource: "a".into(),
        texture: CompressedImage { header: header(""), format: "png".into(), data: vec![1, 2, 3] },
        uv_coordinates: vec![UVCoordinate { u: 0.5, v: 0.25 }],
        text: "text".into(),
        mesh_resource: "package://a".into(),
        mesh_file: MeshFile { filename: "b.obj".into(), data: vec![4, 5] },
        mesh_use_embedded_materials: true,
    };
    agrees("marker_array", &MarkerArray { markers: vec![marker] });
}

/// Returns the fields of a `.msg` file without comments, constants and alignment.
fn fields_of(definition: &str) -> String {
    let lines = definition.lines().map(|line| line.split('#').next().unwrap_or_default());
    let fields = lines.filter(|line| !line.contains('=') || line.contains("<=")).map(str::split_whitespace);
    fields.map(|words| words.collect::<Vec<_>>().join(" ") + "\n").filter(|line| line != "\n").collect()
}

#[test]
fn structs_have_the_fields_of_their_msg_files() {
    // The files name types of their own package without the package.
    let check = |definition: String, fields: String| {
        assert_eq!(fields_of(&definition).replace("egotac_msgs/", ""), fields.replace("egotac_msgs/", ""));
    };
    check(HandTactile::definition(), HandTactile::fields());
    check(TactileFrame::definition(), TactileFrame::fields());
    check(HandModelInfo::definition(), HandModelInfo::fields());
    check(HandPose::definition(), HandPose::fields());
    check(HandPoses::definition(), HandPoses::fields());
    check(TactileRegions::definition(), TactileRegions::fields());
    check(TactileTruth::definition(), TactileTruth::fields());
    check(TactileMetrics::definition(), TactileMetrics::fields());
    check(GloveReading::definition(), GloveReading::fields());
    check(TrainerStatus::definition(), TrainerStatus::fields());
    check(TactileContact::definition(), TactileContact::fields());
    check(TactileContacts::definition(), TactileContacts::fields());
    check(HandKeypoints::definition(), HandKeypoints::fields());
    check(LinkTouch::definition(), LinkTouch::fields());
    check(RobotTouch::definition(), RobotTouch::fields());
}

#[test]
fn a_schema_holds_each_type_once() {
    let schema = TactileTruth::schema();
    let sections: Vec<_> = schema.split(&"=".repeat(80)).collect();
    assert!(sections[0].contains("TactileFrame frame"));
    let mut names: Vec<_> =
        sections[1..].iter().map(|text| text.trim_start().lines().next().unwrap_or_default()).collect();
    names.sort();
    assert_eq!(
        names,
        [
            "MSG: builtin_interfaces/Time",
            "MSG: egotac_msgs/HandTactile",
            "MSG: egotac_msgs/TactileFrame",
            "MSG: std_msgs/Header"
        ]
    );
    assert!(schema.contains("MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"));
}
