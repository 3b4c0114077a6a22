//! Shape of robot fingertips, and where they are nearest to something.

use glam::{DMat3, DVec3};

use crate::retarget::robot::Robot;
use crate::retarget::robot::fingers::Finger;

/// Length of the end of a fingertip whose thickness is measured, m.
const END_LENGTH: f64 = 0.015;

/// Ball in the end of a fingertip, as thick as the fingertip.
#[derive(Debug, Clone, Copy)]
pub(super) struct TipBall {
    /// Centre in the tip body's frame, m.
    pub centre: DVec3,
    /// Radius, m.
    pub radius: f64,
}

impl TipBall {
    /// Fits the ball to the geoms of a fingertip in the present pose; None without geoms.
    pub fn fit(robot: &Robot, finger: &Finger) -> Option<Self> {
        let (origin, rotation) = robot.world.body_pose(finger.tip_body);
        let tip = origin + rotation * finger.tip;
        let from = finger.knuckles.last().map_or(origin, |joint| robot.world.joint_axis(*joint).0);
        let normal = rotation * finger.pad_normal;
        let along = (tip - from).reject_from_normalized(normal).try_normalize()?;
        let axes = DMat3::from_cols(normal, along.cross(normal), along);
        let skin = finger.pad_geoms.iter().flat_map(|geom| {
            let (at, turn) = robot.world.geom_pose(*geom);
            robot.parts.geoms[*geom].points.iter().map(move |point| axes.transpose() * (at + turn * *point))
        });
        let skin: Vec<DVec3> = skin.collect();
        let end = skin.iter().map(|point| point.z).reduce(f64::max)?;
        let near = skin.into_iter().filter(|point| point.z > end - END_LENGTH);
        let (low, high) = near.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        let radius = 0.5 * (high - low).truncate().min_element();
        let centre = (0.5 * (low + high)).truncate().extend(end - radius);
        Some(Self { centre: rotation.transpose() * (axes * centre - origin), radius })
    }
}

/// Nearest points of two surfaces.
#[derive(Debug, Clone, Copy)]
pub(super) struct Nearest {
    /// Distance, m; negative = penetration.
    pub distance: f64,
    /// Middle of the two points, in the world, m.
    pub position: DVec3,
    /// Unit direction from the first surface to the second; None if they just touch.
    pub normal: Option<DVec3>,
}

/// Finds the nearest points of two sets of geoms in the robot's present pose; None beyond `range`, m.
pub(super) fn nearest(robot: &mut Robot, [first, second]: [&[usize]; 2], range: f64) -> Option<Nearest> {
    let mut found: Option<Nearest> = None;
    for pair in first.iter().flat_map(|a| second.iter().map(move |b| [*a, *b])) {
        let limit = found.as_ref().map_or(range, |found| found.distance);
        let (distance, Some([a, b])) = robot.world.geom_distance(pair, limit) else { continue };
        let line = if distance < 0.0 { a - b } else { b - a };
        found = Some(Nearest { distance, position: 0.5 * (a + b), normal: line.try_normalize() });
    }
    found
}
