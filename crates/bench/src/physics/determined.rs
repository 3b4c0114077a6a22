//! Picture of the forces that motion determines, and of those that it does not.

use egotac::error::Result;
use egotac::hand::Side;
use egotac::physics::contacts::Contact;
use egotac::physics::frame::estimate;
use egotac::physics::motion::Kinematics;
use egotac::physics::patch::{Patch, Pusher};
use egotac::physics::{Demand, Pose, PoseNoise, RigidBody, Settings};
use egotac::render::figure::{Drawn, Figure};
use egotac::render::font::FAMILY;
use egotac::render::plot::{ACCENT, PALETTE};
use egotac::statistics::percentile;
use glam::{DVec3, Vec3};
use plotters::coord::Shift;
use plotters::prelude::*;

/// Half edge of the box, m.
const HALF: f64 = 0.03;
/// Mass of the box, kg.
const MASS: f64 = 0.2;
/// Length of an arrow per force, m/N.
const SCALE: f64 = 0.014;

/// Force of one link in a picture.
#[derive(Debug, Clone)]
struct Arrow {
    /// Place in the plane of the picture, m, and direction of the force on the box.
    place: (f64, f64),
    direction: (f64, f64),
    /// Mean and ends of the 90 % interval, N.
    force: [f64; 3],
    determined: bool,
}

/// One grip with its forces.
#[derive(Debug, Clone)]
struct Grip {
    title: &'static str,
    caption: String,
    table: bool,
    arrows: Vec<Arrow>,
}

/// The picture.
#[derive(Debug, Clone)]
pub struct Determined(Vec<Grip>);

impl Determined {
    /// Estimates the forces of three grips of a box at rest.
    ///
    /// # Errors
    /// None in practice: the box is a valid mesh.
    pub fn new() -> Result<Self> {
        let below = [(-0.012, -0.01), (0.012, -0.01), (0.0, 0.014)].map(|(x, y)| DVec3::new(x, y, -HALF));
        let side = |x: f64| DVec3::new(x, 0.0, 0.0);
        let palm = contact(Pusher::Link(Side::Right, 0), &below, DVec3::NEG_Z);
        let finger = contact(Pusher::Link(Side::Right, 3), &[side(HALF)], DVec3::X);
        let thumb = contact(Pusher::Link(Side::Right, 15), &[side(-HALF)], DVec3::NEG_X);
        let table = contact(Pusher::Fixed(0), &below, DVec3::NEG_Z);
        let top = contact(Pusher::Link(Side::Right, 3), &[DVec3::Z * HALF], DVec3::Z);
        Ok(Self(vec![
            grip("On the palm", false, &[palm])?,
            grip("Between two fingers", false, &[finger, thumb])?,
            grip("A finger on a box on the table", true, &[table, top])?,
        ]))
    }
}

fn contact(pusher: Pusher, places: &[DVec3], outward: DVec3) -> Contact {
    let points = places.iter().map(|place| (*place, outward)).collect();
    Contact { patch: Patch { pusher, gap: 0.0, points }, probability: 1.0, deep: false }
}

fn grip(title: &'static str, table: bool, contacts: &[Contact]) -> Result<Grip> {
    let corner = |i: u32| {
        let sign = |bit: u32| (i >> bit & 1) as f32 * 2.0 - 1.0;
        Vec3::new(sign(0), sign(1), sign(2)) * HALF as f32
    };
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    let body = RigidBody::from_mesh("box", (0..8).map(corner).collect(), triangles)?.with_mass(MASS, 0.0)?;
    let state = Kinematics {
        pose: Pose::IDENTITY,
        velocity: DVec3::ZERO,
        acceleration: DVec3::ZERO,
        angular_velocity: DVec3::ZERO,
        angular_acceleration: DVec3::ZERO,
        acceleration_sd: DVec3::splat(0.05),
        angular_acceleration_sd: DVec3::splat(0.1),
        pose_sd: PoseNoise::default(),
    };
    let settings = Settings { samples: 400, ..Settings::default() };
    let Some(mass) = body.mass else { return Ok(Grip { title, caption: String::new(), table, arrows: Vec::new() }) };
    let found = estimate(&body, &Demand::of(&mass, &state, DVec3::NEG_Z * 9.81), contacts, None, &settings);
    let arrows: Vec<Arrow> = found
        .links
        .iter()
        .map(|link| {
            let n = link.points.len() as f64;
            let place = link.points.iter().map(|(place, ..)| *place).sum::<DVec3>() / n;
            let inward = -link.points[0].1;
            let quantile = |q: f64| percentile(link.samples.iter().copied(), q);
            let mean = link.samples.iter().sum::<f64>() / link.samples.len() as f64;
            Arrow {
                place: (place.x, place.z),
                direction: (inward.x, inward.z),
                force: [mean, quantile(0.05), quantile(0.95)],
                determined: link.remaining < 0.1,
            }
        })
        .collect();
    let carried = found.hand_force.z.max(0.0);
    let caption = format!("the hand carries {carried:.2} N of {:.2} N", MASS * 9.81);
    Ok(Grip { title, caption, table, arrows })
}

impl Figure for Determined {
    const SIZE: (u32, u32) = (1200, 440);

    fn draw<B: DrawingBackend>(&self, root: &DrawingArea<B, Shift>) -> Drawn<()>
    where
        B::ErrorType: 'static,
    {
        root.fill(&WHITE)?;
        for (area, grip) in root.split_evenly((1, self.0.len())).iter().zip(&self.0) {
            let mut chart = ChartBuilder::on(area).margin(10).build_cartesian_2d(-0.1..0.1, -0.09..0.11)?;
            let text = |size: i32| (FAMILY, size).into_font();
            let box_style = RGBColor(90, 100, 110).mix(0.25).filled();
            chart.draw_series([Rectangle::new([(-HALF, -HALF), (HALF, HALF)], box_style)])?;
            if grip.table {
                chart
                    .draw_series([Rectangle::new([(-0.09, -HALF - 0.006), (0.09, -HALF)], BLACK.mix(0.5).filled())])?;
            }
            for arrow in &grip.arrows {
                let color = if arrow.determined { PALETTE[2] } else { ACCENT };
                // Arrows end at the skin and point into the box: the longer, the farther outside they begin.
                let start = |force: f64| {
                    (
                        arrow.place.0 - arrow.direction.0 * SCALE * force,
                        arrow.place.1 - arrow.direction.1 * SCALE * force,
                    )
                };
                let [mean, low, high] = arrow.force;
                chart.draw_series([PathElement::new([start(low), start(high)], color.mix(0.3).stroke_width(18))])?;
                chart.draw_series([PathElement::new([start(mean), arrow.place], color.stroke_width(4))])?;
                let across = (-arrow.direction.1 * 0.004, arrow.direction.0 * 0.004);
                let back = (arrow.place.0 - arrow.direction.0 * 0.008, arrow.place.1 - arrow.direction.1 * 0.008);
                let head =
                    vec![arrow.place, (back.0 + across.0, back.1 + across.1), (back.0 - across.0, back.1 - across.1)];
                chart.draw_series([Polygon::new(head, color.filled())])?;
                let words = format!("{mean:.1} N, {low:.1} to {high:.1}");
                let at = match arrow.direction.1.abs() > 0.5 {
                    true => (arrow.place.0 + 0.012, start(mean).1),
                    false => (
                        arrow.place.0 - arrow.direction.0 * 0.005 - if arrow.direction.0 < 0.0 { 0.0 } else { 0.058 },
                        arrow.place.1 + 0.014,
                    ),
                };
                chart.draw_series([Text::new(words, at, text(15).color(&color))])?;
            }
            chart.draw_series([Text::new(grip.title, (-0.095, 0.108), text(20).color(&BLACK))])?;
            chart.draw_series([Text::new(grip.caption.clone(), (-0.095, 0.096), text(15).color(&BLACK))])?;
        }
        let text = |words: &'static str, x: i32, color: RGBColor| {
            Text::new(words, (x, 418), (FAMILY, 15).into_font().color(&color))
        };
        root.draw(&text("determined by motion", 20, PALETTE[2]))?;
        root.draw(&text("not determined: from how people grip; band: 90 % interval of the normal force", 200, ACCENT))?;
        root.present()?;
        Ok(())
    }
}
