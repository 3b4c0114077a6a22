//! `egotac retarget inspect` and `egotac retarget new`.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use ::image::{GenericImage, RgbImage};
use glam::DVec3;
use serde_json::{Value, json};

use super::{Inspect, New};
use crate::file;
use crate::mujoco::{FreeCamera, Renderer};
use crate::retarget::Robot;
use crate::retarget::robot::coupling::JointDrive;
use crate::retarget::robot::fingers::Finger;
use crate::retarget::robot::spec::{FINGERS, FingerSpec, ModelSpec, RobotSpec, TipSpec};
use crate::text::tell;

/// Width and height of one view, px.
const VIEW: u32 = 480;

/// Prints what was derived from a robot's model, and draws the robot.
///
/// # Errors
/// If the robot can't be loaded or drawn, or the picture can't be written.
pub fn inspect(args: &Inspect) -> anyhow::Result<()> {
    let mut robot = Robot::load(&args.robot, args.model.as_deref())?;
    match args.json {
        true => println!("{:#}", facts(&robot)),
        false => print!("{}", text(&robot)),
    }
    if let Some(out) = &args.out {
        file::write_png(out, &picture(&mut robot)?)?;
        tell(format_args!("wrote {}", out.display()));
    }
    Ok(())
}

/// Writes a YAML file for a model, with what was derived from it.
///
/// # Errors
/// If the model is no hand, or the file can't be written.
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

/// Draws the robot at rest and half closed, seen from the palm and the thumb's side.
fn picture(robot: &mut Robot) -> anyhow::Result<RgbImage> {
    let axes = robot.wrist.world_axes(&robot.world);
    let tips: Vec<DVec3> = robot.fingers.iter().map(|finger| finger.tip_position(&robot.world)).collect();
    let (wrist, _) = robot.world.body_pose(robot.wrist.body);
    let middle = (tips.iter().sum::<DVec3>() / tips.len() as f64 + wrist) / 2.0;
    let reach = tips.iter().map(|tip| tip.distance(middle)).fold(0.05, f64::max);
    let mut sheet = RgbImage::new(2 * VIEW, VIEW);
    for (column, share) in [0.0, 0.5].into_iter().enumerate() {
        let coupling = robot.coupling.clone();
        let u: Vec<f64> = (0..coupling.len())
            .map(|k| {
                let far = if coupling.high[k] - robot.rest[k] > robot.rest[k] - coupling.low[k] {
                    coupling.high[k]
                } else {
                    coupling.low[k]
                };
                robot.rest[k] + share * (far - robot.rest[k])
            })
            .collect();
        coupling.expand(&robot.parts, &u, robot.world.qpos_mut());
        robot.world.forward();
        let toward = 0.8 * axes.x_axis + 0.6 * axes.y_axis;
        let view = FreeCamera { point: middle, toward, distance: 4.5 * reach };
        let mut renderer = Renderer::free(&robot.world, &view, (VIEW, VIEW), false)?;
        sheet.copy_from(&renderer.render(&mut robot.world)?, column as u32 * VIEW, 0)?;
    }
    Ok(sheet)
}
