//! Which geoms may touch, with what softness, how deep and how fast.

use mujoco_rs::prelude::*;

use crate::mujoco::world::{Body, World};

/// Peak depth of a meeting over speed times time constant, for a contact that is damped critically.
pub(super) const PEAK_DEPTH: f64 = 0.37;

/// Two geoms that may touch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Touch {
    /// Their indices.
    pub geoms: [usize; 2],
    /// Their bodies.
    pub bodies: [usize; 2],
    /// Time constant, s, and damping ratio; or stiffness and damping, both negative.
    pub solref: [f64; 2],
    /// Impedance.
    pub solimp: [f64; 5],
}

impl Touch {
    /// Time constant of the contact as the engine uses it, s; `None` if stiffness is given directly.
    pub fn time_constant(&self, world: &World) -> Option<f64> {
        let [time, _] = self.solref;
        let least = if refsafe(world) { 2.0 * world.options().timestep } else { 0.0 };
        (time > 0.0).then(|| time.max(least))
    }
}

/// Whether the engine stretches time constants to two timesteps.
pub(super) fn refsafe(world: &World) -> bool {
    world.model().opt().disableflags & MjtDisableBit::mjDSBL_REFSAFE as i32 == 0
}

/// All pairs of geoms that may touch and of which one can move.
pub(super) fn touches(world: &World) -> Vec<Touch> {
    let model = world.model();
    let (geom_body, weld, parent) = (model.geom_bodyid(), model.body_weldid(), model.body_parentid());
    let moves = |body: usize| model.body_treeid()[body] >= 0;
    let mut touches = Vec::new();
    for a in 0..geom_body.len() {
        for b in a + 1..geom_body.len() {
            let bodies = [geom_body[a] as usize, geom_body[b] as usize];
            let fits = |x: usize, y: usize| model.geom_contype()[x] & model.geom_conaffinity()[y] != 0;
            let [w1, w2] = bodies.map(|body| weld[body]);
            let above = |w: i32| weld[parent[w as usize] as usize];
            let family = w1 == w2 || (w1 != 0 && w2 != 0 && (above(w1) == w2 || above(w2) == w1));
            let signature = (bodies[0].min(bodies[1]) << 16) + bodies[0].max(bodies[1]);
            let excluded = model.exclude_signature().iter().any(|s| *s as usize == signature);
            if !(fits(a, b) || fits(b, a)) || family || excluded || !bodies.iter().any(|body| moves(*body)) {
                continue;
            }
            let (solref, solimp) = mixed(model, a, b);
            touches.push(Touch { geoms: [a, b], bodies, solref, solimp });
        }
    }
    for pair in 0..model.pair_geom1().len() {
        let geoms = [model.pair_geom1()[pair] as usize, model.pair_geom2()[pair] as usize];
        let (solref, solimp) = (model.pair_solref()[pair], model.pair_solimp()[pair]);
        touches.push(Touch { geoms, bodies: geoms.map(|g| geom_body[g] as usize), solref, solimp });
    }
    touches
}

/// Softness of a pair as the engine mixes it.
fn mixed(model: &MjModel, a: usize, b: usize) -> ([f64; 2], [f64; 5]) {
    let (priority, weight) = (model.geom_priority(), model.geom_solmix());
    let share = match priority[a].cmp(&priority[b]) {
        std::cmp::Ordering::Greater => 1.0,
        std::cmp::Ordering::Less => 0.0,
        std::cmp::Ordering::Equal if weight[a] + weight[b] > 0.0 => weight[a] / (weight[a] + weight[b]),
        std::cmp::Ordering::Equal => 0.5,
    };
    let ([r1, r2], [i1, i2]) = ([a, b].map(|g| model.geom_solref()[g]), [a, b].map(|g| model.geom_solimp()[g]));
    let mix = |x: f64, y: f64| share * x + (1.0 - share) * y;
    let direct = r1[0] <= 0.0 || r2[0] <= 0.0;
    let solref = std::array::from_fn(|i| match direct && share > 0.0 && share < 1.0 {
        true => r1[i].min(r2[i]),
        false => mix(r1[i], r2[i]),
    });
    (solref, std::array::from_fn(|i| mix(i1[i], i2[i])))
}

/// Half of a geom's least thickness, m; infinite for planes and height fields, which have none.
pub(super) fn half_thickness(world: &World, geom: usize) -> f64 {
    let model = world.model();
    let [x, y, z] = model.geom_size()[geom];
    match model.geom_type()[geom] {
        MjtGeomBase::mjGEOM_PLANE | MjtGeomBase::mjGEOM_HFIELD => f64::INFINITY,
        MjtGeomBase::mjGEOM_SPHERE | MjtGeomBase::mjGEOM_CAPSULE => x,
        MjtGeomBase::mjGEOM_CYLINDER => x.min(y),
        MjtGeomBase::mjGEOM_ELLIPSOID | MjtGeomBase::mjGEOM_BOX => x.min(y).min(z),
        _ => {
            let [_, _, _, x, y, z] = model.geom_aabb()[geom];
            x.min(y).min(z)
        }
    }
}

/// Deepest bearable contact of each geom, m: half a ball's radius, half a wall's thickness, `most` at most.
pub fn depth_limits(world: &World, most: f64) -> Vec<f64> {
    let round = |geom: usize| {
        matches!(
            world.model().geom_type()[geom],
            MjtGeomBase::mjGEOM_SPHERE | MjtGeomBase::mjGEOM_CAPSULE | MjtGeomBase::mjGEOM_ELLIPSOID
        )
    };
    let limit = |geom: usize| half_thickness(world, geom) * if round(geom) { 0.5 } else { 1.0 };
    (0..world.model().geom_type().len()).map(|geom| limit(geom).min(most)).collect()
}

/// Speed above which each moving body may pass through something, m/s: it would sink deeper than both are thick, or
/// move so far in one step.
pub fn speed_limits(world: &World) -> Vec<(Body, f64)> {
    let mut limits: Vec<(Body, f64)> = world.moving_bodies().into_iter().map(|body| (body, f64::INFINITY)).collect();
    for touch in touches(world) {
        let time = touch.time_constant(world).map_or(0.0, |time| PEAK_DEPTH * time).max(world.options().timestep);
        let limit = touch.geoms.map(|geom| half_thickness(world, geom)).iter().sum::<f64>() / time;
        for (body, least) in &mut limits {
            if touch.bodies.contains(&body.0) {
                *least = least.min(limit);
            }
        }
    }
    limits
}
