//! Robot files: facts derived from models, errors, and every shipped file against its model.

use std::path::Path;

use egotac::hand::Side;
use egotac::mujoco::{PhysicsOptions, World};
use egotac::retarget::Robot;
use egotac::retarget::robot::source;
use egotac::retarget::robot::spec::RobotSpec;

fn robot_of(yaml: &str, mjcf: &str) -> egotac::Result<Robot> {
    let world = World::from_mjcf(mjcf, &PhysicsOptions::default())?;
    Robot::new(RobotSpec::parse(yaml)?, world, "a test".into(), Vec::new())
}

fn ratio_of(robot: &Robot, joint: &str) -> (usize, f64, f64) {
    use egotac::retarget::robot::coupling::JointDrive;
    let index = robot.parts.joints.iter().position(|j| j.name == joint).unwrap();
    match robot.coupling.joints[index] {
        JointDrive::Coupled { coordinate, ratio, offset } => (coordinate, ratio, offset),
        other => panic!("{joint}: {other:?}"),
    }
}

/// Robots whose models `make setup` fetches: name, free coordinates, fingers, side.
const FETCHED: [(&str, usize, usize, Side); 12] = [
    ("shadow_right", 18, 5, Side::Right),
    ("shadow_urdf_right", 18, 5, Side::Right),
    ("shadow_urdf_left", 18, 5, Side::Left),
    ("allegro_urdf_right", 16, 4, Side::Right),
    ("allegro_urdf_left", 16, 4, Side::Left),
    ("leap_urdf_right", 16, 4, Side::Right),
    ("leap_urdf_left", 16, 4, Side::Left),
    ("inspire_right", 6, 5, Side::Right),
    ("inspire_left", 6, 5, Side::Left),
    ("four_finger", 16, 4, Side::Right),
    ("tendon_hand", 7, 5, Side::Right),
    ("gripper", 1, 2, Side::Right),
];

#[test]
fn shipped_files_fit_their_models() {
    for (name, coordinates, fingers, side) in FETCHED {
        let robot = Robot::load(name, None).unwrap_or_else(|error| panic!("{name}: {error} (make setup fetches it)"));
        assert_eq!((robot.coupling.len(), robot.fingers.len()), (coordinates, fingers), "{name}");
        if fingers > 2 {
            assert_eq!(robot.side(), side, "{name}");
        }
        // Fingers in order, and the wrist frame orthonormal.
        assert!(robot.fingers.windows(2).all(|pair| pair[0].human < pair[1].human), "{name}");
        assert!((robot.wrist.axes.determinant().abs() - 1.0).abs() < 1e-9, "{name}");
    }
}

#[test]
fn sides_are_derived_as_the_files_say() {
    for (name, _, fingers, side) in FETCHED.iter().filter(|(_, _, fingers, _)| *fingers > 2) {
        let mut source = source::open(name, None, None).unwrap();
        source.spec.side = None;
        let robot = Robot::new(source.spec, source.world, source.origin, source.missing_meshes).unwrap();
        assert_eq!((robot.side(), robot.fingers.len()), (*side, *fingers), "{name}");
    }
}

#[test]
fn a_model_without_a_robot_file_gives_the_same_fingers() {
    for name in ["shadow_right", "shadow_urdf_right", "leap_urdf_right", "allegro_urdf_right", "inspire_right"] {
        let known = Robot::load(name, None).unwrap();
        let alone = Robot::load(&known.origin, None).unwrap();
        let tips = |robot: &Robot| -> Vec<(usize, usize)> {
            robot.fingers.iter().map(|f| (f.human, robot.parts.bodies[f.tip_body].part)).collect()
        };
        assert_eq!(tips(&alone), tips(&known), "{name}");
    }
}

#[test]
fn every_shipped_file_is_read_and_listed() {
    let mut count = 0;
    for entry in std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/robots")).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|extension| extension == "yaml") {
            let spec = RobotSpec::parse(&std::fs::read_to_string(&path).unwrap()).unwrap();
            assert_eq!(spec.robot, path.file_stem().unwrap().to_str().unwrap());
            assert!(source::names().any(|name| name == spec.robot), "{} is not part of the program", spec.robot);
            count += 1;
        }
    }
    assert_eq!(count, source::names().count());
}

#[test]
fn unknown_keys_and_names_are_refused_with_the_known_ones() {
    let error = |yaml: &str| {
        let xml = include_str!("../../sim/robots/four_finger.xml");
        robot_of(yaml, xml).unwrap_err().to_string()
    };
    let said = error("robot: x\nweigths: { tip: 1 }");
    assert!(said.contains("weigths") && said.contains("weights"), "{said}");
    let said = error("robot: x\nfingers: { index: { tip: { site: index_tpi } } }");
    assert!(said.contains("index_tpi") && said.contains("index_tip"), "{said}");
    let said = error("robot: x\nfixed_joints: { index_mpc: 0 }");
    assert!(said.contains("index_mpc") && said.contains("index_mcp"), "{said}");
    let said = error("robot: x\nfixed_joints: { index_mcp: 9 }");
    assert!(said.contains("1.7"), "{said}");
    let said = error("robot: x\nfingers: { pointer: { tip: { site: index_tip } } }");
    assert!(said.contains("pointer") && said.contains("index"), "{said}");
    let said = error("robot: x\ncouplings: [{ joint: index_dip, of: index_pop, ratio: 1 }]");
    assert!(said.contains("index_pop") && said.contains("index_pip"), "{said}");
    let said = error("robot: x\ncollision: { ignore: [[palm, thum]] }");
    assert!(said.contains("thum") && said.contains("thumb_base"), "{said}");
    let said = error("robot: x\nscale: -1");
    assert!(said.contains("scale"), "{said}");
    let said = Robot::load("no_such_robot", None).unwrap_err().to_string();
    assert!(said.contains("four_finger"), "{said}");
    let said = Robot::load("sharpa_right", None).unwrap_err().to_string();
    assert!(said.contains("EGOTAC_ROBOTS") && said.contains("sharpa_wave"), "{said}");
}

#[test]
fn tendons_and_equalities_couple_joints_by_leverage_and_springs() {
    let robot = Robot::load("tendon_hand", None).unwrap();
    // Fixed tendon, coefficients 10 and 8 mm, springs 0.05 and 0.1: (8 / 0.1) / (10 / 0.05); then 0.8 by the equality.
    for finger in ["middle", "ring", "little"] {
        let (mcp, one, _) = ratio_of(&robot, &format!("{finger}_mcp"));
        let (pip, ratio, _) = ratio_of(&robot, &format!("{finger}_pip"));
        let (dip, last, _) = ratio_of(&robot, &format!("{finger}_dip"));
        assert_eq!((mcp, pip), (pip, dip));
        assert!(
            (one - 1.0).abs() < 1e-12 && (ratio - 0.4).abs() < 1e-6 && (last - 0.32).abs() < 1e-6,
            "{ratio} {last}"
        );
    }
    // In space: both arms 10 mm at rest.
    let (_, ratio, _) = ratio_of(&robot, "index_pip");
    assert!((ratio - 0.5).abs() < 1e-3, "{ratio}");
    // Without springs by leverage: 7 mm over 9 mm.
    let (_, ratio, _) = ratio_of(&robot, "thumb_ip");
    assert!((ratio - 7.0 / 9.0).abs() < 1e-6, "{ratio}");
}

#[test]
fn a_tip_beyond_all_shapes_has_no_pad_geoms() {
    // The mesh of LEAP's rubber tips is often missing: the other shapes end before the tip.
    let hand = |tip: f64| {
        format!(
            r#"<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size=".01"/><body name="index_a" pos="0 0 .03">
            <joint name="a" axis="0 1 0" range="0 1"/><geom type="box" size=".01 .01 .015" pos="0 0 .015"/><body name="index_tip"
            pos="0 0 {tip}"/></body></body></worldbody></mujoco>"#
        )
    };
    let geoms = |fingers: &str, tip: f64| {
        let yaml = format!("robot: x\nwrist: {{ frame: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }}\n{fingers}");
        robot_of(&yaml, &hand(tip)).unwrap().fingers[0].pad_geoms.len()
    };
    assert_eq!([geoms("", 0.03), geoms("", 0.034), geoms("", 0.05)], [1, 1, 0]);
    let named = hand(0.05).replace("<geom type", r#"<geom name="g" type"#);
    let yaml = "robot: x\nwrist: { frame: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }\nfingers: { index: { tip: { body: index_tip }, pad_geoms: [g] } }";
    assert_eq!(robot_of(yaml, &named).unwrap().fingers[0].pad_geoms.len(), 1);
}

#[test]
fn couplings_that_contradict_or_leave_no_position_are_refused() {
    let hand = |range: &str, equality: &str| {
        format!(
            r#"<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size=".01"/><body name="index_a" pos="0 0 .03">
            <joint name="a" axis="0 1 0" range="0 1"/><geom size=".01"/><body name="index_b" pos="0 0 .03"><joint name="b" axis="0 1 0"
            range="{range}"/><geom size=".01"/></body></body></body></worldbody><equality>{equality}</equality></mujoco>"#
        )
    };
    let yaml = "robot: x\nwrist: { frame: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }\n";
    let line = r#"<joint joint1="b" joint2="a" polycoef="0 2 0 0 0"/>"#;
    let robot = robot_of(yaml, &hand("0 1", line)).unwrap();
    assert_eq!((robot.coupling.len(), robot.coupling.high[0]), (1, 0.5));
    let said = robot_of(yaml, &hand("3 4", line)).unwrap_err().to_string();
    assert!(said.contains("a, b"), "{said}");
    let said =
        robot_of(yaml, &hand("0 1", r#"<joint joint1="b" joint2="a" polycoef="0 1 1 0 0"/>"#)).unwrap_err().to_string();
    assert!(said.contains("line"), "{said}");
    let more = format!("{yaml}couplings: [{{ joint: b, of: a, ratio: 1 }}]");
    let said = robot_of(&more, &hand("0 1", line)).unwrap_err().to_string();
    assert!(said.contains("contradict"), "{said}");
}

#[test]
fn both_generations_of_leap_names_are_understood() {
    // Names of bodies, fingers from the thumb's side: those of newer files, then those of older ones.
    let names = [
        [
            ["if_bs", "if_px", "if_ds"],
            ["mf_bs", "mf_px", "mf_ds"],
            ["rf_bs", "rf_px", "rf_ds"],
            ["th_mp", "th_px", "th_ds"],
        ],
        [
            ["mcp_joint", "pip", "fingertip"],
            ["mcp_joint_2", "pip_2", "fingertip_2"],
            ["mcp_joint_3", "pip_3", "fingertip_3"],
            ["thumb_pip", "thumb_dip", "thumb_fingertip"],
        ],
    ];
    for names in names {
        let finger = |[a, b, c]: [&str; 3], y: f64, turn: f64| {
            format!(
                r#"<body name="{a}" pos="0 {y} .08" euler="{turn} 0 0"><joint axis="1 0 0" range="-.4 .4"/>
                <geom type="capsule" size=".008" fromto="0 0 0 0 0 .03"/>
                <body name="{b}" pos="0 0 .035"><joint axis="0 1 0" range="-.2 1.6"/><geom type="capsule" size=".008" fromto="0 0 0 0 0 .03"/>
                <body name="{c}" pos="0 0 .035"><joint axis="0 1 0" range="-.2 1.6"/><geom type="capsule" size=".008" fromto="0 0 0 0 0 .03"/>
                </body></body></body>"#
            )
        };
        let [index, middle, ring, thumb] = names;
        let fingers =
            [finger(thumb, 0.05, -1.2), finger(ring, -0.03, 0.0), finger(middle, 0.0, 0.0), finger(index, 0.03, 0.0)];
        let xml = format!(
            r#"<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size=".02"/>{}</body></worldbody></mujoco>"#,
            fingers.concat()
        );
        let robot = robot_of("robot: leap", &xml).unwrap();
        let tips: Vec<&str> = robot.fingers.iter().map(|f| robot.parts.bodies[f.tip_body].name.as_str()).collect();
        assert_eq!(tips, [thumb[2], index[2], middle[2], ring[2]]);
        assert_eq!((robot.side(), robot.takes_force[4]), (Side::Right, Some(3)));
    }
}

#[test]
fn a_new_robot_file_reads_back() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("hand.xml");
    std::fs::write(&model, include_str!("../../sim/robots/four_finger.xml")).unwrap();
    let yaml = folder.path().join("hand.yaml");
    let status = std::process::Command::new(env!("CARGO_BIN_EXE_egotac"))
        .args(["retarget", "new"])
        .arg(&model)
        .arg("--out")
        .arg(&yaml)
        .status();
    assert!(status.unwrap().success());
    let (a, b) = (Robot::load(yaml.to_str().unwrap(), None).unwrap(), Robot::load("four_finger", None).unwrap());
    assert_eq!((a.coupling.len(), a.wrist), (b.coupling.len(), b.wrist));
    assert!(a.fingers.iter().zip(&b.fingers).all(|(a, b)| a.tip.distance(b.tip) < 1e-9));
}
