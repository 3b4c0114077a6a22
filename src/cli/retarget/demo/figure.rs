//! Picture of the demo: camera image, touch on the human hand, touch expected on the robot, and both over time.

use std::path::Path;

use anyhow::{Context, Result};
use glam::DVec3;
use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage};
use plotters::prelude::*;

use super::Moment;
use crate::cli::sheet::{Bar, PANEL, Series, Sheet};
use crate::hand::HandModel;
use crate::mujoco::{FreeCamera, Renderer, World};
use crate::render;
use crate::render::plot::PALETTE;
use crate::retarget::Robot;

/// Factor by which the robot is drawn larger and then reduced, to smooth the arrows.
const OVERSAMPLING: u32 = 2;
/// Length of an arrow per force, m/N.
const ARROW_PER_NEWTON: f64 = 0.015;
/// Greatest length of an arrow, m: about that of a finger.
const MAX_ARROW: f64 = 0.07;
/// Least force that is drawn, N.
const MIN_DRAWN_FORCE: f64 = 0.02;
/// Share of the greatest depth beyond which a pixel is background.
const BACKGROUND_DEPTH: f32 = 0.99;
const HUMAN: RGBColor = RGBColor(30, 30, 30);
const ROBOT: RGBColor = PALETTE[0];

/// Draws the moment `shown` in full and all `moments` over time, to `path` (PNG).
///
/// # Errors
/// If drawing or writing fails.
pub fn write(path: &Path, hand: &HandModel, robot: &mut Robot, moments: &[Moment], shown: usize) -> Result<()> {
    render::font::register();
    let moment = &moments[shown];
    let peak = moment.force.iter().copied().fold(0.05, f32::max);
    let colors = render::force_colors(&moment.force, peak);
    let human =
        render::hand_picture(hand, &hand.forward(&moment.params), &colors, render::View::Palmar, (PANEL, PANEL));
    let robot_title = format!("{}: {:.1} N expected on its links", robot.spec.robot, moment.robot());
    let series = |name: &str, color, value: fn(&Moment) -> f64| Series {
        name: name.into(),
        color,
        points: moments.iter().map(|moment| (moment.seconds, value(moment))).collect(),
    };
    let sheet = Sheet {
        panels: [
            (format!("camera, t = {:.1} s", moment.seconds), moment.image.clone()),
            (format!("human hand: {:.1} N on its skin", moment.human()), human),
            (robot_title, robot_picture(robot, moment)?),
        ],
        bar: Bar { peak, label: "force per vertex, N", column: 1.0 },
        note: vec![format!("arrows: force of the world on a link, {:.0} mm per newton", 1e3 * ARROW_PER_NEWTON)],
        axis: "sum of normal forces, N",
        series: [series("human hand", HUMAN, Moment::human), series("robot hand, expected", ROBOT, Moment::robot)],
        shown: moment.seconds,
    };
    Ok(sheet.write(path)?)
}

type Area<'a> = DrawingArea<BitMapBackend<'a>, plotters::coord::Shift>;

/// Draws the robot in a moment's pose, seen from its palm, with an arrow for each force.
fn robot_picture(robot: &mut Robot, moment: &Moment) -> Result<RgbImage> {
    let joints: Vec<usize> = robot.output_joints().map(|joint| robot.parts.joints[joint].qpos).collect();
    for (place, position) in joints.into_iter().zip(&moment.output.qpos) {
        robot.world.qpos_mut()[place] = *position;
    }
    robot.world.forward();
    let world = &robot.world;
    let axes = robot.wrist.world_axes(world);
    let (wrist, _) = world.body_pose(robot.wrist.body);
    let tips: Vec<DVec3> = robot.fingers.iter().map(|finger| finger.tip_position(world)).collect();
    let bases = robot.fingers.iter().filter_map(|finger| finger.joints.first());
    let bases = bases.map(|joint| world.joint_axis(*joint).0);
    let places: Vec<DVec3> = bases.chain(tips).chain([wrist]).collect();
    let ends = |less: fn(DVec3, DVec3) -> DVec3| places.iter().copied().fold(wrist, less);
    let middle = 0.5 * (ends(DVec3::min) + ends(DVec3::max));
    let reach = places.iter().map(|place| place.distance(middle)).fold(0.05, f64::max);
    // The human hand is drawn from the same side: the palm's, a little from the thumb's.
    let toward = axes.x_axis + 0.45 * axes.y_axis;
    let view = FreeCamera { point: middle, toward, distance: 3.0 * reach };
    let small = on_white(&view, &mut robot.world)?;
    let edge = OVERSAMPLING * PANEL;
    let mut large = resize(&small, edge, edge, FilterType::CatmullRom).into_raw();
    {
        let area = BitMapBackend::with_buffer(&mut large, (edge, edge)).into_drawing_area();
        let most = moment.output.expected_touch.links.iter().map(|link| link.force.length()).fold(0.05, f64::max);
        for link in moment.output.expected_touch.links.iter().filter(|link| link.force.length() > MIN_DRAWN_FORCE) {
            let Some(body) = robot.parts.bodies.iter().position(|body| body.name == link.name) else { continue };
            let (origin, rotation) = robot.world.body_pose(body);
            let place = origin + rotation * link.body_position;
            let force = rotation * link.body_force;
            let length = (ARROW_PER_NEWTON * force.length()).min(MAX_ARROW);
            let from = place - length * force.normalize_or_zero();
            let size = (f64::from(edge), f64::from(edge));
            let ends = [from, place].map(|end| view.pixel(&robot.world, end, size));
            if let [Some(from), Some(to)] = ends {
                let Rgb([r, g, b]) = render::force_color(link.force.length() as f32, most as f32);
                draw_arrow(&area, from, to, RGBColor(r, g, b))?;
            }
        }
        area.present()?;
    }
    let large = RgbImage::from_raw(edge, edge, large).context("picture buffer has another size")?;
    Ok(resize(&large, PANEL, PANEL, FilterType::Triangle))
}

/// Draws the robot alone, on a white background.
fn on_white(view: &FreeCamera, world: &mut World) -> Result<RgbImage> {
    let mut renderer = Renderer::free(world, view, (PANEL, PANEL), true)?;
    let mut picture = renderer.render(world)?;
    let depth = renderer.depth();
    let farthest = depth.iter().copied().fold(0.0, f32::max);
    for (pixel, depth) in picture.pixels_mut().zip(&depth) {
        if *depth >= BACKGROUND_DEPTH * farthest {
            *pixel = Rgb([255, 255, 255]);
        }
    }
    Ok(picture)
}

/// Draws an arrow with a dark rim; positions in px.
fn draw_arrow(area: &Area, from: (f64, f64), to: (f64, f64), color: RGBColor) -> Result<()> {
    let (dx, dy) = (to.0 - from.0, to.1 - from.1);
    let length = dx.hypot(dy).max(1e-9);
    let (ux, uy) = (dx / length, dy / length);
    for (shaft, head, color) in [(7.0, 17.0, BLACK), (4.5, 13.0, color)] {
        let at = |along: f64, side: f64| {
            ((to.0 - along * ux - side * uy).round() as i32, (to.1 - along * uy + side * ux).round() as i32)
        };
        let neck = 1.6 * head;
        let tail = length.max(neck);
        let outline = [
            at(-2.0, 0.0),
            at(neck, head),
            at(neck, shaft),
            at(tail, shaft),
            at(tail, -shaft),
            at(neck, -shaft),
            at(neck, -head),
        ];
        area.draw(&Polygon::new(outline.to_vec(), color.filled()))?;
    }
    Ok(())
}
