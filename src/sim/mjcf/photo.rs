//! Textures, clutter, the wearer and further lamps in MJCF.

use ::image::codecs::png::{CompressionType, FilterType, PngEncoder};
use ::image::{ImageEncoder, RgbImage};
use glam::DVec3;

use super::{TABLE_CENTRE, TABLE_HALF, join, quat, rgb, vec3};
use crate::error::{Error, Result};
use crate::sim::object::TriangleMesh;
use crate::sim::photo::{Material, PhotoDraw, PropShape, Tracker, Wearer};
use crate::sim::rig::HandRig;
use crate::text::put;

/// Half side of the room, m, and the height of its floor.
const ROOM: f64 = 2.6;
const FLOOR: f64 = -0.75;
/// Attributes of geoms that are only seen.
const SEEN_ONLY: &str = r#"contype="0" conaffinity="0" mass="0" group="1""#;
/// Number of straight pieces of a wire.
const WIRE_PIECES: usize = 6;

/// Files that a model names, in memory: name and content.
pub(crate) type Files = Vec<(String, Vec<u8>)>;

/// Writes a material with a picture, and its file.
///
/// # Errors
/// If the picture can't be encoded.
pub(super) fn material(
    name: &str,
    material: &Material,
    picture: &RgbImage,
    assets: &mut String,
    files: &mut Files,
) -> Result<()> {
    painted(name, "2d", picture, material.repeat, material.gloss, assets, files)
}

/// Writes a material whose texture wraps around the geom, and its file.
///
/// # Errors
/// If the picture can't be encoded.
pub(super) fn wrapped_material(name: &str, material: &Material, assets: &mut String, files: &mut Files) -> Result<()> {
    painted(name, "cube", &material.paint(), 1.0, material.gloss, assets, files)
}

/// Writes a texture file, its texture and a material of the same name.
pub(super) fn painted(
    name: &str,
    kind: &str,
    picture: &RgbImage,
    repeat: f64,
    gloss: f64,
    assets: &mut String,
    files: &mut Files,
) -> Result<()> {
    let file = texture_file(name, picture, files)?;
    put(assets, format_args!(r#"<texture name="{name}" type="{kind}" file="{file}"/>"#));
    put(
        assets,
        format_args!(
            r#"<material name="{name}" texture="{name}" texrepeat="{repeat} {repeat}" specular="{gloss}" shininess="0.4"/>"#
        ),
    );
    Ok(())
}

/// Writes sky, table's and floor's material, and the room's walls.
///
/// # Errors
/// If a picture can't be encoded.
pub(super) fn surfaces(photo: &PhotoDraw, assets: &mut String, world: &mut String, files: &mut Files) -> Result<()> {
    material("table", &photo.table, &photo.table_picture(), assets, files)?;
    material("floor", &photo.floor, &photo.floor_picture(), assets, files)?;
    material("wall", &photo.wall, &photo.wall_picture(), assets, files)?;
    put(assets, format_args!(r#"<texture name="sky" type="skybox" file="wall.png"/>"#));
    let height = 0.5 * (ROOM - FLOOR);
    for (index, (x, y)) in [(ROOM, 0.0), (-ROOM, 0.0), (0.0, ROOM)].into_iter().enumerate() {
        let size = if x == 0.0 { DVec3::new(ROOM, 0.02, height) } else { DVec3::new(0.02, ROOM, height) };
        let at = DVec3::new(x, y, FLOOR + height);
        put(
            world,
            format_args!(
                r#"<geom name="wall{index}" type="box" size="{}" pos="{}" material="wall" {SEEN_ONLY}/>"#,
                vec3(size),
                vec3(at)
            ),
        );
    }
    put(
        world,
        format_args!(
            r#"<geom name="floor" type="plane" size="4 4 0.1" pos="0 0 {FLOOR}" material="floor" contype="0" conaffinity="0"/>"#
        ),
    );
    Ok(())
}

/// Writes the objects of the background; their colour is one if there are no textures.
///
/// # Errors
/// If a picture can't be encoded.
pub(super) fn clutter(
    photo: &PhotoDraw,
    textured: bool,
    assets: &mut String,
    world: &mut String,
    files: &mut Files,
) -> Result<()> {
    for (index, prop) in photo.props.iter().enumerate() {
        let name = format!("prop{index}");
        match textured {
            true => wrapped_material(&name, &prop.material, assets, files)?,
            false => put(assets, format_args!(r#"<material name="{name}" rgba="{} 1"/>"#, rgb(prop.material.base))),
        }
        let half = prop.half_size;
        let (kind, size) = match prop.shape {
            PropShape::Box => ("box", vec3(half)),
            PropShape::Cylinder => ("cylinder", format!("{} {}", half.x, half.z)),
            PropShape::Ellipsoid => ("ellipsoid", vec3(half)),
            PropShape::Mesh(index) => ("mesh", prop_mesh(&name, &photo.meshes[index], half, assets)),
        };
        let size_or_mesh = if kind == "mesh" { format!(r#"mesh="{size}""#) } else { format!(r#"size="{size}""#) };
        put(
            world,
            format_args!(
                r#"<geom name="{name}" type="{kind}" {size_or_mesh} pos="{}" quat="{}" material="{name}" {SEEN_ONLY}/>"#,
                vec3(prop.position),
                quat(prop.orientation)
            ),
        );
    }
    Ok(())
}

/// Writes a mesh of the user, scaled so that its bounding box has the half size `half`, m; returns its name.
fn prop_mesh(name: &str, (vertices, triangles): &TriangleMesh, half: DVec3, assets: &mut String) -> String {
    let reach = vertices.iter().fold(DVec3::ZERO, |reach, vertex| reach.max(vertex.abs()));
    let scale = half.max_element() / reach.max_element();
    let vertices = join(vertices.iter().map(|vertex| vec3(scale * *vertex)));
    let faces = join(triangles.iter().map(|[a, b, c]| format!("{a} {b} {c}")));
    put(assets, format_args!(r#"<mesh name="{name}/mesh" vertex="{vertices}" face="{faces}" inertia="shell"/>"#));
    format!("{name}/mesh")
}

/// Writes further lamps.
pub(super) fn lamps(photo: &PhotoDraw, world: &mut String) {
    for (position, colour) in &photo.lamps {
        let aim = vec3((TABLE_CENTRE - *position).normalize());
        put(
            world,
            format_args!(
                r#"<light pos="{}" dir="{aim}" diffuse="{}" specular="0.1 0.1 0.1" cutoff="80" exponent="1" castshadow="false"/>"#,
                vec3(*position),
                rgb(*colour)
            ),
        );
    }
}

/// Writes trunk and thighs of the wearer, who sits or stands before the table's near edge.
pub(super) fn wearer(wearer: &Wearer, eye: DVec3, world: &mut String) {
    let near_edge = TABLE_CENTRE.y - TABLE_HALF.y;
    let front = (eye.y - wearer.behind).min(near_edge);
    let (shirt, trousers, width) = (rgb(wearer.shirt), rgb(wearer.trousers), wearer.half_width);
    let depth = 0.6 * width;
    put(
        world,
        format_args!(
            r#"<geom name="trunk" type="ellipsoid" size="{width} {depth} 0.36" pos="0 {} -0.1" rgba="{shirt} 1" {SEEN_ONLY}/>"#,
            front - depth
        ),
    );
    for (name, side) in [("left_thigh", -1.0), ("right_thigh", 1.0)] {
        let hip = vec3(DVec3::new(side * 0.5 * width, front - depth, -0.36));
        let knee = vec3(DVec3::new(side * 0.9 * width, front + 0.32, -0.33));
        put(
            world,
            format_args!(
                r#"<geom name="{name}" type="capsule" fromto="{hip} {knee}" size="0.075" rgba="{trousers} 1" {SEEN_ONLY}/>"#
            ),
        );
    }
}

/// Writes a tracker on a wrist with its wires to the fingers' roots, in the frame of the hand's root body.
///
/// `centre` and `radius`, m: of the forearm's section at the wrist.
pub(super) fn tracker(tracker: &Tracker, rig: &HandRig, centre: DVec3, radius: f64, world: &mut String) {
    let (back, side) = (-rig.frame.palm, rig.frame.thumb);
    let out = (back * tracker.turn.cos() + side * tracker.turn.sin()).normalize();
    let along = -rig.frame.fingers;
    let (half, colour) = (tracker.half_size, rgb(tracker.colour));
    let at = centre + along * 0.035 + out * (radius + 0.6 * half);
    let turn = quat(glam::DQuat::from_rotation_arc(DVec3::Z, out));
    let (kind, size) = match tracker.is_box {
        true => ("box", format!("{half} {half} {}", 0.7 * half)),
        false => ("cylinder", format!("{half} {}", 0.3 * half)),
    };
    put(
        world,
        format_args!(
            r#"<geom type="{kind}" size="{size}" pos="{}" quat="{turn}" rgba="{colour} 1" {SEEN_ONLY}/>"#,
            vec3(at)
        ),
    );
    let band = [centre + along * 0.022, centre + along * 0.048].map(vec3);
    put(
        world,
        format_args!(
            r#"<geom type="cylinder" fromto="{} {}" size="{}" rgba="{colour} 1" {SEEN_ONLY}/>"#,
            band[0],
            band[1],
            1.04 * radius
        ),
    );
    for (index, wire) in tracker.wires.iter().enumerate() {
        let aside = side * 0.012 * (index as f64 - 1.0);
        let end = centre + rig.frame.fingers * 0.05 + back * 0.02 + aside;
        // An arc that rises between tracker and hand.
        let place = |t: f64| at + (end - at) * t + out * 0.03 * (std::f64::consts::PI * t).sin() + aside * t;
        for piece in 0..WIRE_PIECES {
            let ends = [piece, piece + 1].map(|k| vec3(place(k as f64 / WIRE_PIECES as f64)));
            put(
                world,
                format_args!(
                    r#"<geom type="capsule" fromto="{} {}" size="0.0013" rgba="{} 1" {SEEN_ONLY}/>"#,
                    ends[0],
                    ends[1],
                    rgb(*wire)
                ),
            );
        }
    }
}

/// Encodes a texture as a file of the model; returns the file's name.
fn texture_file(name: &str, picture: &RgbImage, files: &mut Files) -> Result<String> {
    let file = format!("{}.png", name.replace('/', "_"));
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Fast, FilterType::NoFilter)
        .write_image(picture.as_raw(), picture.width(), picture.height(), ::image::ExtendedColorType::Rgb8)
        .map_err(|error| Error::Engine(format!("texture {name}: {error}")))?;
    files.push((file.clone(), bytes));
    Ok(file)
}
