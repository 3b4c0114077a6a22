//! Joints that move together: every joint's position as a line over the free coordinates, q = C u + c.
//!
//! Three things couple joints: equalities (URDF `mimic` becomes one), an actuated tendon over several joints, and the
//! robot's YAML file. A tendon fixes its length alone; how the joints share it is where their springs balance, equal
//! shares by leverage where there are no springs.

use crate::error::{Error, Result};
use crate::mujoco::World;
use crate::mujoco::parts::{Joint, Motion, Parts, Pull};

/// Range of a joint that has no limits, rad or m.
const UNLIMITED: f64 = std::f64::consts::PI;

/// How all joints follow from the free coordinates.
#[derive(Debug, Clone, Default)]
pub struct Coupling {
    /// For each joint of the model, in its order.
    pub joints: Vec<Driven>,
    /// Least position of each free coordinate, rad or m.
    pub low: Vec<f64>,
    /// Most.
    pub high: Vec<f64>,
    /// The joint whose position each free coordinate is.
    pub masters: Vec<usize>,
}

/// What decides a joint's position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Driven {
    /// Nothing of ours: a ball or free joint, left as it is.
    Not,
    /// It stands still.
    Fixed(f64),
    /// ratio * u + offset.
    By {
        /// Index of the free coordinate.
        coordinate: usize,
        /// Ratio.
        ratio: f64,
        /// Offset, rad or m.
        offset: f64,
    },
}

/// A joint that follows another: joint = ratio * of + offset.
#[derive(Debug, Clone, Copy)]
pub struct Follow {
    /// The joint that follows.
    pub joint: usize,
    /// The joint it follows.
    pub of: usize,
    /// Ratio.
    pub ratio: f64,
    /// Offset, rad or m.
    pub offset: f64,
}

/// A joint on the way to its place: it follows the joint `of` by a line.
#[derive(Debug, Clone, Copy)]
struct Line {
    of: usize,
    ratio: f64,
    offset: f64,
}

impl Coupling {
    /// Derives the coupling of a model.
    ///
    /// `initial`: positions of the model's initial state; `fixed`: position of each joint that stands still.
    ///
    /// # Errors
    /// If a coupling is not a line, two contradict each other, or the limits of coupled joints leave no position.
    pub fn derive(
        world: &mut World,
        parts: &Parts,
        initial: &[f64],
        fixed: &[Option<f64>],
        more: &[Follow],
        margin: f64,
    ) -> Result<Self> {
        let mut lines: Vec<Line> =
            (0..parts.joints.len()).map(|joint| Line { of: joint, ratio: 1.0, offset: 0.0 }).collect();
        let mut fixed = fixed.to_vec();
        for follow in equalities(parts, initial, &mut fixed)?.iter().chain(more) {
            attach(&mut lines, parts, follow)?;
        }
        for follow in tendons(world, parts, initial, &fixed, &lines)? {
            attach(&mut lines, parts, &follow)?;
        }
        Self::assemble(parts, &lines, &fixed, margin)
    }

    fn assemble(parts: &Parts, lines: &[Line], fixed: &[Option<f64>], margin: f64) -> Result<Self> {
        let mut coupling = Self { joints: vec![Driven::Not; lines.len()], ..Self::default() };
        // A joint that stands still keeps all that follow it, and all that it follows, still.
        let mut still: Vec<Option<f64>> = vec![None; lines.len()];
        for (joint, position) in fixed.iter().enumerate() {
            let Some(position) = position else { continue };
            let line = lines[joint];
            still[line.of] = Some((position - line.offset) / line.ratio);
        }
        let mut index = vec![None; lines.len()];
        for (joint, line) in lines.iter().enumerate() {
            if parts.joints[joint].motion == Motion::Other {
                continue;
            }
            coupling.joints[joint] = match still[line.of] {
                Some(master) => Driven::Fixed(line.ratio * master + line.offset),
                None => {
                    let coordinate = *index[line.of].get_or_insert_with(|| {
                        coupling.masters.push(line.of);
                        coupling.low.push(f64::NEG_INFINITY);
                        coupling.high.push(f64::INFINITY);
                        coupling.masters.len() - 1
                    });
                    let [low, high] = range(&parts.joints[joint], margin);
                    let [a, b] = [(low - line.offset) / line.ratio, (high - line.offset) / line.ratio];
                    coupling.low[coordinate] = coupling.low[coordinate].max(a.min(b));
                    coupling.high[coordinate] = coupling.high[coordinate].min(a.max(b));
                    Driven::By { coordinate, ratio: line.ratio, offset: line.offset }
                }
            };
        }
        for coordinate in 0..coupling.masters.len() {
            let (low, high) = (coupling.low[coordinate], coupling.high[coordinate]);
            if low > high + 1e-6 {
                let names: Vec<&str> = (0..lines.len())
                    .filter(|joint| lines[*joint].of == coupling.masters[coordinate])
                    .map(|joint| parts.joints[joint].name.as_str())
                    .collect();
                let got = format!("least {low:.4} above most {high:.4}");
                return Err(Error::value(format!("limits of joints {}", names.join(", ")), "a common position", got));
            }
            // Rounding alone must not turn a range inside out.
            coupling.high[coordinate] = high.max(low);
        }
        Ok(coupling)
    }

    /// Free coordinates.
    pub fn len(&self) -> usize {
        self.masters.len()
    }

    /// Whether nothing can move.
    pub fn is_empty(&self) -> bool {
        self.masters.is_empty()
    }

    /// Writes all joints' positions into `qpos`, given the free coordinates.
    pub fn expand(&self, parts: &Parts, u: &[f64], qpos: &mut [f64]) {
        for (joint, driven) in parts.joints.iter().zip(&self.joints) {
            match *driven {
                Driven::Not => {}
                Driven::Fixed(position) => qpos[joint.qpos] = position,
                Driven::By { coordinate, ratio, offset } => qpos[joint.qpos] = ratio * u[coordinate] + offset,
            }
        }
    }

    /// Reads the free coordinates from positions; what the couplings do not allow is lost.
    pub fn reduce(&self, parts: &Parts, qpos: &[f64], u: &mut [f64]) {
        for (coordinate, master) in self.masters.iter().enumerate() {
            u[coordinate] = qpos[parts.joints[*master].qpos].clamp(self.low[coordinate], self.high[coordinate]);
        }
    }

    /// How far positions are beyond limits or off couplings at most, rad or m.
    pub fn violation(&self, parts: &Parts, qpos: &[f64]) -> f64 {
        let mut worst = 0.0f64;
        for (joint, driven) in parts.joints.iter().zip(&self.joints) {
            let position = qpos[joint.qpos];
            let off = match *driven {
                Driven::Not => 0.0,
                Driven::Fixed(there) => (position - there).abs(),
                Driven::By { coordinate, ratio, offset } => {
                    let master = qpos[parts.joints[self.masters[coordinate]].qpos];
                    let [low, high] = range(joint, 0.0);
                    (position - ratio * master - offset).abs().max(low - position).max(position - high)
                }
            };
            worst = worst.max(off);
        }
        worst
    }
}

/// Limits of a joint, a margin inside; a joint with less room than that keeps its middle.
fn range(joint: &Joint, margin: f64) -> [f64; 2] {
    let [low, high] = joint.range;
    let low = if low.is_finite() { low } else { -UNLIMITED };
    let high = if high.is_finite() { high } else { UNLIMITED };
    match low + margin <= high - margin {
        true => [low + margin, high - margin],
        false => [0.5 * (low + high); 2],
    }
}

/// Makes one joint, and all that moves with it, follow another.
fn attach(lines: &mut [Line], parts: &Parts, follow: &Follow) -> Result<()> {
    let (a, b) = (lines[follow.joint], lines[follow.of]);
    let name = |joint: usize| parts.joints[joint].name.clone();
    if follow.ratio.abs() < 1e-9 || !follow.ratio.is_finite() || !follow.offset.is_finite() {
        let what = format!("coupling of joints {} and {}", name(follow.joint), name(follow.of));
        return Err(Error::value(what, "a ratio other than 0", follow.ratio));
    }
    // joint = a.ratio * master_a + a.offset = follow.ratio * (b.ratio * master_b + b.offset) + follow.offset
    let ratio = follow.ratio * b.ratio / a.ratio;
    let offset = (follow.ratio * b.offset + follow.offset - a.offset) / a.ratio;
    if a.of == b.of {
        if (ratio - 1.0).abs() < 1e-6 && offset.abs() < 1e-6 {
            return Ok(());
        }
        let what = format!("couplings of joints {} and {}", name(follow.joint), name(follow.of));
        return Err(Error::value(what, "couplings that agree", "two that contradict each other"));
    }
    for line in lines.iter_mut().filter(|line| line.of == a.of) {
        *line = Line { of: b.of, ratio: line.ratio * ratio, offset: line.ratio * offset + line.offset };
    }
    Ok(())
}

/// The model's own joint equalities; those that hold a joint still go to `fixed`.
fn equalities(parts: &Parts, initial: &[f64], fixed: &mut [Option<f64>]) -> Result<Vec<Follow>> {
    let mut follows = Vec::new();
    for equality in &parts.equalities {
        let joint = &parts.joints[equality.joint];
        let [constant, ratio, higher @ ..] = equality.polynomial;
        let start = initial[joint.qpos];
        match equality.of {
            Some(of) if ratio != 0.0 => {
                if higher.iter().any(|c| *c != 0.0) {
                    let expected = "a line (coefficients of the square and above 0)";
                    let got = format!("{:?}", equality.polynomial);
                    return Err(Error::value(format!("equality of joint {}", joint.name), expected, got));
                }
                let offset = start + constant - ratio * initial[parts.joints[of].qpos];
                follows.push(Follow { joint: equality.joint, of, ratio, offset });
            }
            _ => fixed[equality.joint] = Some(start + constant),
        }
    }
    Ok(follows)
}

/// Joints that share an actuated tendon and nothing else pulls at.
fn tendons(
    world: &mut World,
    parts: &Parts,
    initial: &[f64],
    fixed: &[Option<f64>],
    lines: &[Line],
) -> Result<Vec<Follow>> {
    let pulled: Vec<usize> = parts
        .actuators
        .iter()
        .filter_map(|actuator| match actuator.pull {
            Pull::Tendon(tendon) => Some(tendon),
            _ => None,
        })
        .collect();
    if pulled.is_empty() {
        return Ok(Vec::new());
    }
    // Groups that move as one, by their master: what the tendons' lengths gain per unit of the master.
    let masters: Vec<usize> = (0..lines.len())
        .filter(|joint| lines[*joint].of == *joint && parts.joints[*joint].motion != Motion::Other)
        .filter(|master| (0..lines.len()).all(|joint| lines[joint].of != *master || fixed[joint].is_none()))
        .collect();
    let has_own = |master: usize| {
        parts.actuators.iter().any(|a| matches!(a.pull, Pull::Joint(joint) if lines[joint].of == master))
    };
    let leverages: Vec<Vec<f64>> =
        masters.iter().map(|master| leverage(world, parts, initial, lines, *master)).collect::<Result<_>>()?;
    let pulls = |group: usize, tendon: usize| leverages[group][tendon].abs() > 1e-6;
    let mut follows = Vec::new();
    for tendon in &pulled {
        let alone = |group: usize| pulled.iter().filter(|other| pulls(group, **other)).count() == 1;
        let groups: Vec<usize> = (0..masters.len())
            .filter(|group| pulls(*group, *tendon) && !has_own(masters[*group]) && alone(*group))
            .collect();
        let springs: Vec<f64> = groups.iter().map(|group| stiffness(parts, lines, masters[*group])).collect();
        let no_springs = springs.iter().any(|k| *k <= 0.0);
        let share = |k: usize| leverages[groups[k]][*tendon] / if no_springs { 1.0 } else { springs[k] };
        let Some(lead) = (0..groups.len()).max_by(|a, b| share(*a).abs().total_cmp(&share(*b).abs())) else { continue };
        let rest = |k: usize| {
            let joint = &parts.joints[masters[groups[k]]];
            if no_springs { initial[joint.qpos] } else { joint.spring_ref }
        };
        for k in (0..groups.len()).filter(|k| *k != lead) {
            let ratio = share(k) / share(lead);
            let (joint, of) = (masters[groups[k]], masters[groups[lead]]);
            follows.push(Follow { joint, of, ratio, offset: rest(k) - ratio * rest(lead) });
        }
    }
    Ok(follows)
}

/// What each tendon's length gains per unit of a master, in the initial state.
fn leverage(world: &mut World, parts: &Parts, initial: &[f64], lines: &[Line], master: usize) -> Result<Vec<f64>> {
    const STEP: f64 = 1e-4;
    let mut lengths = |step: f64| -> Result<Vec<f64>> {
        let mut qpos = initial.to_vec();
        for (joint, line) in lines.iter().enumerate().filter(|(_, line)| line.of == master) {
            qpos[parts.joints[joint].qpos] += line.ratio * step;
        }
        world.set_qpos(&qpos)?;
        world.update_poses();
        world.update_lengths();
        Ok(world.tendon_lengths().to_vec())
    };
    let (more, less) = (lengths(STEP)?, lengths(-STEP)?);
    Ok(more.iter().zip(&less).map(|(a, b)| (a - b) / (2.0 * STEP)).collect())
}

/// Stiffness of the springs on all joints of a group, per unit of the master.
fn stiffness(parts: &Parts, lines: &[Line], master: usize) -> f64 {
    let group = lines.iter().zip(&parts.joints).filter(|(line, _)| line.of == master);
    group.map(|(line, joint)| joint.stiffness * line.ratio * line.ratio).sum()
}
