//! Candidate contact pairs of a model with their softness, and the depths and speeds that they bear.

use mujoco_rs::prelude::*;

use crate::mujoco::world::{Body, World};

/// Peak penetration depth of an impact divided by speed times time constant, for a critically damped contact.
pub(super) const PEAK_DEPTH: f64 = 0.37;

/// Two geoms that can come into contact.
#[derive(Debug, Clone, Copy)]
pub(super) struct GeomPair {
    /// Indices of the geoms.
    pub geoms: [usize; 2],
    /// Indices of their bodies.
    pub bodies: [usize; 2],
    /// Time constant, s, and damping ratio; or negative stiffness and negative damping.
    pub solref: [f64; 2],
    /// Impedance parameters.
    pub solimp: [f64; 5],
}

impl GeomPair {
    /// Returns the time constant that the engine uses, s; `None` if stiffness is given directly.
    pub fn time_constant(&self, world: &World) -> Option<f64> {
        let [time, _] = self.solref;
        let least = if refsafe(world) { 2.0 * world.options().timestep } else { 0.0 };
        (time > 0.0).then(|| time.max(least))
    }

    /// Returns the speed above which the two geoms can pass through each other, m/s.
    pub fn speed_limit(&self, world: &World) -> f64 {
        let time = self.time_constant(world).map_or(0.0, |time| PEAK_DEPTH * time).max(world.options().timestep);
        self.geoms.map(|geom| half_thickness(world, geom)).iter().sum::<f64>() / time
    }
}

/// Returns true if the engine raises time constants to at least two timesteps.
pub(super) fn refsafe(world: &World) -> bool {
    world.model().opt().disableflags & MjtDisableBit::mjDSBL_REFSAFE as i32 == 0
}

/// Returns all pairs of geoms that can come into contact; at least one of each pair can move.
pub(super) fn geom_pairs(world: &World) -> Vec<GeomPair> {
    let model = world.model();
    let (geom_body, weld, parent) = (model.geom_bodyid(), model.body_weldid(), model.body_parentid());
    let moves = |body: usize| model.body_treeid()[body] >= 0;
    let mut pairs = Vec::new();
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
            pairs.push(GeomPair { geoms: [a, b], bodies, solref, solimp });
        }
    }
    for pair in 0..model.pair_geom1().len() {
        let geoms = [model.pair_geom1()[pair] as usize, model.pair_geom2()[pair] as usize];
        let (solref, solimp) = (model.pair_solref()[pair], model.pair_solimp()[pair]);
        pairs.push(GeomPair { geoms, bodies: geoms.map(|g| geom_body[g] as usize), solref, solimp });
    }
    pairs
}

/// Mixes the softness of two geoms by the engine's rule.
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

/// Returns half of a geom's smallest thickness, m; infinite for planes and height fields.
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

/// Returns the largest penetration depth that each geom bears, m: half a ball's radius or half a wall's thickness,
/// limited to `most`.
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

/// Returns the speed above which each moving body can pass through another one, m/s: its penetration, or its way in one
/// step, exceeds the half thickness of both.
pub fn speed_limits(world: &World) -> Vec<(Body, f64)> {
    let mut limits: Vec<(Body, f64)> = world.moving_bodies().into_iter().map(|body| (body, f64::INFINITY)).collect();
    for pair in geom_pairs(world) {
        let limit = pair.speed_limit(world);
        for (body, least) in &mut limits {
            if pair.bodies.contains(&body.0) {
                *least = least.min(limit);
            }
        }
    }
    limits
}
