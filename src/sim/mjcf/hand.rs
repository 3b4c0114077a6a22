//! A hand in MJCF: bodies, skin and servos.

use glam::DVec3;

use super::photo::{self, Files};
use super::{PhotoDraw, WRIST, WRIST_STIFFNESS, contact, join, quat, rgb, vec3};
use crate::error::Result;
use crate::hand::N_JOINTS;
use crate::sim::effect::{Effect, EffectSet};
use crate::sim::photo::Flat;
use crate::sim::randomize::HandDraw;
use crate::sim::rig::{HandRig, JOINT_NAMES};
use crate::text::put;

/// Distance up to which pairs without force are detected, m: the paper's 1 cm, and 4 mm by which skin may protrude from
/// the hulls.
const NEAR_DISTANCE: f64 = 0.014;

/// Half sizes of a nail, m: across, along, thickness.
const NAIL: DVec3 = DVec3::new(0.0045, 0.0055, 0.0012);

/// Writes materials and hulls of a hand; `painted`: the looks, if the skin or the glove has a painted texture.
///
/// # Errors
/// If a texture can't be encoded.
pub(super) fn assets(
    hand: &HandDraw,
    rig: &HandRig,
    painted: Option<&PhotoDraw>,
    assets: &mut String,
    files: &mut Files,
) -> Result<()> {
    if let Some(look) = painted {
        let picture = look.cover.paint(rig, hand.skin, look.skin_seed);
        photo::painted(&rig.name("cover"), "2d", &picture, 1.0, 0.15, assets, files)?;
        let nail = rgb([hand.skin[0] * 1.05, hand.skin[1] * 0.95, hand.skin[2] * 0.95].map(|c| c.min(1.0)));
        put(
            assets,
            format_args!(r#"<material name="{}" rgba="{nail} 1" specular="0.6" shininess="0.7"/>"#, rig.name("nail")),
        );
    }
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
    Ok(())
}

/// Writes the bodies of a hand, the wrist's joints included.
pub(super) fn bodies(hand: &HandDraw, rig: &HandRig, look: &PhotoDraw, effects: EffectSet, world: &mut String) {
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
    let (centre, radius) = arm(rig, effects.contains(Effect::Wearer).then_some(look.wearer.sleeve), world);
    if let Some(tracker) = look.wearer.tracker.as_ref().filter(|_| effects.contains(Effect::Wearer)) {
        photo::tracker(tracker, rig, centre, radius, world);
    }
    let nails = effects.contains(Effect::SkinDetail) && look.cover.shows_nails();
    link(0, rig, nails, effects, world);
    world.push_str("</body>\n");
}

/// Writes forearm and sleeve, for the picture only; `sleeve`: the share of the forearm that it covers, where that is
/// drawn. Returns centre and radius of the forearm at the wrist, m.
fn arm(rig: &HandRig, sleeve: Option<f64>, world: &mut String) -> (DVec3, f64) {
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
    let start = sleeve.map_or(0.1, |share| 0.2 - 0.16 * share);
    // Where the wearer is seen, the sleeve reaches the elbow.
    let end = if sleeve.is_some() { 0.5 } else { 0.32 };
    capsule("sleeve", start, end, 1.25 * radius, world);
    (centre, radius)
}

/// Writes the geom of a link and, recursively, the bodies of its children.
fn link(joint: usize, rig: &HandRig, nails: bool, effects: EffectSet, world: &mut String) {
    let contact = contact(effects);
    let gap = if effects.contains(Effect::NearContact) { NEAR_DISTANCE } else { 0.0 };
    let name = rig.name(JOINT_NAMES[joint]);
    put(
        world,
        format_args!(
            r#"<geom type="mesh" mesh="{name}" group="3" density="1000" friction="1 0.01 0.0001" gap="{gap}" {contact}/>"#
        ),
    );
    if nails && let Some((place, turn)) = rig.nail(joint) {
        put(
            world,
            format_args!(
                r#"<geom type="ellipsoid" size="{}" pos="{}" quat="{}" material="{}" contype="0" conaffinity="0" mass="0" group="1"/>"#,
                vec3(NAIL),
                vec3(place),
                quat(turn),
                rig.name("nail")
            ),
        );
    }
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
        link(child, rig, nails, effects, world);
        world.push_str("</body>\n");
    }
}

/// Writes the skin of a hand with the model's skinning weights; a glove is the same surface, thicker and with a pattern.
/// `painted`: the looks, if the surface has a painted texture.
pub(super) fn skin(hand: &HandDraw, rig: &HandRig, painted: Option<&PhotoDraw>, skins: &mut String) {
    let vertices = join(rig.vertices.iter().map(|v| vec3(v.as_dvec3())));
    let faces = join(rig.model.faces.iter().map(|[a, b, c]| format!("{a} {b} {c}")));
    let (name, material, cover) = match (painted, &hand.glove) {
        (Some(look), _) => {
            let flat = Flat::of(rig);
            let places = join(rig.vertices.iter().map(|v| flat.place(*v)).map(|[u, v]| format!("{u} {v}")));
            let cover = format!(r#" inflate="{}" texcoord="{places}""#, look.cover.thickness());
            (rig.name("skin"), rig.name("cover"), cover)
        }
        (None, None) => (rig.name("skin"), rig.name("skin"), String::new()),
        (None, Some(glove)) => {
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
