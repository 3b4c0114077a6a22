//! `egotac retarget inspect` and `egotac retarget new`.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use glam::DVec3;
use serde_json::{Value, json};

use super::portrait::picture;
use super::{Inspect, New};
use crate::file;
use crate::retarget::Robot;
use crate::retarget::robot::coupling::JointDrive;
use crate::retarget::robot::fingers::Finger;
use crate::retarget::robot::spec::{FINGERS, FingerSpec, ModelSpec, RobotSpec, TipSpec};
use crate::text::tell;

/// Prints what was derived from a robot's model, and draws the robot.
///
/// # Errors
/// If the robot can't be loaded or drawn, or the picture can't be written.
pub fn inspect(args: &Inspect) -> anyhow::Result<()> {
    let mut robot = Robot::load(&args.robot, args.model.as_deref())?;
    args.json.show(&facts(&robot), || text(&robot))?;
    if let Some(out) = &args.out {
        file::write_png(out, &picture(&mut robot)?)?;
        tell(format_args!("wrote {}", out.display()));
    }
    Ok(())
}

/// Writes a YAML file for a model, with what was derived from it.
///
/// # Errors
/// If the model is not a hand, or the file can't be written.
pub fn new(args: &New) -> anyhow::Result<()> {
    let path = args.model.to_string_lossy();
    let robot = Robot::load(&path, None)?;
    let yaml = yaml(&robot, args)?;
    match &args.out {
        Some(out) => {
            file::write(out, yaml.as_bytes())?;
            println!("wrote {}", out.display());
        }
        None => print!("{yaml}"),
    }
    Ok(())
}

/// Returns a YAML file with the derived model, root, side, fingers and merges; the rest stays `auto`.
fn yaml(robot: &Robot, args: &New) -> anyhow::Result<String> {
    let model = std::path::absolute(&args.model)?;
    let is_urdf = model.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("urdf"));
    let (mjcf, urdf) = if is_urdf { (None, Some(model)) } else { (Some(model), None) };
    let fingers = robot
        .fingers
        .iter()
        .map(|finger| {
            (FINGERS[finger.human].to_owned(), FingerSpec { tip: tip(&finger.tip_name), ..FingerSpec::default() })
        })
        .collect();
    let merge = (0..5)
        .filter(|human| robot.fingers.iter().all(|finger| finger.human != *human))
        .filter_map(|human| {
            let taker = &robot.fingers[robot.takes_force[human]?];
            Some((FINGERS[human].to_owned(), FINGERS[taker.human].to_owned()))
        })
        .collect();
    let root = Some(robot.parts.bodies[robot.root].name.clone()).filter(|name| name != "world");
    let spec = RobotSpec {
        robot: robot.spec.robot.clone(),
        model: ModelSpec { mjcf, urdf, root },
        side: Some(robot.side()),
        fingers,
        merge,
        ..RobotSpec::default()
    };
    Ok(format!(
        "# Written by `egotac retarget new`. `auto` is derived from the model: `egotac retarget inspect` prints it.\n{}",
        serde_yaml::to_string(&spec)?
    ))
}

/// Returns the tip of a finger as a file names it, from [`Finger::tip_name`].
fn tip(name: &str) -> TipSpec {
    match name.split_once(' ') {
        Some(("site", site)) => TipSpec { site: Some(site.to_owned()), ..TipSpec::default() },
        Some(("body", body)) => TipSpec { body: Some(body.to_owned()), ..TipSpec::default() },
        _ => TipSpec { body: name.rsplit_once(" of ").map(|(_, body)| body.to_owned()), ..TipSpec::default() },
    }
}

/// Rounds to 0.1 mm.
fn rounded(v: DVec3) -> [f64; 3] {
    v.to_array().map(|x| (1e4 * x).round() / 1e4)
}

/// Returns what was derived, as JSON.
fn facts(robot: &Robot) -> Value {
    let fingers: BTreeMap<&str, Value> =
        robot.fingers.iter().map(|finger| (FINGERS[finger.human], finger_facts(robot, finger))).collect();
    let coordinates: Vec<Value> = (0..robot.coupling.len()).map(|k| coordinate_facts(robot, k)).collect();
    let drives = robot.parts.joints.iter().zip(&robot.coupling.joints);
    let fixed: BTreeMap<&str, f64> = drives
        .filter_map(|(joint, drive)| match drive {
            JointDrive::Fixed(position) => Some((joint.name.as_str(), *position)),
            _ => None,
        })
        .collect();
    let axes = robot.wrist.axes;
    json!({
        "robot": robot.spec.robot,
        "model": robot.origin,
        "side": robot.side().name(),
        "root": robot.parts.bodies[robot.root].name,
        "wrist": {
            "body": robot.parts.bodies[robot.wrist.body].name,
            "palmar": rounded(axes.x_axis), "radial": rounded(axes.y_axis), "distal": rounded(axes.z_axis),
        },
        "fingers": fingers,
        "coordinates": coordinates,
        "fixed_joints": fixed,
        "commands": robot.commands.names,
        "collision_pairs": robot.collision_pairs.len(),
        "shapes_left_away": robot.missing_meshes,
    })
}

fn finger_facts(robot: &Robot, finger: &Finger) -> Value {
    let joints: Vec<&str> = finger.joints.iter().map(|joint| robot.parts.joints[*joint].name.as_str()).collect();
    json!({
        "tip": finger.tip_name,
        "tip_body": robot.parts.bodies[finger.tip_body].name,
        "tip_position_m": rounded(finger.tip),
        "pad_normal": rounded(finger.pad_normal),
        "pad_geoms": finger.pad_geoms,
        "joints": joints,
        "length_m": finger.length,
        "scale": robot.scale[finger.human],
    })
}

/// Returns a free coordinate: its joint, range, and the joints that follow it as [ratio, offset].
fn coordinate_facts(robot: &Robot, k: usize) -> Value {
    let master = robot.coupling.masters[k];
    let drives = robot.coupling.joints.iter().enumerate().filter(|(joint, _)| *joint != master);
    let followers: BTreeMap<&str, [f64; 2]> = drives
        .filter_map(|(joint, drive)| match drive {
            JointDrive::Coupled { coordinate, ratio, offset } if *coordinate == k => {
                Some((robot.parts.joints[joint].name.as_str(), [*ratio, *offset]))
            }
            _ => None,
        })
        .collect();
    json!({
        "joint": robot.parts.joints[master].name,
        "range": [robot.coupling.low[k], robot.coupling.high[k]],
        "followers": followers,
    })
}

/// Returns what was derived, for people.
fn text(robot: &Robot) -> String {
    let facts = facts(robot);
    let mut text = String::new();
    let put = |text: &mut String, line: String| {
        let _ = writeln!(text, "{line}");
    };
    put(&mut text, format!("{}: {} hand, from {}", robot.spec.robot, robot.side().name(), robot.origin));
    put(&mut text, format!("root {}, wrist {}", facts["root"], facts["wrist"]));
    for finger in &robot.fingers {
        let fact = &facts["fingers"][FINGERS[finger.human]];
        put(
            &mut text,
            format!(
                "  {:7} {} joints, {:.0} mm, tip: {} at {} in {}, pad normal {}, {} geoms",
                FINGERS[finger.human],
                finger.joints.len(),
                1e3 * finger.length,
                finger.tip_name,
                fact["tip_position_m"],
                fact["tip_body"],
                fact["pad_normal"],
                finger.pad_geoms.len(),
            ),
        );
    }
    for (from, taker) in robot.takes_force.iter().enumerate() {
        let to = taker.map_or("nothing", |taker| FINGERS[robot.fingers[taker].human]);
        if to != FINGERS[from] {
            put(&mut text, format!("  force of the {} goes to {to}", FINGERS[from]));
        }
    }
    put(&mut text, format!("{} free coordinates:", robot.coupling.len()));
    for coordinate in facts["coordinates"].as_array().into_iter().flatten() {
        let (joint, range) = (&coordinate["joint"], &coordinate["range"]);
        let low = range[0].as_f64().unwrap_or(0.0);
        let high = range[1].as_f64().unwrap_or(0.0);
        let followers: Vec<String> = coordinate["followers"]
            .as_object()
            .into_iter()
            .flatten()
            .map(|(name, line)| format!("{name} = {line}"))
            .collect();
        let followers = if followers.is_empty() { String::new() } else { format!("; {}", followers.join(", ")) };
        put(&mut text, format!("  {:24} {low:.3} to {high:.3}{followers}", joint.as_str().unwrap_or_default()));
    }
    if facts["fixed_joints"].as_object().is_some_and(|fixed| !fixed.is_empty()) {
        put(&mut text, format!("fixed joints: {}", facts["fixed_joints"]));
    }
    put(&mut text, format!("commands: {}", robot.commands.names.join(", ")));
    put(&mut text, format!("{} pairs of geoms are kept apart", robot.collision_pairs.len()));
    if !robot.missing_meshes.is_empty() {
        put(&mut text, format!("meshes missing or of an unknown format: {}", robot.missing_meshes.join(", ")));
    }
    text
}
