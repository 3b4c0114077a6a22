//! The demo's picture: what the camera saw, the touch on the human hand, the robot with what it is to feel, and both over
//! time.

use std::path::Path;

use anyhow::{Context, Result};
use glam::DVec3;
use image::imageops::{FilterType, resize};
use image::{Rgb, RgbImage};
use plotters::prelude::*;

use super::Moment;
use crate::file;
use crate::hand::HandModel;
use crate::mujoco::{View, World};
use crate::render;
use crate::retarget::Robot;
use crate::retarget::robot::frame;

/// Size of the picture, pixels.
const SIZE: (u32, u32) = (1500, 900);
/// Height of the upper row, pixels.
const UPPER: u32 = 560;
/// Edge of one square panel, pixels.
const PANEL: u32 = 460;
/// The robot is drawn so much larger and then reduced, for smooth arrows.
const FINE: u32 = 2;
/// Length of an arrow, m per newton, and the longest, m.
const ARROW: (f64, f64) = (0.015, 0.07);
const HUMAN: RGBColor = RGBColor(30, 30, 30);
const ROBOT: RGBColor = RGBColor(31, 119, 180);

/// Writes the picture of `moments`, of which `shown` is drawn large, to `path` (PNG).
///
/// # Errors
/// If drawing or writing fails.
pub fn write(path: &Path, hand: &HandModel, robot: &mut Robot, moments: &[Moment], shown: usize) -> Result<()> {
    render::font::register();
    let robot_picture = robot_picture(robot, &moments[shown])?;
    let mut pixels = vec![255u8; (SIZE.0 * SIZE.1 * 3) as usize];
    {
        let root = BitMapBackend::with_buffer(&mut pixels, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let (upper, lower) = root.split_vertically(UPPER);
        draw_moment(&upper, hand, &robot.spec.robot, robot_picture, &moments[shown]).context("hand and robot")?;
        draw_trace(&lower, moments, moments[shown].seconds).context("force over time")?;
        root.present()?;
    }
    let picture = RgbImage::from_raw(SIZE.0, SIZE.1, pixels).context("picture buffer has another size")?;
    Ok(file::write_png(path, &picture)?)
}

type Area<'a> = DrawingArea<BitMapBackend<'a>, plotters::coord::Shift>;

fn draw_moment(area: &Area, hand: &HandModel, name: &str, robot: RgbImage, moment: &Moment) -> Result<()> {
    let peak = moment.force.iter().copied().fold(0.0f32, f32::max).max(0.05);
    let posed = hand.forward(&moment.params);
    let colors = render::force_colors(&moment.force, peak);
    let human = render::hand_picture(hand, &posed, &colors, render::View::Palmar, (PANEL, PANEL));
    let panels = [
        (format!("camera, t = {:.1} s", moment.seconds), resize(&moment.image, PANEL, PANEL, FilterType::Triangle)),
        (format!("human hand: {:.1} N on its skin", moment.human()), human),
        (format!("{name}: {:.1} N expected on its links", moment.robot()), robot),
    ];
    for (index, (title, picture)) in panels.into_iter().enumerate() {
        let x = 20 + index as i32 * (PANEL as i32 + 15);
        area.draw(&Text::new(title, (x, 18), ("sans-serif", 22)))?;
        blit(area, picture, (x, 50))?;
    }
    let bar = render::color_bar(peak, "force per vertex", (PANEL, 44));
    blit(area, bar, (20 + PANEL as i32 + 15, UPPER as i32 - 46))?;
    let note = format!("arrows: force of the world on a link, {:.0} mm per newton", 1e3 * ARROW.0);
    let at = (20 + 2 * (PANEL as i32 + 15) + 10, UPPER as i32 - 40);
    Ok(area.draw(&Text::new(note, at, ("sans-serif", 17)))?)
}

fn blit(area: &Area, picture: RgbImage, at: (i32, i32)) -> Result<()> {
    let size = picture.dimensions();
    let element = BitMapElement::with_owned_buffer(at, size, picture.into_raw());
    Ok(area.draw(&element.context("picture buffer has another size")?)?)
}

/// The robot in a moment's pose, seen on its palm, with an arrow per force.
fn robot_picture(robot: &mut Robot, moment: &Moment) -> Result<RgbImage> {
    let joints: Vec<usize> = robot.output_joints().map(|joint| robot.parts.joints[joint].qpos).collect();
    for (place, position) in joints.into_iter().zip(&moment.output.qpos) {
        robot.world.qpos_mut()[place] = *position;
    }
    robot.world.forward();
    let world = &robot.world;
    let axes = robot.wrist.world_axes(world);
    let (wrist, _) = world.body_pose(robot.wrist.body);
    let tips: Vec<DVec3> = robot.fingers.iter().map(|finger| frame::place(world, finger)).collect();
    let bases = robot.fingers.iter().filter_map(|finger| finger.joints.first());
    let bases = bases.map(|joint| world.joint_axis(*joint).0);
    let places: Vec<DVec3> = bases.chain(tips).chain([wrist]).collect();
    let ends = |less: fn(DVec3, DVec3) -> DVec3| places.iter().copied().fold(wrist, less);
    let middle = 0.5 * (ends(DVec3::min) + ends(DVec3::max));
    let reach = places.iter().map(|place| place.distance(middle)).fold(0.05, f64::max);
    // From the palm's side, a little from the thumb's, as the human hand is seen.
    let toward = axes.x_axis + 0.45 * axes.y_axis;
    let view = View { point: middle, toward, distance: 3.0 * reach };
    let small = on_paper(&view, &mut robot.world)?;
    let edge = FINE * PANEL;
    let mut large = resize(&small, edge, edge, FilterType::CatmullRom).into_raw();
    {
        let area = BitMapBackend::with_buffer(&mut large, (edge, edge)).into_drawing_area();
        let most = moment.output.feel.links.iter().map(|link| link.force.length()).fold(0.05, f64::max);
        for link in moment.output.feel.links.iter().filter(|link| link.force.length() > 0.02) {
            let Some(body) = robot.parts.bodies.iter().position(|body| body.name == link.name) else { continue };
            let (origin, rotation) = robot.world.body_pose(body);
            let place = origin + rotation * link.body_position;
            let force = rotation * link.body_force;
            let length = (ARROW.0 * force.length()).min(ARROW.1);
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

/// The robot alone, on paper.
fn on_paper(view: &View, world: &mut World) -> Result<RgbImage> {
    let mut renderer = view.renderer(world, PANEL, PANEL, true)?;
    let mut picture = renderer.render(world)?;
    let depth = renderer.depth();
    let farthest = depth.iter().copied().fold(0.0, f32::max);
    for (pixel, depth) in picture.pixels_mut().zip(&depth) {
        if *depth >= 0.99 * farthest {
            *pixel = Rgb([255, 255, 255]);
        }
    }
    Ok(picture)
}

/// An arrow with a dark rim, pixels.
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

fn draw_trace(area: &Area, moments: &[Moment], marked: f64) -> Result<()> {
    let end = moments.last().map_or(1.0, |moment| moment.seconds).max(1e-3);
    let peak = moments.iter().map(|moment| moment.human().max(moment.robot())).fold(0.5, f64::max) * 1.1;
    let mut chart = ChartBuilder::on(area)
        .margin(12)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d(0.0..end, 0.0..peak)?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .x_desc("time, s")
        .y_desc("sum of normal forces, N")
        .label_style(("sans-serif", 17))
        .axis_desc_style(("sans-serif", 19))
        .draw()?;
    chart.draw_series(LineSeries::new([(marked, 0.0), (marked, peak)], BLACK.mix(0.25)))?;
    type Value = fn(&Moment) -> f64;
    let series: [(&str, RGBColor, Value); 2] =
        [("human hand", HUMAN, Moment::human), ("robot hand, expected", ROBOT, Moment::robot)];
    for (label, color, value) in series {
        let points = moments.iter().map(|moment| (moment.seconds, value(moment)));
        chart
            .draw_series(LineSeries::new(points, color.stroke_width(2)))?
            .label(label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 24, y)], color.stroke_width(3)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperRight)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .label_font(("sans-serif", 18))
        .draw()?;
    Ok(())
}
