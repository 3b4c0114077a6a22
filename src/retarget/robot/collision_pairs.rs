//! Pairs of geoms that must not penetrate each other.

use super::fingers::Finger;
use super::lookup;
use super::spec::{CollisionSpec, PairSelection};
use crate::error::Result;
use crate::mujoco::parts::Parts;

/// Returns the pairs of geoms of different fingers, or of a finger and the palm, that the model lets collide.
///
/// # Errors
/// If a body of `spec.ignore` is not in the model.
pub fn collision_pairs(spec: &CollisionSpec, parts: &Parts, fingers: &[Finger]) -> Result<Vec<[usize; 2]>> {
    let ignored: Vec<[usize; 2]> = spec
        .ignore
        .iter()
        .map(|[a, b]| Ok([lookup::body(parts, a)?, lookup::body(parts, b)?]))
        .collect::<Result<_>>()?;
    if spec.pairs == PairSelection::None {
        return Ok(Vec::new());
    }
    let part = |geom: usize| parts.bodies[parts.geoms[geom].body].part;
    let finger = |geom: usize| fingers.iter().position(|finger| finger.links.contains(&part(geom)));
    let collides = |a: usize, b: usize| {
        let [[type_a, affinity_a], [type_b, affinity_b]] = [a, b].map(|geom| parts.geoms[geom].bits);
        type_a & affinity_b != 0 || type_b & affinity_a != 0
    };
    let are_apart = |a: usize, b: usize| finger(a) != finger(b) && (finger(a).is_some() || finger(b).is_some());
    let is_listed = |list: &[[usize; 2]], a: usize, b: usize| {
        let [a, b] = [a, b].map(|geom| parts.geoms[geom].body);
        list.iter().any(|pair| *pair == [a, b] || *pair == [b, a])
    };
    let solid: Vec<usize> = (0..parts.geoms.len()).filter(|geom| parts.geoms[*geom].solid).collect();
    let pairs = solid.iter().enumerate().flat_map(|(index, a)| solid[index + 1..].iter().map(move |b| [*a, *b]));
    let counts = |[a, b]: &[usize; 2]| {
        let is_excluded = is_listed(&ignored, *a, *b) || is_listed(&parts.excludes, *a, *b);
        collides(*a, *b) && are_apart(*a, *b) && !are_neighbours(parts, part(*a), part(*b)) && !is_excluded
    };
    Ok(pairs.filter(counts).collect())
}

/// True if one of two parts carries the other. The engine lets such parts penetrate each other, as they do at every joint.
fn are_neighbours(parts: &Parts, a: usize, b: usize) -> bool {
    let above = |part: usize| parts.bodies[parts.bodies[part].parent].part;
    a == b || above(a) == b || above(b) == a
}
