//! Coupled joints: every joint position is a linear function of the free coordinates, q = C u + c.
//!
//! Joints are coupled by equalities of the model (URDF `mimic` becomes one), by an actuated tendon over several joints, and
//! by the robot's YAML file. A tendon determines its length only; its joints share it so that their springs are in balance,
//! or, without springs, in proportion to their leverage.

use crate::error::{Error, Result};
use crate::mujoco::World;
use crate::mujoco::parts::{Joint, Motion, Parts, Pull};

/// Position range to both sides of 0 for a joint without limits, rad or m.
const UNLIMITED: f64 = std::f64::consts::PI;
/// Least change of a tendon's length per unit of a joint, m/rad, that counts: below it the difference quotient is noise.
const MIN_LEVERAGE: f64 = 1e-6;
/// Greatest overlap of two bounds, or difference of two couplings, that counts as rounding, rad or m.
const TOLERANCE: f64 = 1e-6;
/// Least ratio of a coupling: the leading joint must be determined by the one that follows.
const MIN_RATIO: f64 = 1e-9;

/// Map from the free coordinates to all joint positions.
#[derive(Debug, Clone, Default)]
pub struct Coupling {
    /// Drive of each joint of the model, in the model's order.
    pub joints: Vec<JointDrive>,
    /// Lower bound of each free coordinate, rad or m.
    pub low: Vec<f64>,
    /// Upper bound of each free coordinate, rad or m.
    pub high: Vec<f64>,
    /// Joint whose position each free coordinate is.
    pub masters: Vec<usize>,
}

/// Source of a joint's position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JointDrive {
    /// Not controlled: a ball or free joint keeps its position.
    Free,
    /// Fixed at this position, rad or m.
    Fixed(f64),
    /// Position = ratio * u + offset.
    Coupled {
        /// Index of the free coordinate u.
        coordinate: usize,
        /// Ratio.
        ratio: f64,
        /// Offset, rad or m.
        offset: f64,
    },
}

/// Coupling of one joint to another: joint = ratio * of + offset.
#[derive(Debug, Clone, Copy)]
pub struct JointCoupling {
    /// Index of the joint that couplings.
    pub joint: usize,
    /// Index of the joint that leads.
    pub of: usize,
    /// Ratio.
    pub ratio: f64,
    /// Offset, rad or m.
    pub offset: f64,
}

/// Position of a joint in terms of a master joint, while couplings are collected: ratio * of + offset.
#[derive(Debug, Clone, Copy)]
struct MasterLine {
    of: usize,
    ratio: f64,
    offset: f64,
}

impl Coupling {
    /// Derives the coupling of a model.
    ///
    /// `initial`: `qpos` of the model's initial state; `fixed`: position of each joint that stands still, rad or m; `more`:
    /// couplings beside the model's; `margin`: distance to keep from joint limits, rad or m.
    ///
    /// # Errors
    /// If a coupling is not linear, two contradict each other, or the limits of coupled joints leave no position.
    pub fn derive(
        world: &mut World,
        parts: &Parts,
        initial: &[f64],
        fixed: &[Option<f64>],
        more: &[JointCoupling],
        margin: f64,
    ) -> Result<Self> {
        let mut lines: Vec<MasterLine> =
            (0..parts.joints.len()).map(|joint| MasterLine { of: joint, ratio: 1.0, offset: 0.0 }).collect();
        let mut fixed = fixed.to_vec();
        for new in equalities(parts, initial, &mut fixed)?.iter().chain(more) {
            attach(&mut lines, parts, new)?;
        }
        for new in tendons(world, parts, initial, &fixed, &lines)? {
            attach(&mut lines, parts, &new)?;
        }
        Self::assemble(parts, &lines, &fixed, margin)
    }

    fn assemble(parts: &Parts, lines: &[MasterLine], fixed: &[Option<f64>], margin: f64) -> Result<Self> {
        let mut coupling = Self { joints: vec![JointDrive::Free; lines.len()], ..Self::default() };
        // A joint that stands still holds its master still, and with it every joint of the group.
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
                Some(master) => JointDrive::Fixed(line.ratio * master + line.offset),
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
                    JointDrive::Coupled { coordinate, ratio: line.ratio, offset: line.offset }
                }
            };
        }
        for coordinate in 0..coupling.masters.len() {
            let (low, high) = (coupling.low[coordinate], coupling.high[coordinate]);
            if low > high + TOLERANCE {
                let names: Vec<&str> = (0..lines.len())
                    .filter(|joint| lines[*joint].of == coupling.masters[coordinate])
                    .map(|joint| parts.joints[joint].name.as_str())
                    .collect();
                let got = format!("least {low:.4} above most {high:.4}");
                return Err(Error::value(format!("limits of joints {}", names.join(", ")), "a common position", got));
            }
            // Rounding may leave the upper bound below the lower one by less than the tolerance above.
            coupling.high[coordinate] = high.max(low);
        }
        Ok(coupling)
    }

    /// Number of free coordinates.
    pub fn len(&self) -> usize {
        self.masters.len()
    }

    /// True if there is no free coordinate.
    pub fn is_empty(&self) -> bool {
        self.masters.is_empty()
    }

    /// Writes the joint positions of free coordinates `u` into `qpos`; free and ball joints keep theirs.
    pub fn expand(&self, parts: &Parts, u: &[f64], qpos: &mut [f64]) {
        for (joint, drive) in parts.joints.iter().zip(&self.joints) {
            match *drive {
                JointDrive::Free => {}
                JointDrive::Fixed(position) => qpos[joint.qpos] = position,
                JointDrive::Coupled { coordinate, ratio, offset } => qpos[joint.qpos] = ratio * u[coordinate] + offset,
            }
        }
    }

    /// Reads the free coordinates `u` from the positions of their master joints; all other positions are ignored.
    pub fn reduce(&self, parts: &Parts, qpos: &[f64], u: &mut [f64]) {
        for (coordinate, master) in self.masters.iter().enumerate() {
            u[coordinate] = qpos[parts.joints[*master].qpos].clamp(self.low[coordinate], self.high[coordinate]);
        }
    }

    /// Greatest violation of joint limits and couplings by `qpos`, rad or m.
    pub fn violation(&self, parts: &Parts, qpos: &[f64]) -> f64 {
        let mut worst = 0.0f64;
        for (joint, drive) in parts.joints.iter().zip(&self.joints) {
            let position = qpos[joint.qpos];
            let violation = match *drive {
                JointDrive::Free => 0.0,
                JointDrive::Fixed(fixed) => (position - fixed).abs(),
                JointDrive::Coupled { coordinate, ratio, offset } => {
                    let master = qpos[parts.joints[self.masters[coordinate]].qpos];
                    let [low, high] = range(joint, 0.0);
                    (position - ratio * master - offset).abs().max(low - position).max(position - high)
                }
            };
            worst = worst.max(violation);
        }
        worst
    }
}

/// Limits of a joint, reduced by a margin on both sides; the middle, twice, if the range is narrower than both margins.
fn range(joint: &Joint, margin: f64) -> [f64; 2] {
    let [low, high] = joint.range;
    let low = if low.is_finite() { low } else { -UNLIMITED };
    let high = if high.is_finite() { high } else { UNLIMITED };
    match low + margin <= high - margin {
        true => [low + margin, high - margin],
        false => [0.5 * (low + high); 2],
    }
}

/// Couples one joint, and all joints of its group, to another.
fn attach(lines: &mut [MasterLine], parts: &Parts, new: &JointCoupling) -> Result<()> {
    let (a, b) = (lines[new.joint], lines[new.of]);
    let name = |joint: usize| parts.joints[joint].name.clone();
    if new.ratio.abs() < MIN_RATIO || !new.ratio.is_finite() || !new.offset.is_finite() {
        let what = format!("coupling of joints {} and {}", name(new.joint), name(new.of));
        return Err(Error::value(what, "a ratio other than 0", new.ratio));
    }
    // joint = a.ratio * master_a + a.offset = new.ratio * (b.ratio * master_b + b.offset) + new.offset
    // is solved for master_a.
    let ratio = new.ratio * b.ratio / a.ratio;
    let offset = (new.ratio * b.offset + new.offset - a.offset) / a.ratio;
    if a.of == b.of {
        if (ratio - 1.0).abs() < TOLERANCE && offset.abs() < TOLERANCE {
            return Ok(());
        }
        let what = format!("couplings of joints {} and {}", name(new.joint), name(new.of));
        return Err(Error::value(what, "couplings that agree", "two that contradict each other"));
    }
    for line in lines.iter_mut().filter(|line| line.of == a.of) {
        *line = MasterLine { of: b.of, ratio: line.ratio * ratio, offset: line.ratio * offset + line.offset };
    }
    Ok(())
}

/// Returns the joint equalities of the model; positions of joints that an equality holds still go to `fixed`.
fn equalities(parts: &Parts, initial: &[f64], fixed: &mut [Option<f64>]) -> Result<Vec<JointCoupling>> {
    let mut couplings = Vec::new();
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
                couplings.push(JointCoupling { joint: equality.joint, of, ratio, offset });
            }
            _ => fixed[equality.joint] = Some(start + constant),
        }
    }
    Ok(couplings)
}

/// Couplings of joints by actuated tendons.
///
/// A tendon couples the groups of joints that it moves, no other actuated tendon moves, and no actuator drives directly.
fn tendons(
    world: &mut World,
    parts: &Parts,
    initial: &[f64],
    fixed: &[Option<f64>],
    lines: &[MasterLine],
) -> Result<Vec<JointCoupling>> {
    let actuated: Vec<usize> = parts
        .actuators
        .iter()
        .filter_map(|actuator| match actuator.pull {
            Pull::Tendon(tendon) => Some(tendon),
            _ => None,
        })
        .collect();
    if actuated.is_empty() {
        return Ok(Vec::new());
    }
    let masters = moving_masters(parts, fixed, lines);
    let is_driven_directly = |master: usize| {
        parts.actuators.iter().any(|a| matches!(a.pull, Pull::Joint(joint) if lines[joint].of == master))
    };
    let leverages: Vec<Vec<f64>> =
        masters.iter().map(|master| leverage(world, parts, initial, lines, *master)).collect::<Result<_>>()?;
    let moves = |tendon: usize, group: usize| leverages[group][tendon].abs() > MIN_LEVERAGE;
    let mut couplings = Vec::new();
    for tendon in actuated.iter().copied() {
        let is_only_mover = |group: usize| actuated.iter().filter(|other| moves(**other, group)).count() == 1;
        let groups = (0..masters.len())
            .filter(|group| moves(tendon, *group) && !is_driven_directly(masters[*group]) && is_only_mover(*group))
            .map(|group| TendonGroup {
                master: masters[group],
                leverage: leverages[group][tendon],
                stiffness: stiffness(parts, lines, masters[group]),
            });
        couplings.extend(share_tendon(parts, initial, &groups.collect::<Vec<_>>()));
    }
    Ok(couplings)
}

/// Group of coupled joints that a tendon moves.
#[derive(Debug, Clone, Copy)]
struct TendonGroup {
    master: usize,
    /// Tendon length per unit of the master, m/rad or 1.
    leverage: f64,
    /// Spring stiffness per unit of the master, N m/rad or N/m.
    stiffness: f64,
}

/// Returns the masters of the groups that can move.
fn moving_masters(parts: &Parts, fixed: &[Option<f64>], lines: &[MasterLine]) -> Vec<usize> {
    (0..lines.len())
        .filter(|joint| lines[*joint].of == *joint && parts.joints[*joint].motion != Motion::Other)
        .filter(|master| (0..lines.len()).all(|joint| lines[joint].of != *master || fixed[joint].is_none()))
        .collect()
}

/// Couples the groups that share a tendon to the group that moves most.
///
/// A tendon under tension T pulls a group with T * leverage; its springs balance that at a deflection of
/// T * leverage / stiffness. Deflections therefore keep the ratio of leverage / stiffness.
fn share_tendon(parts: &Parts, initial: &[f64], groups: &[TendonGroup]) -> Vec<JointCoupling> {
    let has_springs = groups.iter().all(|group| group.stiffness > 0.0);
    let share = |group: &TendonGroup| group.leverage / if has_springs { group.stiffness } else { 1.0 };
    let rest = |group: &TendonGroup| {
        let joint = &parts.joints[group.master];
        if has_springs { joint.spring_ref } else { initial[joint.qpos] }
    };
    let Some(lead) = (0..groups.len()).max_by(|a, b| share(&groups[*a]).abs().total_cmp(&share(&groups[*b]).abs()))
    else {
        return Vec::new();
    };
    let leader = groups[lead];
    let others = groups.iter().enumerate().filter(|(index, _)| *index != lead);
    let coupling = |(_, group): (usize, &TendonGroup)| {
        let ratio = share(group) / share(&leader);
        JointCoupling { joint: group.master, of: leader.master, ratio, offset: rest(group) - ratio * rest(&leader) }
    };
    others.map(coupling).collect()
}

/// Change of each tendon's length per unit of a master in the initial state, by central differences.
fn leverage(
    world: &mut World,
    parts: &Parts,
    initial: &[f64],
    lines: &[MasterLine],
    master: usize,
) -> Result<Vec<f64>> {
    /// Half the difference of positions, rad or m: truncation (STEP squared) and rounding errors are both below 1e-8 there.
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

/// Stiffness of the springs on all joints of a group, per unit of the master, N m/rad or N/m.
fn stiffness(parts: &Parts, lines: &[MasterLine], master: usize) -> f64 {
    let group = lines.iter().zip(&parts.joints).filter(|(line, _)| line.of == master);
    group.map(|(line, joint)| joint.stiffness * line.ratio * line.ratio).sum()
}
