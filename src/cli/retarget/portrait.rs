//! Picture of a robot hand with its tips, pads, axes and names: `egotac retarget inspect --out`.

use ::image::{GenericImage, Rgb, RgbImage};
use glam::DVec3;
use plotters::style::RGBColor;

use crate::mujoco::{FreeCamera, Renderer};
use crate::render::color::{INK, PAPER};
use crate::render::font::{self, Align};
use crate::render::plot::PALETTE;
use crate::retarget::Robot;
use crate::retarget::robot::spec::FINGERS;

/// Width and height of one view, pixels: the most that a model allows which does not ask for more.
const VIEW: u32 = 480;
/// Colour behind the robot.
const GROUND: Rgb<u8> = Rgb([240, 240, 236]);
/// Colour of tips and their names.
const TIP: Rgb<u8> = color(1);
/// Colour of the pads' normals.
const PAD: Rgb<u8> = color(0);
/// Names and colours of the wrist's axes, in the order of [`crate::retarget::robot`]'s frame.
const AXES: [(&str, Rgb<u8>); 3] = [("palmar", color(3)), ("radial", color(2)), ("distal", color(5))];
/// Length of a pad's normal and of an axis, m.
const NORMAL: f64 = 0.02;
const AXIS: f64 = 0.04;
/// Share of the view that the robot fills.
const FILLED: f64 = 0.8;
/// Height of texts, pixels.
const TEXT: f64 = 15.0;
/// Depth from which on a pixel shows no robot, as a multiple of the camera's distance.
const BEHIND: f64 = 6.0;
/// Steps in which joints close.
const POSES: [(f64, &str); 2] = [(0.0, "at rest"), (0.5, "half closed")];

/// Draws the robot at rest and half closed, seen from the palm and the thumb's side: tips with their fingers' names, the
/// outward normals of the pads, and the axes of the wrist.
///
/// # Errors
/// If OpenGL fails.
pub fn picture(robot: &mut Robot) -> anyhow::Result<RgbImage> {
    let mut sheet = RgbImage::from_pixel(POSES.len() as u32 * VIEW, VIEW, PAPER);
    for (column, (share, title)) in POSES.into_iter().enumerate() {
        close(robot, share);
        let axes = robot.wrist.world_axes(&robot.world);
        let camera = framed(robot, 0.8 * axes.x_axis + 0.6 * axes.y_axis);
        let mut renderer = Renderer::free(&robot.world, &camera, (VIEW, VIEW), true)?;
        let mut view = renderer.render(&mut robot.world)?;
        let behind = (BEHIND * camera.distance) as f32;
        for (pixel, depth) in view.pixels_mut().zip(renderer.depth()) {
            if depth > behind {
                *pixel = GROUND;
            }
        }
        annotate(&mut view, robot, &camera);
        font::draw(&mut view, &format!("{} {title}", robot.spec.robot), (12, 10), TEXT + 2.0, INK, Align::Left);
        sheet.copy_from(&view, column as u32 * VIEW, 0)?;
    }
    Ok(sheet)
}

/// Moves each coordinate from rest by `share` of its way to the farther end of its range.
fn close(robot: &mut Robot, share: f64) {
    let coupling = robot.coupling.clone();
    let position = |k: usize| {
        let (low, high, rest) = (coupling.low[k], coupling.high[k], robot.rest[k]);
        let far = if high - rest > rest - low { high } else { low };
        rest + share * (far - rest)
    };
    let positions: Vec<f64> = (0..coupling.len()).map(position).collect();
    coupling.expand(&robot.parts, &positions, robot.world.qpos_mut());
    robot.world.forward();
}

/// Returns a camera in direction `toward` whose view the robot's hand fills.
fn framed(robot: &Robot, toward: DVec3) -> FreeCamera {
    // The hand's links, tips and wrist, with the geoms' bounding spheres around the links.
    let mut spheres: Vec<(DVec3, f64)> = vec![(robot.world.body_pose(robot.wrist.body).0, 0.02)];
    for finger in &robot.fingers {
        spheres.push((finger.tip_position(&robot.world), NORMAL));
        spheres.extend(finger.links.iter().map(|link| (robot.world.body_pose(*link).0, 0.015)));
    }
    let (low, high) = spheres.iter().fold((DVec3::MAX, DVec3::MIN), |(low, high), (centre, radius)| {
        (low.min(*centre - DVec3::splat(*radius)), high.max(*centre + DVec3::splat(*radius)))
    });
    let mut camera = FreeCamera { point: 0.5 * (low + high), toward, distance: 1.0 };
    // Far away the size of the picture falls with the distance: two steps are enough.
    for _ in 0..4 {
        let ends = spheres.iter().filter_map(|(centre, _)| pixel(robot, &camera, *centre));
        let half = 0.5 * f64::from(VIEW);
        let reach = ends.map(|(x, y)| (x - half).abs().max((y - half).abs())).fold(1.0, f64::max);
        camera.distance *= (reach / (FILLED * half)).clamp(0.1, 10.0);
    }
    camera
}

fn pixel(robot: &Robot, camera: &FreeCamera, point: DVec3) -> Option<(f64, f64)> {
    camera.pixel(&robot.world, point, (f64::from(VIEW), f64::from(VIEW)))
}

/// Draws axes, pads, tips and names.
fn annotate(view: &mut RgbImage, robot: &Robot, camera: &FreeCamera) {
    let mut taken: Vec<[f64; 4]> = vec![[0.0, 0.0, f64::from(VIEW), 36.0]];
    let (wrist, axes) = (robot.world.body_pose(robot.wrist.body).0, robot.wrist.world_axes(&robot.world));
    let mut names = Vec::new();
    for ((name, color), axis) in AXES.into_iter().zip([axes.x_axis, axes.y_axis, axes.z_axis]) {
        if let Some(end) = arrow(view, robot, camera, wrist, AXIS * axis, color) {
            names.push((name, end, color));
        }
    }
    for finger in &robot.fingers {
        let tip = finger.tip_position(&robot.world);
        arrow(view, robot, camera, tip, NORMAL * finger.world_pad_normal(&robot.world), PAD);
        if let Some(at) = pixel(robot, camera, tip) {
            disc(view, at, 5.0, PAPER);
            disc(view, at, 4.0, TIP);
            names.push((FINGERS[finger.human], at, TIP));
        }
    }
    // Tips and ends of axes stay free of names.
    taken.extend(names.iter().map(|(_, (x, y), _)| [x - 6.0, y - 6.0, x + 6.0, y + 6.0]));
    for (name, at, color) in names {
        label(view, name, at, color, &mut taken);
    }
    font::draw(
        view,
        "vermilion: tip   blue: outward normal of the pad",
        (12, VIEW as i32 - 24),
        13.0,
        INK,
        Align::Left,
    );
}

/// Draws a line from `from` along `by`, and returns the pixel of its end.
fn arrow(
    view: &mut RgbImage,
    robot: &Robot,
    camera: &FreeCamera,
    from: DVec3,
    by: DVec3,
    color: Rgb<u8>,
) -> Option<(f64, f64)> {
    let (start, end) = (pixel(robot, camera, from)?, pixel(robot, camera, from + by)?);
    let steps = (end.0 - start.0).hypot(end.1 - start.1).ceil().clamp(1.0, f64::from(2 * VIEW)) as u32;
    for step in 0..=steps {
        let share = f64::from(step) / f64::from(steps);
        disc(view, (start.0 + share * (end.0 - start.0), start.1 + share * (end.1 - start.1)), 1.5, color);
    }
    disc(view, end, 3.0, color);
    Some(end)
}

fn disc(view: &mut RgbImage, (x, y): (f64, f64), radius: f64, color: Rgb<u8>) {
    let around = |middle: f64| (middle - radius).floor() as i64..=(middle + radius).ceil() as i64;
    for (column, row) in around(x).flat_map(|column| around(y).map(move |row| (column, row))) {
        let within = (column as f64 - x).hypot(row as f64 - y) <= radius;
        if let (true, Ok(column), Ok(row)) = (within, u32::try_from(column), u32::try_from(row))
            && column < view.width()
            && row < view.height()
        {
            view.put_pixel(column, row, color);
        }
    }
}

/// Writes a name beside a point, at the nearest place where it covers no other; `taken` holds left, top, right and lower edges.
fn label(view: &mut RgbImage, name: &str, (x, y): (f64, f64), color: Rgb<u8>, taken: &mut Vec<[f64; 4]>) {
    let (width, height) = (f64::from(font::width(name, TEXT)), TEXT + 2.0);
    let limit = f64::from(VIEW);
    let place = |distance: f64, turn: f64| {
        let (dx, dy) = (turn.cos() * (distance + width / 2.0), turn.sin() * distance);
        let left = (x + dx - width / 2.0).clamp(4.0, limit - width - 4.0);
        let top = (y + dy - height / 2.0).clamp(40.0, limit - height - 30.0);
        [left, top, left + width, top + height]
    };
    let is_free = |[left, top, right, low]: &[f64; 4]| {
        taken.iter().all(|other| *right < other[0] || other[2] < *left || *low < other[1] || other[3] < *top)
    };
    let turns = (0..16).map(|k| f64::from(k) * std::f64::consts::TAU / 16.0);
    let places = (0..12).flat_map(|ring| turns.clone().map(move |turn| place(14.0 + 10.0 * f64::from(ring), turn)));
    let at = places.into_iter().find(|place| is_free(place)).unwrap_or_else(|| place(14.0, 0.0));
    font::draw_on(view, name, (at[0] as i32, at[1] as i32), TEXT, [color, GROUND], Align::Left);
    taken.push(at);
}

/// Returns a colour of the common palette.
const fn color(index: usize) -> Rgb<u8> {
    let RGBColor(red, green, blue) = PALETTE[index];
    Rgb([red, green, blue])
}
