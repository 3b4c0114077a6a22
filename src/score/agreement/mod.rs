//! Agreement of labelled vertices with simulated contact forces.
//!
//! Truth is label (c): a vertex is touched above 0.05 N. Each score is a ratio of sums, so that sums of episodes add up and
//! episodes can be resampled for confidence intervals; [`SCORES`](scores::SCORES) lists the scores.

pub mod scores;
pub mod timing;

use std::ops::AddAssign;

use glam::{DVec3, Vec3};

use self::timing::{Timing, TouchSample};
use crate::error::{Error, Result};
use crate::geometry::force::link_vertices;
use crate::hand::{HandModel, JOINT_NAMES, N_VERTICES, Side};
use crate::score::metrics::{Confusion, ForceErrors, contact, force};
use crate::tactile::{CONTACT_FORCE_N, N_FIELD};

/// Distance from the nearest contact beyond which a labelled vertex counts as a false contact, m.
pub const FALSE_CONTACT_DISTANCE: f64 = 0.003;

/// Probability above which a vertex counts as labelled.
const LABEL_THRESHOLD: f32 = contact::CONTACT_THRESHOLD;

/// Partition of the vertices of both hands into groups, whose touches and forces are compared as a whole.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct VertexGroups {
    group_of_vertex: Vec<u8>,
    names: Vec<String>,
    /// False leaves the scores of links undefined.
    are_links: bool,
}

impl VertexGroups {
    /// Returns the 16 links of each hand, left hand first.
    pub fn links(hands: &[HandModel; 2]) -> Self {
        let mut group_of_vertex = vec![0; N_FIELD];
        let mut names = Vec::new();
        for (hand, side) in hands.iter().zip(Side::BOTH) {
            for (link, vertices) in link_vertices(hand).iter().enumerate() {
                for vertex in vertices {
                    group_of_vertex[side.range().start + *vertex as usize] = names.len() as u8;
                }
                names.push(format!("{}/{}", side.name(), JOINT_NAMES[link]));
            }
        }
        Self { group_of_vertex, names, are_links: true }
    }

    /// Returns the two hands, for vertices whose links are not known.
    pub fn hands() -> Self {
        let group_of_vertex = (0..N_FIELD).map(|vertex| u8::from(vertex >= N_VERTICES)).collect();
        Self { group_of_vertex, names: Side::BOTH.map(|side| side.name().to_owned()).to_vec(), are_links: false }
    }

    /// Names of the groups, for instance `left/index3`.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    fn len(&self) -> usize {
        self.names.len()
    }
}

/// Truth of one frame.
#[derive(Debug, Clone)]
pub struct TruthFrame {
    time: f64,
    force: Vec<f32>,
    touched: Vec<f32>,
    mask: Vec<u8>,
    positions: Vec<Vec3>,
    near: Vec<bool>,
    has_contacts: bool,
}

impl TruthFrame {
    /// Creates the truth of one frame from label (c).
    ///
    /// `time` s; `force` (1556) N, NaN = unknown; `mask` (1556) 1 = counts, or empty = all count; `positions` (1556) of the
    /// vertices, m, each hand in its own frame, or empty if unknown; `contacts`: points where forces act on the left and the
    /// right hand, in the frames of `positions`; None uses the touched vertices instead.
    ///
    /// # Errors
    /// If an array has another length, a time or a position is not finite, or a force is negative or infinite.
    pub fn new(
        time: f64,
        force: Vec<f32>,
        mask: Vec<u8>,
        positions: Vec<Vec3>,
        contacts: Option<&[Vec<DVec3>; 2]>,
    ) -> Result<Self> {
        let lengths = [("force", force.len(), false), ("mask", mask.len(), true), ("positions", positions.len(), true)];
        for (name, length, optional) in lengths {
            if length != N_FIELD && !(optional && length == 0) {
                return Err(Error::shape(name, format!("[{N_FIELD}]"), [length]));
            }
        }
        if !time.is_finite() {
            return Err(Error::value("time", "finite seconds", time));
        }
        if let Some(bad) = force.iter().position(|f| *f < 0.0 || f.is_infinite()) {
            return Err(Error::value(format!("force[{bad}]"), "a number >= 0 or NaN", force[bad]));
        }
        if let Some(bad) = positions.iter().position(|p| !p.is_finite()) {
            return Err(Error::value(format!("positions[{bad}]"), "finite", positions[bad]));
        }
        let touched = force.iter().map(|f| if f.is_nan() { f32::NAN } else { f32::from(*f > CONTACT_FORCE_N) });
        let touched: Vec<f32> = touched.collect();
        let near = match positions.is_empty() {
            true => Vec::new(),
            false => near(&positions, &touched, contacts),
        };
        Ok(Self { time, force, touched, mask, positions, near, has_contacts: contacts.is_some() })
    }

    /// (1556) 1 = touched, 0 = not, NaN = unknown.
    pub fn touched(&self) -> &[f32] {
        &self.touched
    }

    /// (1556) N.
    pub fn force(&self) -> &[f32] {
        &self.force
    }

    /// True if the contact points were given; false if touched vertices are used instead.
    pub fn has_contacts(&self) -> bool {
        self.has_contacts
    }

    fn counts(&self, vertex: usize) -> bool {
        self.mask.get(vertex).is_none_or(|mask| *mask != 0) && !self.force[vertex].is_nan()
    }
}

/// Returns for each vertex whether a contact of its own hand is within [`FALSE_CONTACT_DISTANCE`].
fn near(positions: &[Vec3], touched: &[f32], contacts: Option<&[Vec<DVec3>; 2]>) -> Vec<bool> {
    let mut near = vec![false; N_FIELD];
    for side in Side::BOTH {
        let touched_vertices = || side.range().filter(|v| touched[*v] > 0.5).map(|v| positions[v].as_dvec3()).collect();
        let places = contacts.map_or_else(touched_vertices, |contacts| contacts[side as usize].clone());
        for vertex in side.range() {
            let at = positions[vertex].as_dvec3();
            near[vertex] = places.iter().any(|place| place.distance(at) <= FALSE_CONTACT_DISTANCE);
        }
    }
    near
}

/// Sums over frames, from which all scores are computed; sums of episodes add up.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sums {
    /// Frames.
    pub frames: u64,
    /// Confusion of labelled against touched vertices.
    pub counts: Confusion,
    /// Number of frames with a touched vertex, and the sums of their precision, recall, F1 and IoU.
    pub frame_scores: (u64, [f64; 4]),
    /// Number of frames without a touched vertex in which a vertex counts.
    pub quiet_frames: u64,
    /// Confusion of labelled against touched vertices in these frames.
    pub quiet: Confusion,
    /// Force on touched vertices, N.
    pub force: f64,
    /// Force on touched vertices that are not labelled, N.
    pub missed_force: f64,
    /// Labelled vertices in frames with known positions, and how many of them are far from every contact.
    pub labelled: (u64, u64),
    /// Errors of the labelled force.
    pub errors: ForceErrors,
    /// Per group: sum over frames of |labelled - true| force, and of the true force, N.
    pub group_force: Vec<[f64; 2]>,
    /// Number of groups with true and labelled force, and the sum of the distances of their centres of pressure, m.
    pub centres: (u64, f64),
    /// Onsets and offsets of touches.
    pub timing: Timing,
}

impl AddAssign<&Sums> for Sums {
    fn add_assign(&mut self, other: &Self) {
        self.frames += other.frames;
        self.counts = self.counts + other.counts;
        self.frame_scores.0 += other.frame_scores.0;
        self.frame_scores.1.iter_mut().zip(other.frame_scores.1).for_each(|(sum, x)| *sum += x);
        self.quiet_frames += other.quiet_frames;
        self.quiet = self.quiet + other.quiet;
        self.force += other.force;
        self.missed_force += other.missed_force;
        self.labelled = (self.labelled.0 + other.labelled.0, self.labelled.1 + other.labelled.1);
        self.errors = self.errors + other.errors;
        self.group_force.resize(self.group_force.len().max(other.group_force.len()), [0.0; 2]);
        for (sum, x) in self.group_force.iter_mut().zip(&other.group_force) {
            *sum = [sum[0] + x[0], sum[1] + x[1]];
        }
        self.centres = (self.centres.0 + other.centres.0, self.centres.1 + other.centres.1);
        self.timing.add(&other.timing);
    }
}

impl Sums {
    /// Returns the sums of one frame, without onsets and offsets, which need a [`Scorer`].
    ///
    /// `label` (1556): labelled above 0.5, NaN = unknown; `force` (1556) N, NaN or empty = unknown.
    ///
    /// # Errors
    /// If an array has another length.
    pub fn of_frame(groups: &VertexGroups, truth: &TruthFrame, label: &[f32], force: &[f32]) -> Result<Self> {
        for (name, length, optional) in [("label", label.len(), false), ("labelled force", force.len(), true)] {
            if length != N_FIELD && !(optional && length == 0) {
                return Err(Error::shape(name, format!("[{N_FIELD}]"), [length]));
            }
        }
        let counts = Confusion::of(&contact::pairs(label, &truth.touched, &truth.mask));
        let mut sums = Self { frames: 1, counts, ..Self::default() };
        if counts.positives() > 0 {
            let scores = counts.scores();
            let each = [scores.precision, scores.recall, scores.f1, scores.iou];
            sums.frame_scores = (1, each.map(Option::unwrap_or_default));
        } else if counts.counts() {
            (sums.quiet_frames, sums.quiet) = (1, counts);
        }
        for vertex in (0..N_FIELD).filter(|vertex| truth.counts(*vertex)) {
            let labelled = label[vertex] > LABEL_THRESHOLD;
            if truth.touched[vertex] > 0.5 {
                sums.force += f64::from(truth.force[vertex]);
                sums.missed_force += if labelled { 0.0 } else { f64::from(truth.force[vertex]) };
            }
            if labelled && !truth.near.is_empty() {
                sums.labelled.0 += 1;
                sums.labelled.1 += u64::from(!truth.near[vertex]);
            }
        }
        if !force.is_empty() {
            sums.errors = ForceErrors::of(&force::pairs(force, &truth.force, &truth.mask));
            if sums.errors.unknown == 0 && groups.are_links {
                sums.add_group_forces(groups, truth, force);
            }
        }
        Ok(sums)
    }

    fn add_group_forces(&mut self, groups: &VertexGroups, truth: &TruthFrame, force: &[f32]) {
        let mut totals = vec![[(0.0, DVec3::ZERO); 2]; groups.len()];
        for vertex in (0..N_FIELD).filter(|vertex| truth.counts(*vertex)) {
            let at = truth.positions.get(vertex).map_or(DVec3::ZERO, |p| p.as_dvec3());
            let both = &mut totals[usize::from(groups.group_of_vertex[vertex])];
            for ((sum, moment), f) in both.iter_mut().zip([force[vertex], truth.force[vertex]]) {
                *sum += f64::from(f);
                *moment += f64::from(f) * at;
            }
        }
        self.group_force = totals.iter().map(|[(label, _), (truth, _)]| [(label - truth).abs(), *truth]).collect();
        let least = f64::from(CONTACT_FORCE_N);
        for [label, truth_sum] in totals {
            if !truth.positions.is_empty() && label.0 > least && truth_sum.0 > least {
                self.centres.0 += 1;
                self.centres.1 += (label.1 / label.0).distance(truth_sum.1 / truth_sum.0);
            }
        }
    }
}

/// Accumulates the sums of one label over one episode, frame by frame.
#[derive(Debug, Clone)]
pub struct Scorer {
    groups: VertexGroups,
    sums: Sums,
    /// Frames since the last refused one: time, and one bit per group for touched and for labelled.
    segment: Vec<(f64, u64, u64)>,
}

impl Scorer {
    /// Starts an episode.
    pub fn new(groups: VertexGroups) -> Self {
        Self { groups, sums: Sums::default(), segment: Vec::new() }
    }

    /// Adds the next frame, with arguments as for [`Sums::of_frame`], and returns the frame's sums.
    ///
    /// # Errors
    /// As [`Sums::of_frame`], and if time does not grow.
    pub fn push(&mut self, truth: &TruthFrame, label: &[f32], force: &[f32]) -> Result<Sums> {
        let sums = Sums::of_frame(&self.groups, truth, label, force)?;
        let before = self.segment.last().map_or(f64::NEG_INFINITY, |(time, ..)| *time);
        if truth.time <= before {
            return Err(Error::value("time", format!("above {before} s, the frame before"), truth.time));
        }
        let (mut touched, mut labelled) = (0, 0);
        for vertex in (0..N_FIELD).filter(|vertex| truth.counts(*vertex)) {
            let group = self.groups.group_of_vertex[vertex];
            touched |= u64::from(truth.touched[vertex] > 0.5) << group;
            labelled |= u64::from(label[vertex] > LABEL_THRESHOLD) << group;
        }
        self.segment.push((truth.time, touched, labelled));
        self.sums += &sums;
        Ok(sums)
    }

    /// Leaves out a frame that a guard refused; touches are not followed across it.
    pub fn refuse(&mut self) {
        for group in 0..self.groups.len() {
            let has = |bits: u64| bits >> group & 1 == 1;
            let samples = self.segment.iter().map(|(time, touched, labelled)| (*time, has(*touched), has(*labelled)));
            self.sums.timing.add(&timing::compare(&samples.collect::<Vec<TouchSample>>()));
        }
        self.segment.clear();
    }

    /// Ends the episode and returns its sums.
    pub fn finish(mut self) -> Sums {
        self.refuse();
        self.sums
    }
}
