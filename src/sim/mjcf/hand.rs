//! A hand in MJCF: bodies, skin and servos.

use glam::DVec3;

use super::{WRIST, WRIST_STIFFNESS, contact, join, quat, rgb, vec3};
use crate::hand::N_JOINTS;
use crate::sim::effect::{Effect, EffectSet};
use crate::sim::randomize::HandDraw;
use crate::sim::rig::{HandRig, JOINT_NAMES};
use crate::text::put;

/// Distance up to which pairs without force are detected, m: the paper's 1 cm, and 4 mm by which skin may protrude from
/// the hulls.
const NEAR_DISTANCE: f64 = 0.014;

/// Writes materials and hulls of a hand.
pub(super) fn assets(hand: &HandDraw, rig: &HandRig, assets: &mut String) {
    let (skin, sleeve) = (rgb(hand.skin), rgb(hand.sleeve));
    put(
        assets,
        format_args!(r#"<material name="{}" rgba="{skin} 1" specular="0.15" shininess="0.3"/>"#, rig.name("skin")),
    );
    put(
        assets,
        format_args!(r#"<material name="{}" rgba="{sleeve} 1" specular="0" shininess="0"/>"#, rig.name("sleeve")),
    );
    if let Some(glove) = &hand.glove {
        let (name, fabric, pads) = (rig.name("glove"), rgb(glove.fabric), rgb(glove.pads));
        put(
            assets,
            format_args!(
                r#"<texture name="{name}" type="2d" builtin="checker" rgb1="{fabric}" rgb2="{pads}" width="32" height="32"/>"#
            ),
        );
        put(assets, format_args!(r#"<material name="{name}" texture="{name}" specular="0" shininess="0"/>"#));
    }
    for (joint, hull) in rig.hulls.iter().enumerate() {
        let corners = join(hull.iter().copied().map(vec3));
        let limit = rig.max_corners.map(|max| format!(r#" maxhullvert="{max}""#)).unwrap_or_default();
        put(assets, format_args!(r#"<mesh name="{}" vertex="{corners}"{limit}/>"#, rig.name(JOINT_NAMES[joint])));
    }
}

/// Writes the bodies of a hand, the wrist's joints included.
pub(super) fn bodies(hand: &HandDraw, rig: &HandRig, effects: EffectSet, world: &mut String) {
    let name = rig.name(JOINT_NAMES[0]);
    put(
        world,
        format_args!(
            r#"<body name="{name}" pos="{}" quat="{}" gravcomp="1">"#,
            vec3(hand.wrist),
            quat(hand.orientation)
        ),
    );
    for (i, word) in WRIST.iter().enumerate() {
        // Slides run along the world's axes; hinges turn about the hand's axes, the first outermost.
        let axis = if i < 3 { hand.orientation.inverse() * DVec3::AXES[i] } else { DVec3::AXES[i - 3] };
        let (kind, armature) = if i < 3 { ("slide", 0.1) } else { ("hinge", 0.002) };
        let joint = rig.name(word);
        put(
            world,
            format_args!(r#"<joint name="{joint}" type="{kind}" axis="{}" armature="{armature}"/>"#, vec3(axis)),
        );
    }
    arm(rig, world);
    link(0, rig, effects, world);
    world.push_str("</body>\n");
}

/// Writes forearm and sleeve, for the picture only.
fn arm(rig: &HandRig, world: &mut String) {
    let back = -rig.frame.fingers;
    // Centre and radius of the wrist from the vertices near the plane through its joint.
    let off = |v: &glam::Vec3| v.as_dvec3() - rig.joints[0];
    let near = rig.vertices.iter().map(off).filter(|v| v.dot(back).abs() < 0.012);
    let (centre, count) = near.clone().fold((DVec3::ZERO, 0.0), |(sum, n), v| (sum + v.reject_from(back), n + 1.0));
    let centre = centre / f64::max(count, 1.0);
    let mean_radius = near.map(|v| (v.reject_from(back) - centre).length()).sum::<f64>() / f64::max(count, 1.0);
    let radius = mean_radius.clamp(0.018, 0.04);
    let capsule = |material: &str, from: f64, to: f64, radius: f64, world: &mut String| {
        let (a, b) = (vec3(centre + back * from), vec3(centre + back * to));
        put(
            world,
            format_args!(
                r#"<geom type="capsule" fromto="{a} {b}" size="{radius}" contype="0" conaffinity="0" mass="0" group="1" material="{}"/>"#,
                rig.name(material)
            ),
        );
    };
    capsule("skin", 0.018, 0.2, 0.93 * radius, world);
    capsule("sleeve", 0.1, 0.32, 1.25 * radius, world);
}

/// Writes the geom of a link and, recursively, the bodies of its children.
fn link(joint: usize, rig: &HandRig, effects: EffectSet, world: &mut String) {
    let contact = contact(effects);
    let gap = if effects.contains(Effect::NearContact) { NEAR_DISTANCE } else { 0.0 };
    let name = rig.name(JOINT_NAMES[joint]);
    put(
        world,
        format_args!(
            r#"<geom type="mesh" mesh="{name}" group="3" density="1000" friction="1 0.01 0.0001" gap="{gap}" {contact}/>"#
        ),
    );
    for child in (0..N_JOINTS).filter(|child| rig.parent(*child) == Some(joint)) {
        let offset = vec3(rig.joints[child] - rig.joints[joint]);
        put(world, format_args!(r#"<body name="{}" pos="{offset}" gravcomp="1">"#, rig.name(JOINT_NAMES[child])));
        for hinge in rig.hinges.iter().filter(|hinge| hinge.joint == child) {
            let (name, axis, [low, high]) = (rig.name(&hinge.name), vec3(hinge.axis), hinge.range);
            put(
                world,
                format_args!(
                    r#"<joint name="{name}" type="hinge" axis="{axis}" range="{low} {high}" armature="3e-4" damping="0.005"/>"#
                ),
            );
        }
        link(child, rig, effects, world);
        world.push_str("</body>\n");
    }
}

/// Writes the skin of a hand with the model's skinning weights; a glove is the same surface, thicker and with a pattern.
pub(super) fn skin(hand: &HandDraw, rig: &HandRig, skins: &mut String) {
    let vertices = join(rig.vertices.iter().map(|v| vec3(v.as_dvec3())));
    let faces = join(rig.model.faces.iter().map(|[a, b, c]| format!("{a} {b} {c}")));
    let (name, material, cover) = match &hand.glove {
        None => (rig.name("skin"), rig.name("skin"), String::new()),
        Some(glove) => {
            // The flat hand seen from above; the checker has two squares per repeat.
            let place = |v: &glam::Vec3| f64::from(v.x) / (2.0 * glove.pitch);
            let along = |v: &glam::Vec3| f64::from(v.z) / (2.0 * glove.pitch);
            let places = join(rig.vertices.iter().map(|v| format!("{} {}", place(v), along(v))));
            let cover = format!(r#" inflate="{}" texcoord="{places}""#, glove.thickness);
            (rig.name("skin"), rig.name("glove"), cover)
        }
    };
    put(skins, format_args!(r#"<skin name="{name}" material="{material}" vertex="{vertices}" face="{faces}"{cover}>"#));
    for (joint, name) in JOINT_NAMES.iter().enumerate() {
        let weights = rig.model.lbs_weights.iter().skip(joint).step_by(N_JOINTS).enumerate().filter(|(_, w)| **w > 0.0);
        let (ids, weights): (Vec<String>, Vec<String>) = weights.map(|(v, w)| (v.to_string(), w.to_string())).unzip();
        put(
            skins,
            format_args!(
                r#"<bone body="{}" bindpos="{}" bindquat="1 0 0 0" vertid="{}" vertweight="{}"/>"#,
                rig.name(name),
                vec3(rig.joints[joint]),
                ids.join(" "),
                weights.join(" ")
            ),
        );
    }
    skins.push_str("</skin>\n");
}

/// Writes the position servos of a hand.
pub(super) fn servos(rig: &HandRig, actuators: &mut String) {
    for (i, word) in WRIST.iter().enumerate() {
        let (stiffness, damping, max_force) = if i < 3 { (WRIST_STIFFNESS, 110.0, 40.0) } else { (30.0, 0.9, 4.0) };
        servo(&rig.name(word), stiffness, damping, max_force, actuators);
    }
    for hinge in &rig.hinges {
        servo(&rig.name(&hinge.name), hinge.stiffness, hinge.damping, hinge.torque, actuators);
    }
}

fn servo(name: &str, stiffness: f64, damping: f64, max_force: f64, actuators: &mut String) {
    put(
        actuators,
        format_args!(
            r#"<position name="{name}" joint="{name}" kp="{stiffness}" kv="{damping}" forcerange="-{max_force} {max_force}"/>"#
        ),
    );
}
