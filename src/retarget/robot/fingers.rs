//! Which chains of a model are fingers, which human finger each is, and where it ends.

use glam::DVec3;

use super::spec::{FINGERS, FingerSpec, Spec, TipSpec, finger_index};
use crate::error::{Error, Result};
use crate::mujoco::World;
use crate::mujoco::parts::{Motion, Parts};

/// What names of a human finger begin with, thumb to little.
const BEGINNINGS: [&[&str]; 5] = [
    &["thumb", "th"],
    &["index", "fore", "if", "ff"],
    &["middle", "mf"],
    &["ring", "rf"],
    &["little", "pinky", "pinkie", "lf", "pf"],
];
/// Parts of names that say nothing about the finger.
const FILLERS: [&str; 12] =
    ["right", "left", "rh", "lh", "r", "l", "hand", "robot0", "gripper0", "finger", "link", "joint"];

/// How far a tip may be beyond the shapes that are to be its skin, m.
const SHOWN: f64 = 0.005;

/// A finger of the robot.
#[derive(Debug, Clone)]
pub struct Finger {
    /// The human finger it stands for, thumb 0 to little 4.
    pub human: usize,
    /// Parts (bodies with a joint) from base to tip.
    pub links: Vec<usize>,
    /// Joints from base to tip that move.
    pub joints: Vec<usize>,
    /// Body that carries the tip.
    pub tip_body: usize,
    /// The tip in that body's frame, m.
    pub tip: DVec3,
    /// Outward normal of the pad, in the tip body's frame.
    pub pad_normal: DVec3,
    /// Geoms of the fingertip; none where the model shows no skin at the tip, which then meets others as a point.
    pub pad_geoms: Vec<usize>,
    /// Joints at which it bends, from base to the last; of those in one place the first.
    pub knuckles: Vec<usize>,
    /// Length of its three phalanges (fewer where it has no more) along the knuckles, m.
    pub length: f64,
    /// Name of what the tip was found by.
    pub tip_name: String,
}

/// Finds the fingers; the robot is in the pose they are read in.
///
/// # Errors
/// If a name of the spec is not in the model, or there is no finger.
pub fn find(world: &World, parts: &Parts, spec: &Spec, moves: &[bool]) -> Result<Vec<Finger>> {
    let chains = chains(parts, moves);
    let mut fingers = Vec::new();
    if spec.fingers.is_empty() {
        let labels = labels(world, parts, &chains);
        for (chain, label) in chains.iter().zip(labels) {
            if let Some(human) = label {
                fingers.push(finger(world, parts, moves, human, &FingerSpec::default(), chain.clone())?);
            }
        }
    } else {
        for (name, written) in &spec.fingers {
            let tip = tip_part(parts, name, &written.tip)?;
            let chain = chain_of(parts, moves, &chains, tip);
            fingers.push(finger(world, parts, moves, finger_index(name)?, written, chain)?);
        }
    }
    fingers.sort_by_key(|finger| finger.human);
    if fingers.is_empty() {
        let joints: Vec<&str> = parts.joints.iter().map(|joint| joint.name.as_str()).collect();
        let got = format!("joints {}", joints.join(", "));
        return Err(Error::value("robot", "at least one finger: a chain of hinges or slides", got));
    }
    Ok(fingers)
}

/// Chains of moving parts, each from where it leaves the others to its last part.
fn chains(parts: &Parts, moves: &[bool]) -> Vec<Vec<usize>> {
    let is_moving = |body: usize| parts.joints.iter().zip(moves).any(|(joint, moves)| *moves && joint.body == body);
    let moving: Vec<usize> = (1..parts.bodies.len()).filter(|body| is_moving(*body)).collect();
    let above = |body: usize| {
        let mut at = parts.bodies[body].parent;
        while at != 0 && !moving.contains(&at) {
            at = parts.bodies[at].parent;
        }
        at
    };
    let leaves: Vec<usize> =
        moving.iter().copied().filter(|body| moving.iter().all(|other| above(*other) != *body)).collect();
    let mut chains: Vec<Vec<usize>> = Vec::new();
    for leaf in &leaves {
        let mut chain = vec![*leaf];
        let mut at = above(*leaf);
        // A part that carries several fingers belongs to the palm.
        while at != 0 && moving.iter().filter(|body| above(**body) == at).count() < 2 {
            chain.push(at);
            at = above(at);
        }
        chain.reverse();
        chains.push(chain);
    }
    // One finger alone has no palm to end at: whatever carries it and has no sibling is part of it.
    chains
}

/// The chain that ends in a given part, cut there.
fn chain_of(parts: &Parts, moves: &[bool], chains: &[Vec<usize>], tip_body: usize) -> Vec<usize> {
    let mut at = tip_body;
    while at != 0 {
        if parts.joints.iter().zip(moves).any(|(joint, moves)| *moves && joint.body == at)
            && let Some(chain) = chains.iter().find(|chain| chain.contains(&at))
        {
            return chain.iter().copied().take_while(|part| *part != at).chain([at]).collect();
        }
        at = parts.bodies[at].parent;
    }
    Vec::new()
}

/// Human finger of each chain: by names, what they leave open by geometry.
fn labels(world: &World, parts: &Parts, chains: &[Vec<usize>]) -> Vec<Option<usize>> {
    let votes: Vec<[usize; 5]> = chains.iter().map(|chain| votes(parts, chain)).collect();
    let mut labels: Vec<Option<usize>> = vec![None; chains.len()];
    for human in 0..5 {
        let best = (0..chains.len()).filter(|chain| labels[*chain].is_none()).max_by_key(|chain| votes[*chain][human]);
        if let Some(best) = best.filter(|best| votes[*best][human] > 0) {
            let is_its_own = (0..5).all(|other| votes[best][other] <= votes[best][human]);
            if is_its_own {
                labels[best] = Some(human);
            }
        }
    }
    let base = |chain: &Vec<usize>| world.body_pose(chain[0]).0;
    let end = |chain: &Vec<usize>| {
        let last = chain[chain.len() - 1];
        farthest(world, parts, last, base(chain)).unwrap_or_else(|| world.body_pose(last).0)
    };
    let direction = |chain: &Vec<usize>| (end(chain) - base(chain)).normalize_or_zero();
    if labels.iter().all(|label| *label != Some(0)) {
        // The thumb points another way than the rest.
        let alike = |k: usize| -> f64 {
            (0..chains.len()).filter(|j| *j != k).map(|j| direction(&chains[j]).dot(direction(&chains[k]))).sum()
        };
        let open = (0..chains.len()).filter(|k| labels[*k].is_none());
        if let Some(thumb) = open.min_by(|a, b| alike(*a).total_cmp(&alike(*b))) {
            labels[thumb] = Some(0);
        }
    }
    // The rest in their row, from the end to which the thumb points.
    let mut open: Vec<usize> = (0..chains.len()).filter(|k| labels[*k].is_none()).collect();
    let pairs = open.iter().flat_map(|a| open.iter().map(move |b| base(&chains[*a]) - base(&chains[*b])));
    let row = pairs.max_by(|a, b| a.length_squared().total_cmp(&b.length_squared())).unwrap_or(DVec3::ZERO);
    let thumb = (0..chains.len()).find(|k| labels[*k] == Some(0));
    let toward = thumb.map_or(DVec3::ZERO, |k| end(&chains[k]) - middle(&open, &base, chains));
    let row = if row.dot(toward) < 0.0 { -row } else { row };
    open.sort_by(|a, b| base(&chains[*b]).dot(row).total_cmp(&base(&chains[*a]).dot(row)));
    for chain in open {
        labels[chain] = (1..5).find(|human| labels.iter().all(|label| *label != Some(*human)));
    }
    labels
}

/// The middle of some chains' bases.
fn middle(some: &[usize], base: &impl Fn(&Vec<usize>) -> DVec3, chains: &[Vec<usize>]) -> DVec3 {
    some.iter().map(|k| base(&chains[*k])).sum::<DVec3>() / some.len().max(1) as f64
}

/// How many names of a chain speak for each human finger.
fn votes(parts: &Parts, chain: &[usize]) -> [usize; 5] {
    let mut votes = [0; 5];
    let in_chain = |body: usize| chain.contains(&parts.bodies[body].part) || chain.contains(&body);
    let names = (0..parts.bodies.len()).filter(|body| in_chain(*body)).map(|body| &parts.bodies[body].name);
    let names = names
        .chain(parts.joints.iter().filter(|joint| in_chain(joint.body)).map(|joint| &joint.name))
        .chain(parts.sites.iter().filter(|site| in_chain(site.body)).map(|site| &site.name))
        .chain(parts.geoms.iter().filter(|geom| in_chain(geom.body)).map(|geom| &geom.name));
    for name in names {
        if let Some(human) = speaks_for(name) {
            votes[human] += 1;
        }
    }
    votes
}

/// The human finger that a name begins with, or holds as a word.
fn speaks_for(name: &str) -> Option<usize> {
    let lower = name.to_lowercase();
    let words: Vec<&str> = lower.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
    let telling: Vec<&str> = words.iter().copied().filter(|word| !FILLERS.contains(word)).collect();
    let begins = |word: &str| {
        (0..5).find(|human| {
            BEGINNINGS[*human].iter().any(|beginning| {
                // Two letters are an abbreviation only before joint, tip or link names: `ffj0`, `th_tip`, `rfproximal`.
                word.strip_prefix(beginning).is_some_and(|rest| {
                    beginning.len() > 2
                        || rest.is_empty()
                        || rest.starts_with('j')
                        || ["tip", "prox", "mid", "dist", "knuck", "base", "hub", "meta", "mcp", "pip", "dip"]
                            .iter()
                            .any(|part| rest.starts_with(part))
                })
            })
        })
    };
    begins(telling.first()?).or_else(|| {
        // Elsewhere in a name, whole words only; `middle` is a phalanx there, unless nothing else is.
        let found = |human: usize| telling.iter().any(|word| BEGINNINGS[human].contains(word));
        [0, 1, 3, 4, 2].into_iter().find(|human| found(*human))
    })
}

/// The body that a spec's tip names.
fn tip_part(parts: &Parts, finger: &str, tip: &TipSpec) -> Result<usize> {
    let given = [&tip.body, &tip.site, &tip.geom].into_iter().flatten().count();
    if given != 1 {
        let got = if given == 0 { "none of them".to_owned() } else { format!("{given} of them") };
        return Err(Error::value(format!("fingers.{finger}.tip"), "one of body, site and geom", got));
    }
    if let Some(name) = &tip.body {
        return body(parts, name);
    }
    if let Some(name) = &tip.site {
        let found = parts.sites.iter().find(|site| site.name == *name);
        let known = parts.sites.iter().map(|site| site.name.as_str());
        return found.map(|site| site.body).ok_or_else(|| Error::unknown("site", name, known));
    }
    let name = tip.geom.as_deref().unwrap_or_default();
    geom(parts, name).map(|geom| parts.geoms[geom].body)
}

/// Looks a body up.
///
/// # Errors
/// If there is none of that name; the error lists all.
pub fn body(parts: &Parts, name: &str) -> Result<usize> {
    let found = parts.bodies.iter().position(|body| body.name == name);
    found.ok_or_else(|| Error::unknown("body", name, parts.bodies.iter().map(|body| body.name.as_str())))
}

/// Looks a geom up.
///
/// # Errors
/// If there is none of that name; the error lists all that have one.
pub fn geom(parts: &Parts, name: &str) -> Result<usize> {
    let known = parts.geoms.iter().map(|geom| geom.name.as_str()).filter(|name| !name.is_empty());
    parts.geoms.iter().position(|geom| geom.name == name).ok_or_else(|| Error::unknown("geom", name, known))
}

/// Looks a joint up.
///
/// # Errors
/// If there is none of that name; the error lists all.
pub fn joint(parts: &Parts, name: &str) -> Result<usize> {
    let found = parts.joints.iter().position(|joint| joint.name == name);
    found.ok_or_else(|| Error::unknown("joint", name, parts.joints.iter().map(|joint| joint.name.as_str())))
}

fn finger(
    world: &World,
    parts: &Parts,
    moves: &[bool],
    human: usize,
    spec: &FingerSpec,
    links: Vec<usize>,
) -> Result<Finger> {
    let name = FINGERS[human];
    let Some(last) = links.last().copied() else {
        return Err(Error::value(format!("fingers.{name}.tip"), "a body that a joint moves", "one that stands still"));
    };
    for link in &spec.links {
        body(parts, link)?;
    }
    let joints: Vec<usize> = links
        .iter()
        .flat_map(|link| (0..parts.joints.len()).filter(|joint| parts.joints[*joint].body == *link))
        .filter(|joint| moves[*joint])
        .collect();
    let (tip_body, tip, tip_name) = tip(world, parts, &spec.tip, last, &joints)?;
    let mut pad_geoms: Vec<usize> = spec.pad_geoms.iter().map(|name| geom(parts, name)).collect::<Result<_>>()?;
    if pad_geoms.is_empty() {
        let of_tip = |geom: &usize| {
            let geom = &parts.geoms[*geom];
            geom.solid && parts.bodies[geom.body].part == parts.bodies[last].part
        };
        let all: Vec<usize> = (0..parts.geoms.len()).filter(of_tip).collect();
        let collide = all.iter().copied().filter(|geom| parts.geoms[*geom].bits != [0, 0]).collect::<Vec<_>>();
        pad_geoms = if collide.is_empty() { all } else { collide };
    }
    let (origin, rotation) = world.body_pose(tip_body);
    let place = origin + rotation * tip;
    let hinges: Vec<usize> =
        joints.iter().copied().filter(|joint| parts.joints[*joint].motion == Motion::Hinge).collect();
    // A finger bends where axes are parallel to the last one's; a thumb's lie every way.
    let last_axis = hinges.last().map_or(DVec3::ZERO, |joint| world.joint_axis(*joint).1);
    let bends = |joint: &usize| human == 0 || world.joint_axis(*joint).1.dot(last_axis).abs() > 0.7;
    let mut knuckles: Vec<usize> = Vec::new();
    for joint in hinges.into_iter().filter(bends) {
        // Axes that cross make one knuckle.
        let anchor = world.joint_axis(joint).0;
        if knuckles.last().is_none_or(|other| world.joint_axis(*other).0.distance(anchor) > 0.006) {
            knuckles.push(joint);
        }
    }
    let chain: Vec<DVec3> = knuckles.iter().map(|joint| world.joint_axis(*joint).0).chain([place]).collect();
    // What a knuckle before the third from the tip turns is part of the palm, as the metacarpals are.
    let phalanges = &chain[chain.len().saturating_sub(4)..];
    let length = phalanges.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
    let along = chain.len().checked_sub(2).map_or(DVec3::ZERO, |at| (place - chain[at]).normalize_or_zero());
    // A tip far beyond all shapes, whose mesh is missing: what is there of the finger is not what touches.
    if spec.pad_geoms.is_empty() && beyond(world, parts, &pad_geoms, place, along) > SHOWN {
        pad_geoms.clear();
    }
    let pad_normal = match spec.pad_normal {
        Some(normal) => DVec3::from_array(normal).try_normalize().ok_or_else(|| {
            Error::value(format!("fingers.{name}.pad_normal"), "a direction", "a vector without length")
        })?,
        None => rotation.transpose() * closing(world, parts, &joints, place, along),
    };
    Ok(Finger { human, links, joints, tip_body, tip, pad_normal, pad_geoms, knuckles, length, tip_name })
}

/// How far a tip is beyond the far end of some geoms, m; negative = within them.
fn beyond(world: &World, parts: &Parts, geoms: &[usize], tip: DVec3, along: DVec3) -> f64 {
    let reach = |geom: &usize| {
        let (origin, rotation) = world.geom_pose(*geom);
        let points = parts.geoms[*geom].points.iter().map(move |point| origin + rotation * *point);
        points.map(|point| (tip - point).dot(along)).fold(f64::INFINITY, f64::min)
    };
    geoms.iter().map(reach).fold(f64::INFINITY, f64::min)
}

/// Where the tip goes when the finger's last joint closes, across the last phalanx.
fn closing(world: &World, parts: &Parts, joints: &[usize], place: DVec3, along: DVec3) -> DVec3 {
    for joint in joints.iter().rev() {
        let (anchor, axis) = world.joint_axis(*joint);
        let joint = &parts.joints[*joint];
        let position = world.qpos()[joint.qpos];
        let closes = if joint.range[1] - position >= position - joint.range[0] { 1.0 } else { -1.0 };
        let velocity = match joint.motion {
            Motion::Slide => axis,
            _ => axis.cross(place - anchor),
        };
        if let Some(normal) = (closes * velocity).reject_from(along_or_z(along)).try_normalize() {
            return normal;
        }
    }
    DVec3::Z
}

fn along_or_z(along: DVec3) -> DVec3 {
    if along == DVec3::ZERO { DVec3::new(1e-9, 0.0, 1e-9) } else { along }
}

/// Body, local position and source of the tip.
fn tip(world: &World, parts: &Parts, spec: &TipSpec, last: usize, joints: &[usize]) -> Result<(usize, DVec3, String)> {
    if let Some(name) = &spec.site
        && let Some(site) = parts.sites.iter().find(|site| site.name == *name)
    {
        return Ok((site.body, spec.pos.map_or(site.position, DVec3::from_array), format!("site {name}")));
    }
    let anchor = joints.last().map_or_else(|| world.body_pose(last).0, |joint| world.joint_axis(*joint).0);
    if let Some(name) = &spec.geom {
        let geom = geom(parts, name)?;
        let body = parts.geoms[geom].body;
        let far = match spec.pos {
            Some(pos) => DVec3::from_array(pos),
            None => {
                local(world, body, far_end(world, parts, &[geom], anchor).unwrap_or_else(|| world.geom_pose(geom).0))
            }
        };
        return Ok((body, far, format!("geom {name}")));
    }
    let of_part = |body: usize| parts.bodies[body].part == parts.bodies[last].part;
    if let Some(name) = &spec.body {
        let body = body(parts, name)?;
        if let Some(pos) = spec.pos {
            return Ok((body, DVec3::from_array(pos), format!("body {name}")));
        }
        let geoms: Vec<usize> = (0..parts.geoms.len()).filter(|geom| parts.geoms[*geom].body == body).collect();
        let far = far_end(world, parts, &solid_or_all(parts, geoms), anchor);
        return Ok((body, far.map_or(DVec3::ZERO, |far| local(world, body, far)), format!("body {name}")));
    }
    if let Some(site) = parts.sites.iter().find(|site| of_part(site.body) && site.name.to_lowercase().contains("tip")) {
        return Ok((site.body, site.position, format!("site {}", site.name)));
    }
    // A body of that name without a shape marks the tip itself.
    let marker = (0..parts.bodies.len()).find(|body| {
        let name = parts.bodies[*body].name.to_lowercase();
        let is_bare = parts.geoms.iter().all(|geom| geom.body != *body);
        of_part(*body) && *body != last && name.contains("tip") && is_bare
    });
    if let Some(body) = marker {
        return Ok((body, DVec3::ZERO, format!("body {}", parts.bodies[body].name)));
    }
    let far = farthest(world, parts, last, anchor).unwrap_or_else(|| {
        // Nothing tells the last phalanx's length: as long as the one before.
        let before = joints.iter().rev().map(|joint| world.joint_axis(*joint).0).find(|a| a.distance(anchor) > 0.006);
        before.map_or(world.body_pose(last).0, |before| anchor + 0.8 * (anchor - before))
    });
    Ok((last, local(world, last, far), format!("far end of {}", parts.bodies[last].name)))
}

fn local(world: &World, body: usize, place: DVec3) -> DVec3 {
    let (origin, rotation) = world.body_pose(body);
    rotation.transpose() * (place - origin)
}

/// Those that collide, or all.
fn solid_or_all(parts: &Parts, geoms: Vec<usize>) -> Vec<usize> {
    let collide: Vec<usize> = geoms.iter().copied().filter(|geom| parts.geoms[*geom].bits != [0, 0]).collect();
    if collide.is_empty() { geoms } else { collide }
}

/// The far end of everything that a part carries, seen from a point; fixed bodies' origins where it has no shape.
fn farthest(world: &World, parts: &Parts, last: usize, from: DVec3) -> Option<DVec3> {
    let of_part = |body: usize| parts.bodies[body].part == parts.bodies[last].part;
    let geoms: Vec<usize> = (0..parts.geoms.len()).filter(|geom| of_part(parts.geoms[*geom].body)).collect();
    far_end(world, parts, &solid_or_all(parts, geoms), from).or_else(|| {
        let bodies = (0..parts.bodies.len()).filter(|body| of_part(*body) && *body != last);
        let places = bodies.map(|body| world.body_pose(body).0);
        places.max_by(|a, b| a.distance(from).total_cmp(&b.distance(from))).filter(|far| far.distance(from) > 0.002)
    })
}

/// The middle of the outermost millimetre of some geoms, along the line from a point through their middle.
fn far_end(world: &World, parts: &Parts, geoms: &[usize], from: DVec3) -> Option<DVec3> {
    let points: Vec<DVec3> = geoms
        .iter()
        .flat_map(|geom| {
            let (origin, rotation) = world.geom_pose(*geom);
            parts.geoms[*geom].points.iter().map(move |point| origin + rotation * *point)
        })
        .collect();
    let count = points.len() as f64;
    let middle = points.iter().sum::<DVec3>() / count.max(1.0);
    let line = (middle - from).try_normalize()?;
    let reach = |point: &DVec3| (*point - from).dot(line);
    let most = points.iter().map(reach).fold(f64::NEG_INFINITY, f64::max);
    let outer: Vec<&DVec3> = points.iter().filter(|point| reach(point) > most - 0.001).collect();
    let sum: DVec3 = outer.iter().copied().sum();
    (!outer.is_empty()).then(|| sum / outer.len() as f64)
}
