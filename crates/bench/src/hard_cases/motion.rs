//! Forces from motion where motion misleads: flight, several supports, wrong scales, lost tracking.

use egotac::error::Result;
use egotac::hand::{HandModel, HandParams, Side};
use egotac::physics::{Estimate, Fixed, ForceValidity, Pose, RigidBody, Settings, Take, Tracked, whole};
use glam::{DQuat, DVec3, Vec3};

use super::{Family, HardCase, Outcome};

const FAMILY: Family = Family::Motion;
/// Free fall, m/s².
const G: f64 = 9.81;
/// Half edges of the plate that lies on hands, m.
const PLATE: Vec3 = Vec3::new(0.15, 0.15, 0.01);
/// Frames of a take at rest.
const FRAMES: usize = 24;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case("free_fall", "a plate falls 1 m beside the hand", "none needed", free_fall),
    FAMILY.case(
        "throw_and_catch",
        "the hand throws a plate up and catches it again, 30 frames a second",
        "240 frames a second; within 60 ms of release and catch forces may be unknown",
        throw_and_catch,
    ),
    FAMILY.case("two_hands", "a plate lies on both hands", "none needed", two_hands),
    FAMILY.case(
        "hand_on_hand",
        "one hand lies in the other: no body's motion tells the force",
        "hands apart",
        hand_on_hand,
    ),
    FAMILY.case(
        "two_supports",
        "a plate lies on the hand at one end and on a block at the other",
        "none needed",
        two_supports,
    ),
    FAMILY.case("rolling_ball", "a ball rolls over the table, no hand near", "none needed", rolling_ball),
    FAMILY.case("tiny_body", "a body of 1 g lies on the hand", "none needed", tiny_body),
    FAMILY.case("heavy_body", "a plate of 300 kg is said to lie on a hand", "3 kg", heavy_body),
    FAMILY.case(
        "wrong_mesh_scale",
        "a mesh in centimetres is read as if in metres",
        "the right unit",
        wrong_mesh_scale,
    ),
    FAMILY.case(
        "swapped_hands",
        "the left hand's pose is stored as the right one's",
        "sides as they are",
        swapped_hands,
    ),
    FAMILY.case(
        "gaps_and_jumps",
        "the tracking of a plate at rest loses it twice, and believes it elsewhere for a frame",
        "poses of every frame",
        gaps_and_jumps,
    ),
];

fn mesh(name: &str, half: Vec3, kilograms: f64) -> Result<RigidBody> {
    let sign = |i: u32, bit: u32| (i >> bit & 1) as f32 * 2.0 - 1.0;
    let corner = |i: u32| half * Vec3::new(sign(i, 0), sign(i, 1), sign(i, 2));
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    RigidBody::from_mesh(name, (0..8).map(corner).collect(), triangles)?.with_mass(kilograms, 0.0)
}

/// The hand at rest, its highest point and the middle of the skin just below it, m.
fn highest(model: &HandModel, params: &HandParams) -> (f64, DVec3) {
    let vertices = model.forward(params).vertices;
    let top = vertices.iter().map(|v| v.z).fold(f32::MIN, f32::max);
    let near: Vec<Vec3> = vertices.into_iter().filter(|v| v.z > top - 0.0015).collect();
    (top.into(), (near.iter().sum::<Vec3>() / near.len() as f32).as_dvec3())
}

/// Returns a take of the right hand at rest under a plate with its centre over the highest skin, pressed 0.5 mm into it.
fn resting<'a>(models: &'a [HandModel; 2], body: RigidBody, half_height: f64) -> Take<'a> {
    let params = HandParams::default();
    let (top, place) = highest(&models[1], &params);
    let position = place.with_z(top + half_height - 0.0005);
    Take {
        times: (0..FRAMES).map(|k| k as f64 / 30.0).collect(),
        models: [&models[0], &models[1]],
        hands: [vec![Tracked::Absent; FRAMES], vec![Tracked::Present(Box::new(params)); FRAMES]],
        bodies: vec![body],
        poses: vec![vec![Some(Pose { position, orientation: DQuat::IDENTITY }); FRAMES]],
        fixed: Vec::new(),
        gravity: Some(DVec3::NEG_Z * G),
    }
}

fn hands() -> [HandModel; 2] {
    Side::BOTH.map(HandModel::builtin)
}

/// Sum of the stated forces on both hands at a frame, N; unknown links count as 0.
fn total(estimate: &Estimate, frame: usize) -> f64 {
    estimate.frames[frame].hands.iter().flat_map(|hand| hand.links.iter().flatten()).map(|link| link.force).sum()
}

/// Reasons of the hands that are unknown, once each.
fn reasons(estimate: &Estimate) -> String {
    let mut found: Vec<ForceValidity> =
        estimate.frames.iter().flat_map(|frame| &frame.hands).map(|hand| hand.validity).collect();
    found.retain(|validity| *validity != ForceValidity::Valid);
    found.sort();
    found.dedup();
    found.iter().map(|validity| validity.reason()).collect::<Vec<_>>().join("; ")
}

fn estimate(take: &Take) -> Estimate {
    whole(take, &Settings::default())
}

/// Outcome of a take whose force on both hands in the middle is to be `weight`, N, and of its remedy.
fn outcome(take: &Take, remedy: &Take, weights: [f64; 2], tolerance: f64) -> Outcome {
    let [(error, guard), (remedied, remedied_guard)] =
        [(take, weights[0]), (remedy, weights[1])].map(|(take, weight)| {
            let estimate = estimate(take);
            (100.0 * (total(&estimate, FRAMES / 2) - weight) / weight, reasons(&estimate))
        });
    Outcome { error_of: "force on the hands, %", tolerance, unguarded: Some(error), guard, remedied, remedied_guard }
}

fn free_fall() -> Result<Outcome> {
    let models = hands();
    let mut take = resting(&models, mesh("plate", PLATE, 0.6)?, 0.01);
    for (pose, time) in take.poses[0].iter_mut().flatten().zip(&take.times) {
        pose.position += DVec3::new(0.6, 0.0, 1.5 - 0.5 * G * time * time);
    }
    let estimate = estimate(&take);
    let most = (0..FRAMES).map(|frame| total(&estimate, frame)).fold(0.0, f64::max);
    Ok(Outcome {
        error_of: "force on the hands, N",
        tolerance: 0.01,
        unguarded: Some(most),
        guard: reasons(&estimate),
        remedied: most,
        remedied_guard: reasons(&estimate),
    })
}

/// Throws a plate: rest, push, flight back to the place of release, catch, rest. Returns the impulse of the known forces over that of
/// the weight, less 1, in %, and the reasons of unknown hands.
fn thrown(rate: f64) -> Result<(f64, String)> {
    const PUSH: f64 = 10.0;
    const PUSH_SECS: f64 = 0.15;
    const REST_SECS: f64 = 0.5;
    let models = hands();
    let mut take = resting(&models, mesh("plate", PLATE, 0.6)?, 0.01);
    let rest = take.poses[0][0].map_or(DVec3::ZERO, |pose| pose.position);
    let (speed, risen) = (PUSH * PUSH_SECS, 0.5 * PUSH * PUSH_SECS * PUSH_SECS);
    let flight = 2.0 * speed / G;
    let end = 2.0 * REST_SECS + 2.0 * PUSH_SECS + flight;
    // Heights of the plate and of the hand above their rest.
    let heights = |t: f64| {
        let t = t - REST_SECS;
        let back = PUSH_SECS + flight - t + PUSH_SECS;
        match t {
            t if t <= 0.0 => [0.0; 2],
            t if t <= PUSH_SECS => [0.5 * PUSH * t * t; 2],
            t if t <= PUSH_SECS + flight => {
                let t = t - PUSH_SECS;
                [risen + speed * t - 0.5 * G * t * t, risen]
            }
            _ if back >= 0.0 => [0.5 * PUSH * back * back; 2],
            _ => [0.0; 2],
        }
    };
    take.times = (0..).map(|k| f64::from(k) / rate).take_while(|t| *t <= end).collect();
    let params = HandParams::default();
    take.hands[0] = vec![Tracked::Absent; take.times.len()];
    (take.hands[1], take.poses[0]) = take
        .times
        .iter()
        .map(|t| {
            let [plate, hand] = heights(*t);
            let mut params = params.clone();
            params.transl.z += hand as f32;
            let pose = Pose { position: rest + DVec3::Z * plate, orientation: DQuat::IDENTITY };
            (Tracked::Present(Box::new(params)), Some(pose))
        })
        .unzip();
    let estimate = estimate(&take);
    let counted = |t: &f64| (0.2..=end - 0.2).contains(t);
    let frames: Vec<usize> = (0..take.times.len()).filter(|k| counted(&take.times[*k])).collect();
    let impulse: f64 = frames.iter().map(|frame| total(&estimate, *frame)).sum();
    let weight = 0.6 * G * frames.len() as f64;
    // Acceleration jumps at release and catch: no spline follows, and such frames are flagged rightly.
    let jumps = [0.0, PUSH_SECS, PUSH_SECS + flight, 2.0 * PUSH_SECS + flight].map(|t| REST_SECS + t);
    let mut steady = estimate;
    let mut times = take.times.iter();
    steady.frames.retain(|_| times.next().is_some_and(|t| jumps.iter().all(|jump| (t - jump).abs() > 0.06)));
    Ok((100.0 * (impulse / weight - 1.0), reasons(&steady)))
}

fn throw_and_catch() -> Result<Outcome> {
    let (error, guard) = thrown(30.0)?;
    let (remedied, remedied_guard) = thrown(240.0)?;
    Ok(Outcome {
        error_of: "impulse on the hand over a throw, %",
        tolerance: 5.0,
        unguarded: Some(error),
        guard,
        remedied,
        remedied_guard,
    })
}

fn two_hands() -> Result<Outcome> {
    let models = hands();
    let mut take = resting(&models, mesh("plate", Vec3::new(0.3, 0.3, 0.01), 0.6)?, 0.01);
    let params = HandParams::default();
    let ([left_top, right_top], [left, right]) = {
        let [a, b] = models.each_ref().map(|model| highest(model, &params));
        ([a.0, b.0], [a.1, b.1])
    };
    // Both hands touch the plate 80 mm from its middle.
    let moved = |place: DVec3, top: f64, x: f64| {
        let shift = DVec3::new(x - place.x, -place.y, -top);
        Tracked::Present(Box::new(HandParams { transl: shift.as_vec3(), ..params.clone() }))
    };
    take.hands = [vec![moved(left, left_top, -0.12); FRAMES], vec![moved(right, right_top, 0.12); FRAMES]];
    let pose = Pose { position: DVec3::Z * (0.01 - 0.0005), orientation: DQuat::IDENTITY };
    take.poses[0] = vec![Some(pose); FRAMES];
    Ok(outcome(&take, &take, [0.6 * G; 2], 5.0))
}

fn hand_on_hand() -> Result<Outcome> {
    let models = hands();
    let with_left = |x: f32| -> Result<(f64, String)> {
        let mut take = resting(&models, mesh("plate", PLATE, 0.6)?, 0.01);
        take.poses[0].iter_mut().flatten().for_each(|pose| pose.position.z += 0.5);
        // The plate lies on a block, away from both hands.
        let plate = take.poses[0][0].map_or(DVec3::ZERO, |pose| pose.position);
        let pose = Pose { position: plate - DVec3::Z * 0.1099, orientation: DQuat::IDENTITY };
        take.fixed.push(Fixed::block("block", Vec3::splat(0.1), pose)?);
        let (_, own) = highest(&models[1], &HandParams::default());
        let (_, other) = highest(&models[0], &HandParams::default());
        let transl = (own - other).as_vec3() + Vec3::X * x;
        take.hands[0] = vec![Tracked::Present(Box::new(HandParams { transl, ..HandParams::default() })); FRAMES];
        let estimate = estimate(&take);
        let unknown = estimate.frames[FRAMES / 2].hands[1].links.iter().filter(|link| link.is_none()).count();
        // Hands inside of each other: at least one link must be unknown; apart, none.
        let wrong = if x == 0.0 { unknown == 0 } else { unknown > 0 };
        Ok((f64::from(u8::from(wrong)), reasons(&estimate)))
    };
    let (unguarded, guard) = with_left(0.0)?;
    let (remedied, remedied_guard) = with_left(0.5)?;
    Ok(Outcome {
        error_of: "takes with a force where none can be told, or without one where it can",
        tolerance: 0.0,
        unguarded: Some(unguarded),
        guard,
        remedied,
        remedied_guard,
    })
}

fn two_supports() -> Result<Outcome> {
    let models = hands();
    let mut take = resting(&models, mesh("plate", PLATE, 0.6)?, 0.01);
    // The highest skin is 100 mm to one side of the plate's middle, the edge of the block 100 mm to the other.
    let top = take.poses[0][0].map_or(DVec3::ZERO, |pose| pose.position);
    take.poses[0].iter_mut().flatten().for_each(|pose| pose.position.x += 0.1);
    let position = top + DVec3::new(0.2, 0.0, -0.01 - 0.02);
    let pose = Pose { position, orientation: DQuat::IDENTITY };
    take.fixed.push(Fixed::block("block", Vec3::new(0.005, 0.1, 0.02), pose)?);
    Ok(outcome(&take, &take, [0.5 * 0.6 * G; 2], 12.0))
}

fn rolling_ball() -> Result<Outcome> {
    let models = hands();
    const RADIUS: f64 = 0.03;
    let body = RigidBody::ball("ball", RADIUS)?.with_mass(0.2, 0.0)?;
    let mut take = resting(&models, body, RADIUS);
    let pose = Pose { position: DVec3::new(0.0, 0.0, 0.98), orientation: DQuat::IDENTITY };
    take.fixed.push(Fixed::block("table", Vec3::new(1.0, 1.0, 0.02), pose)?);
    for (pose, time) in take.poses[0].iter_mut().zip(&take.times) {
        let way = 0.3 * time;
        let orientation = DQuat::from_rotation_y(way / RADIUS);
        *pose = Some(Pose { position: DVec3::new(way, 0.0, 1.0 + RADIUS), orientation });
    }
    let estimate = estimate(&take);
    let residual = estimate.frames.iter().flat_map(|frame| frame.bodies.iter().flatten());
    let residual = residual.map(|body| body.residual.fixed_rows::<3>(0).norm()).fold(0.0, f64::max);
    Ok(Outcome {
        error_of: "force that the table does not explain, N",
        tolerance: 0.05,
        unguarded: Some(residual),
        guard: reasons(&estimate),
        remedied: residual,
        remedied_guard: reasons(&estimate),
    })
}

fn tiny_body() -> Result<Outcome> {
    let models = hands();
    let take = resting(&models, mesh("wafer", Vec3::new(0.04, 0.04, 0.001), 0.001)?, 0.001);
    Ok(outcome(&take, &take, [0.001 * G; 2], 10.0))
}

fn heavy_body() -> Result<Outcome> {
    let models = hands();
    let [heavy, light] = [300.0, 3.0].map(|kilograms| mesh("plate", PLATE, kilograms));
    let (heavy, light) = (resting(&models, heavy?, 0.01), resting(&models, light?, 0.01));
    Ok(outcome(&heavy, &light, [300.0 * G, 3.0 * G], 5.0))
}

fn wrong_mesh_scale() -> Result<Outcome> {
    let models = hands();
    let (wrong, right) = (mesh("plate", PLATE * 100.0, 0.6)?, mesh("plate", PLATE, 0.6)?);
    Ok(outcome(&resting(&models, wrong, 0.01), &resting(&models, right, 0.01), [0.6 * G; 2], 5.0))
}

fn swapped_hands() -> Result<Outcome> {
    let models = hands();
    let right = resting(&models, mesh("plate", PLATE, 0.6)?, 0.01);
    let mut swapped = right.clone();
    swapped.hands.swap(0, 1);
    Ok(outcome(&swapped, &right, [0.6 * G; 2], 5.0))
}

fn gaps_and_jumps() -> Result<Outcome> {
    let models = hands();
    let right = resting(&models, mesh("plate", PLATE, 0.6)?, 0.01);
    let mut lost = right.clone();
    (lost.poses[0][6], lost.poses[0][7], lost.poses[0][18]) = (None, None, None);
    if let Some(pose) = &mut lost.poses[0][FRAMES / 2] {
        pose.position.y += 0.3;
    }
    Ok(outcome(&lost, &right, [0.6 * G; 2], 5.0))
}
