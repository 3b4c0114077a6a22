//! Labels: the human finger that each chain of a model stands for.

use glam::DVec3;

use super::tip::farthest;
use crate::mujoco::World;
use crate::mujoco::parts::Parts;

/// Prefixes of names by human finger, thumb to little.
const PREFIXES: [&[&str]; 5] = [
    &["thumb", "th"],
    &["index", "fore", "if", "ff"],
    &["middle", "mf"],
    &["ring", "rf"],
    &["little", "pinky", "pinkie", "lf", "pf"],
];
/// Words that do not tell the finger.
const FILLERS: [&str; 12] =
    ["right", "left", "rh", "lh", "r", "l", "hand", "robot0", "gripper0", "finger", "link", "joint"];
/// Beginnings of the names of joints and links that may follow an abbreviated finger.
const LINK_NAMES: [&str; 12] = ["j", "tip", "prox", "mid", "dist", "knuck", "base", "hub", "meta", "mcp", "pip", "dip"];

/// Returns the human finger of each chain: by the names in it, otherwise by geometry; None = no finger is left for it.
pub fn labels(world: &World, parts: &Parts, chains: &[Vec<usize>]) -> Vec<Option<usize>> {
    let mut labels = labels_by_name(parts, chains);
    let lines: Vec<Line> = chains.iter().map(|chain| Line::of(world, parts, chain)).collect();
    if labels.iter().all(|label| *label != Some(0))
        && let Some(thumb) = thumb_by_direction(&labels, &lines)
    {
        labels[thumb] = Some(0);
    }
    label_in_row(&mut labels, &lines);
    labels
}

/// Straight line from the base of a chain to its far end, in the world, m.
#[derive(Debug, Clone, Copy)]
struct Line {
    base: DVec3,
    end: DVec3,
}

impl Line {
    fn of(world: &World, parts: &Parts, chain: &[usize]) -> Self {
        let (first, last) = (chain[0], chain[chain.len() - 1]);
        let base = world.body_pose(first).0;
        Self { base, end: farthest(world, parts, last, base).unwrap_or_else(|| world.body_pose(last).0) }
    }

    fn direction(&self) -> DVec3 {
        (self.end - self.base).normalize_or_zero()
    }
}

/// Labels each finger's chain that has most names of the finger, if no other finger has more names in the chain.
fn labels_by_name(parts: &Parts, chains: &[Vec<usize>]) -> Vec<Option<usize>> {
    let votes: Vec<[usize; 5]> = chains.iter().map(|chain| votes(parts, chain)).collect();
    let mut labels: Vec<Option<usize>> = vec![None; chains.len()];
    for human in 0..5 {
        let best = (0..chains.len()).filter(|chain| labels[*chain].is_none()).max_by_key(|chain| votes[*chain][human]);
        let Some(best) = best.filter(|best| votes[*best][human] > 0) else { continue };
        if (0..5).all(|other| votes[best][other] <= votes[best][human]) {
            labels[best] = Some(human);
        }
    }
    labels
}

/// Returns the chain without label whose direction differs most from the others': the thumb.
fn thumb_by_direction(labels: &[Option<usize>], lines: &[Line]) -> Option<usize> {
    let similarity = |k: usize| -> f64 {
        (0..lines.len()).filter(|j| *j != k).map(|j| lines[j].direction().dot(lines[k].direction())).sum()
    };
    let unlabelled = (0..lines.len()).filter(|k| labels[*k].is_none());
    unlabelled.min_by(|a, b| similarity(*a).total_cmp(&similarity(*b)))
}

/// Labels the chains that are left in the order of their bases, from the side to which the thumb points.
fn label_in_row(labels: &mut [Option<usize>], lines: &[Line]) {
    let mut unlabelled: Vec<usize> = (0..lines.len()).filter(|k| labels[*k].is_none()).collect();
    let pairs = unlabelled.iter().flat_map(|a| unlabelled.iter().map(move |b| lines[*a].base - lines[*b].base));
    let row = pairs.max_by(|a, b| a.length_squared().total_cmp(&b.length_squared())).unwrap_or(DVec3::ZERO);
    let middle = unlabelled.iter().map(|k| lines[*k].base).sum::<DVec3>() / unlabelled.len().max(1) as f64;
    let thumb = (0..lines.len()).find(|k| labels[*k] == Some(0));
    let toward = thumb.map_or(DVec3::ZERO, |k| lines[k].end - middle);
    let row = if row.dot(toward) < 0.0 { -row } else { row };
    unlabelled.sort_by(|a, b| lines[*b].base.dot(row).total_cmp(&lines[*a].base.dot(row)));
    for chain in unlabelled {
        labels[chain] = (1..5).find(|human| labels.iter().all(|label| *label != Some(*human)));
    }
}

/// Counts the names in a chain that belong to each human finger.
fn votes(parts: &Parts, chain: &[usize]) -> [usize; 5] {
    let mut votes = [0; 5];
    let in_chain = |body: usize| chain.contains(&parts.bodies[body].part) || chain.contains(&body);
    let names = (0..parts.bodies.len()).filter(|body| in_chain(*body)).map(|body| &parts.bodies[body].name);
    let names = names
        .chain(parts.joints.iter().filter(|joint| in_chain(joint.body)).map(|joint| &joint.name))
        .chain(parts.sites.iter().filter(|site| in_chain(site.body)).map(|site| &site.name))
        .chain(parts.geoms.iter().filter(|geom| in_chain(geom.body)).map(|geom| &geom.name));
    for name in names {
        if let Some(human) = finger_of_name(name) {
            votes[human] += 1;
        }
    }
    votes
}

/// Returns the human finger that a name begins with, or contains as a word.
fn finger_of_name(name: &str) -> Option<usize> {
    let lower = name.to_lowercase();
    let words: Vec<&str> = lower.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
    let significant: Vec<&str> = words.iter().copied().filter(|word| !FILLERS.contains(word)).collect();
    let begins = |word: &str| {
        (0..5).find(|human| {
            PREFIXES[*human].iter().any(|prefix| {
                // Two letters are an abbreviation only before the name of a joint or link: `ffj0`, `th_tip`, `rfproximal`.
                word.strip_prefix(prefix).is_some_and(|rest| {
                    prefix.len() > 2 || rest.is_empty() || LINK_NAMES.iter().any(|link| rest.starts_with(link))
                })
            })
        })
    };
    begins(significant.first()?).or_else(|| {
        // After the first word only whole words count. `middle` is tried last: there it may mean the middle phalanx.
        let found = |human: usize| significant.iter().any(|word| PREFIXES[human].contains(word));
        [0, 1, 3, 4, 2].into_iter().find(|human| found(*human))
    })
}
