//! Episodes as MJCF, MuJoCo's model format.

mod hand;
mod photo;

use glam::{DQuat, DVec3};

use super::appearance::{Appearance, Rgb};
use super::effect::{Effect, EffectSet};
use super::object::{JointMount, Mount, Piece, PieceShape};
use super::photo::PhotoDraw;
use super::randomize::{EpisodeDraw, ObjectDraw};
use super::rig::{HandRig, JOINT_NAMES};
use crate::error::Result;
use crate::text::put;

pub(crate) use photo::Files;

/// Stiffness of the wrist's linear servos, N/m; [`super::driver`] converts forces to displacements with it.
pub(crate) const WRIST_STIFFNESS: f64 = 2500.0;
/// Name of the head's mocap body and of its camera.
pub const HEAD: &str = "head";
/// Half edges of the table top, m.
pub(crate) const TABLE_HALF: DVec3 = DVec3::new(0.6, 0.45, 0.02);
/// Centre of the table top, m: its upper face is at z = 0.
pub(crate) const TABLE_CENTRE: DVec3 = DVec3::new(0.0, 0.1, -0.02);
/// Largest side of a picture, pixels.
pub(crate) const MAX_PICTURE: u32 = 1024;

/// Names of the wrist's joints without the hand's prefix: three slides along the world's axes, three hinges.
pub(crate) const WRIST: [&str; 6] = ["wrist_x", "wrist_y", "wrist_z", "wrist_rx", "wrist_ry", "wrist_rz"];

/// Half thickness below which a piece is thin, m: a card is, a mug's wall is not.
const THIN_HALF_THICKNESS: f64 = 1.6e-3;

/// Writes the model of an episode with the given effects, and the files that it names; `fovy` is the camera's vertical
/// field of view, rad.
///
/// # Errors
/// If a texture can't be encoded.
pub(crate) fn write(
    episode: &EpisodeDraw,
    rigs: &[HandRig; 2],
    effects: EffectSet,
    fovy: f64,
) -> Result<(String, Files)> {
    let shadows = effects.contains(Effect::Shadows);
    let mut assets = String::new();
    let mut world = String::new();
    let mut skins = String::new();
    let mut excludes = String::new();
    let mut actuators = String::new();
    let mut files = Files::new();
    surroundings(episode, &mut assets, &mut world, &mut files, effects)?;
    for (index, object) in episode.objects.iter().enumerate().filter(|(_, object)| object.solid) {
        match effects.contains(Effect::Textures) {
            true => photo::wrapped_material(&object.name, episode.photo.object(index), &mut assets, &mut files)?,
            false => object_material(object, &mut assets),
        }
        object_body(object, effects, &mut assets, &mut world, &mut excludes);
    }
    let photo = &episode.photo;
    for hand in &episode.hands {
        let rig = &rigs[hand.side as usize];
        let painted = effects.contains(Effect::SkinDetail).then_some(photo);
        hand::assets(hand, rig, painted, &mut assets, &mut files)?;
        hand::bodies(hand, rig, photo, effects, &mut world);
        hand::skin(hand, rig, painted, &mut skins);
        for (a, b) in &rig.excluded {
            let (a, b) = (rig.name(JOINT_NAMES[*a]), rig.name(JOINT_NAMES[*b]));
            put(&mut excludes, format_args!(r#"<exclude body1="{a}" body2="{b}"/>"#));
        }
        hand::servos(rig, &mut actuators);
    }
    let fovy = fovy.to_degrees();
    // Lens distortion resamples a larger picture.
    let max_side = if effects.contains(Effect::LensDistortion) { 2 * MAX_PICTURE } else { MAX_PICTURE };
    let shadow_map = if shadows { 1024 } else { 0 };
    let ambient = episode.appearance.ambient;
    let flag = |on: bool| if on { "enable" } else { "disable" };
    let [contact, gravity, sleep] =
        [Effect::RigidContact, Effect::Gravity, Effect::Sleep].map(|effect| flag(effects.contains(effect)));
    let text = format!(
        r#"<mujoco model="egotac">
<compiler angle="radian" autolimits="true"/>
<option><flag contact="{contact}" gravity="{gravity}" sleep="{sleep}"/></option>
<size memory="8M"/>
<statistic extent="1" center="0 0 0.1"/>
<visual>
<global offwidth="{max_side}" offheight="{max_side}"/>
<quality shadowsize="{shadow_map}" offsamples="0"/>
<map znear="0.02" zfar="6" shadowclip="0.6"/>
<headlight ambient="{ambient} {ambient} {ambient}" diffuse="0.12 0.12 0.12" specular="0 0 0"/>
</visual>
<asset>
{assets}</asset>
<worldbody>
{world}<body name="{HEAD}" mocap="true"><camera name="{HEAD}" fovy="{fovy}"/></body>
</worldbody>
<deformable>
{skins}</deformable>
<contact>
{excludes}</contact>
<actuator>
{actuators}</actuator>
</mujoco>
"#
    );
    Ok((text, files))
}

/// Contact attributes of skin and objects: dimension of friction, softness.
fn contact(effects: EffectSet) -> String {
    contact_with(effects, 0.015)
}

/// Contact attributes of a piece of an object. A thin piece (see [`THIN_HALF_THICKNESS`]) is stiffer, or a fingertip
/// would press through it: depth grows with the square of the time constant.
fn piece_contact(piece: &Piece, effects: EffectSet) -> String {
    contact_with(effects, if piece.half_thickness() < THIN_HALF_THICKNESS { 0.005 } else { 0.015 })
}

/// Contact attributes for a time constant, s.
fn contact_with(effects: EffectSet, time: f64) -> String {
    let condim = match (effects.contains(Effect::Friction), effects.contains(Effect::TorsionalFriction)) {
        (false, _) => 1,
        (true, false) => 3,
        (true, true) => 4,
    };
    format!(r#"condim="{condim}" solref="{time} 1" solimp="0.9 0.95 0.001""#)
}

/// Writes sky, table, floor, lamps and background.
fn surroundings(
    episode: &EpisodeDraw,
    assets: &mut String,
    world: &mut String,
    files: &mut Files,
    effects: EffectSet,
) -> Result<()> {
    let photo = &episode.photo;
    let textured = effects.contains(Effect::Textures);
    match textured {
        true => photo::surfaces(photo, assets, world, files)?,
        false => plain_surfaces(&episode.appearance, assets),
    }
    lamps(&episode.appearance, world, effects);
    table(world, effects);
    if !textured {
        let floor = rgb(episode.appearance.floor);
        put(
            world,
            format_args!(
                r#"<geom name="floor" type="plane" size="4 4 0.1" pos="0 0 -0.75" rgba="{floor} 1" contype="0" conaffinity="0"/>"#
            ),
        );
    }
    if effects.contains(Effect::MoreLamps) {
        photo::lamps(photo, world);
    }
    if effects.contains(Effect::Clutter) {
        photo::clutter(photo, textured, assets, world, files)?;
    }
    if effects.contains(Effect::Wearer) {
        photo::wearer(&photo.wearer, episode.camera(effects).eye, world);
    }
    Ok(())
}

/// Writes sky and table's material of plain colours and patterns.
fn plain_surfaces(appearance: &Appearance, assets: &mut String) {
    let [table, other] = appearance.table.map(rgb);
    let [up, down] = appearance.background.map(rgb);
    let (pattern, repeat) = (appearance.table_pattern, appearance.table_repeat);
    put(
        assets,
        format_args!(
            r#"<texture name="sky" type="skybox" builtin="gradient" rgb1="{up}" rgb2="{down}" width="64" height="384"/>"#
        ),
    );
    put(
        assets,
        format_args!(
            r#"<texture name="table" type="2d" builtin="{pattern}" mark="random" random="0.02" markrgb="{other}" rgb1="{table}" rgb2="{other}" width="256" height="256"/>"#
        ),
    );
    put(
        assets,
        format_args!(
            r#"<material name="table" texture="table" texrepeat="{repeat} {repeat}" specular="0.1" shininess="0.2"/>"#
        ),
    );
}

/// Writes the lamps that cast shadows.
fn lamps(appearance: &Appearance, world: &mut String, effects: EffectSet) {
    let shadows = effects.contains(Effect::Shadows);
    for (position, power) in &appearance.lamps {
        let (at, aim) = (vec3(*position), vec3((DVec3::ZERO - *position).normalize()));
        put(
            world,
            format_args!(
                r#"<light pos="{at}" dir="{aim}" diffuse="{power} {power} {power}" specular="0.1 0.1 0.1" cutoff="80" exponent="1" castshadow="{shadows}"/>"#
            ),
        );
    }
}

/// Writes the table.
fn table(world: &mut String, effects: EffectSet) {
    let contact = contact(effects);
    let [size, place] = [TABLE_HALF, TABLE_CENTRE].map(|v| format!("{} {} {}", v.x, v.y, v.z));
    put(
        world,
        format_args!(r#"<geom name="table" type="box" size="{size}" pos="{place}" material="table" {contact}/>"#),
    );
}

/// Writes the bodies of an object: fixed part, moving part, joint.
fn object_body(
    object: &ObjectDraw,
    effects: EffectSet,
    assets: &mut String,
    world: &mut String,
    excludes: &mut String,
) {
    let (name, at, turn) = (&object.name, vec3(object.position), quat(object.orientation));
    if !object.shape.base.is_empty() {
        put(world, format_args!(r#"<body name="{name}/base" pos="{at}" quat="{turn}">"#));
        pieces(object, "base", &object.shape.base, effects, assets, world);
        world.push_str("</body>\n");
        put(excludes, format_args!(r#"<exclude body1="{name}" body2="{name}/base"/>"#));
    }
    put(world, format_args!(r#"<body name="{name}" pos="{at}" quat="{turn}">"#));
    match &object.shape.mount {
        _ if !effects.contains(Effect::Dynamics) => (),
        Mount::Joint(joint) if effects.contains(Effect::Articulation) => put_joint(name, joint, world),
        // Without articulation the part is fixed.
        Mount::Joint(_) => (),
        Mount::Soft { radius, stiffness, points } if effects.contains(Effect::SoftBody) => {
            soft(object, (*radius, *stiffness, *points), effects, world);
            world.push_str("</body>\n");
            return;
        }
        Mount::Free | Mount::Soft { .. } => put(world, format_args!(r#"<freejoint name="{name}"/>"#)),
    }
    if let Some((vertices, triangles)) = &object.shape.visual {
        let vertices = join(vertices.iter().copied().map(vec3));
        let faces = join(triangles.iter().map(|[a, b, c]| format!("{a} {b} {c}")));
        put(assets, format_args!(r#"<mesh name="{name}/visual" vertex="{vertices}" face="{faces}" inertia="shell"/>"#));
        put(
            world,
            format_args!(
                r#"<geom type="mesh" mesh="{name}/visual" contype="0" conaffinity="0" mass="0" group="1" material="{name}"/>"#
            ),
        );
    }
    pieces(object, "part", &object.shape.pieces, effects, assets, world);
    world.push_str("</body>\n");
    table_pairs(object, effects, excludes);
}

/// Writes the material of an object: a colour, or a pattern of two colours.
fn object_material(object: &ObjectDraw, assets: &mut String) {
    let (name, colour) = (&object.name, rgb(object.colour));
    if let Some((pattern, other)) = &object.texture {
        let other = rgb(*other);
        put(
            assets,
            format_args!(
                r#"<texture name="{name}" type="cube" builtin="{pattern}" mark="random" random="0.03" markrgb="{other}" rgb1="{colour}" rgb2="{other}" width="64" height="64"/>"#
            ),
        );
        put(assets, format_args!(r#"<material name="{name}" texture="{name}" specular="0.4" shininess="0.6"/>"#));
    } else {
        put(assets, format_args!(r#"<material name="{name}" rgba="{colour} 1" specular="0.4" shininess="0.6"/>"#));
    }
}

/// Writes contact pairs with the table for an object whose friction there differs.
fn table_pairs(object: &ObjectDraw, effects: EffectSet, pairs: &mut String) {
    if let Some(friction) = object.table_friction.filter(|_| effects.contains(Effect::Friction)) {
        for (i, piece) in object.shape.pieces.iter().enumerate() {
            put(
                pairs,
                format_args!(
                    r#"<pair geom1="table" geom2="{0}/part{i}" friction="{friction} {friction} 0.01 0.0001 0.0001" {1}/>"#,
                    object.name,
                    piece_contact(piece, effects)
                ),
            );
        }
    }
}

/// Writes the joint of an articulated object.
fn put_joint(name: &str, joint: &JointMount, world: &mut String) {
    let JointMount { kind, axis, anchor, range: [low, high], stiffness, damping, friction } = joint;
    let (axis, anchor) = (vec3(*axis), vec3(*anchor));
    let armature = if *kind == "slide" { 0.01 } else { 1e-5 };
    put(
        world,
        format_args!(
            r#"<joint name="{name}" type="{kind}" axis="{axis}" pos="{anchor}" range="{low} {high}" stiffness="{stiffness}" damping="{damping}" frictionloss="{friction}" armature="{armature}"/>"#
        ),
    );
}

/// Writes an elastic ball: finite elements whose motion is interpolated from the corners of a box around it.
fn soft(object: &ObjectDraw, (radius, stiffness, points): (f64, f64, usize), effects: EffectSet, world: &mut String) {
    let (name, mass, friction) = (&object.name, object.mass, object.friction);
    let spacing = 2.0 * radius / (points - 1) as f64;
    // The damping is of the order of the stiffness over one step, so that the ball does not ring.
    put(
        world,
        format_args!(
            r#"<flexcomp name="{name}" type="ellipsoid" count="{points} {points} {points}" spacing="{spacing} {spacing} {spacing}" radius="0.001" mass="{mass}" dof="trilinear" dim="3" material="{name}"><elasticity young="{stiffness}" poisson="0.4" damping="0.01"/><contact selfcollide="none" priority="1" friction="{friction} 0.01 0.0001" {}/></flexcomp>"#,
            contact(effects)
        ),
    );
}

/// Writes convex pieces as geoms; mass is in proportion to volume.
fn pieces(
    object: &ObjectDraw,
    part: &str,
    pieces: &[Piece],
    effects: EffectSet,
    assets: &mut String,
    world: &mut String,
) {
    let name = &object.name;
    let volume: f64 = pieces.iter().map(Piece::volume).sum();
    for (i, piece) in pieces.iter().enumerate() {
        let shape = match &piece.shape {
            PieceShape::Box(half) => format!(r#"type="box" size="{}""#, vec3(*half)),
            PieceShape::Ball(radius) => format!(r#"type="sphere" size="{radius}""#),
            PieceShape::Cylinder(radius, half) => format!(r#"type="cylinder" size="{radius} {half}""#),
            PieceShape::Capsule(radius, half) => format!(r#"type="capsule" size="{radius} {half}""#),
            PieceShape::Hull(corners) => {
                let corners = join(corners.iter().copied().map(vec3));
                put(assets, format_args!(r#"<mesh name="{name}/{part}{i}" vertex="{corners}"/>"#));
                format!(r#"type="mesh" mesh="{name}/{part}{i}""#)
            }
        };
        let (mass, contact) = (object.mass * piece.volume() / volume, piece_contact(piece, effects));
        let group = if piece.visible { 1 } else { 3 };
        // Priority 1: the object's friction applies to each contact, not the maximum of both geoms.
        let (friction, at, turn) = (object.friction, vec3(piece.position), quat(piece.orientation));
        put(
            world,
            format_args!(
                r#"<geom name="{name}/{part}{i}" {shape} pos="{at}" quat="{turn}" mass="{mass}" group="{group}" priority="1" friction="{friction} 0.01 0.0001" material="{name}" {contact}/>"#
            ),
        );
    }
}

fn join(parts: impl Iterator<Item = String>) -> String {
    parts.collect::<Vec<_>>().join(" ")
}

fn vec3(v: DVec3) -> String {
    format!("{} {} {}", v.x, v.y, v.z)
}

fn quat(q: DQuat) -> String {
    format!("{} {} {} {}", q.w, q.x, q.y, q.z)
}

fn rgb([r, g, b]: Rgb) -> String {
    format!("{r:.4} {g:.4} {b:.4}")
}
