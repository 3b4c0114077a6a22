//! Touch over time: force and contact per vertex of both hands for many frames.
//!
//! [`TactileSequence`] is the second of the only two types that cross the middle of the crate; the other one is
//! [`TactileField`], one instant of it. Readers of data sets produce sequences, and training, metrics and reports consume
//! them.

use std::borrow::Cow;
use std::ops::Range;

use super::{CONTACT_FORCE_N, ForceKind, N_FIELD, TactileField};
use crate::error::{Error, Result};
use crate::hand::Topology;

/// Touch on both hands over `T` frames, with time stamps, episodes and masks.
///
/// Arrays of shape (T, 1556) hold one row per frame, left hand first. An empty optional array means that the source does
/// not provide it.
///
/// ```
/// use egotac::{TactileField, TactileSequence, Topology};
///
/// let mut sequence = TactileSequence::default();
/// for _ in 0..25 {
///     sequence.push(&TactileField::zeros(Topology::EgotacHand1))?;
/// }
/// sequence.timestamps = (0..25).map(|frame| 0.04 * f64::from(frame)).collect();
/// sequence.check()?;
/// assert_eq!((sequence.n_frames(), sequence.episodes()), (25, vec![0..25]));
/// assert_eq!(sequence.fps().map(f64::round), Some(25.0));
/// # Ok::<(), egotac::Error>(())
/// ```
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TactileSequence {
    /// Meaning of the vertex indices; None = the source does not say.
    pub topology: Option<Topology>,
    /// Meaning of the forces; None = the source does not say.
    pub force_kind: Option<ForceKind>,
    /// (T) s; empty = not given.
    pub timestamps: Vec<f64>,
    /// Exclusive cumulative ends of the episodes; empty = one episode.
    pub episode_ends: Vec<usize>,
    /// (T, 1556) normal force, N; NaN = unknown.
    pub force: Vec<f32>,
    /// (T, 1556) contact probability, or truth as 0 and 1; NaN = unknown.
    pub contact: Vec<f32>,
    /// (T, 1556) 1 = the force is supervised; empty = supervised everywhere.
    pub mask_force: Vec<u8>,
    /// (T, 1556) 1 = the contact is supervised; empty = supervised everywhere.
    pub mask_contact: Vec<u8>,
    /// (T) code of [`Validity`](super::Validity), 0 = valid; empty = all valid. Codes rather than the enum, so that a frame
    /// that a newer version refused stays refused.
    pub validity: Vec<u8>,
    /// (T) likeness of each image to those that the predicting network was trained on, 0 to 1; NaN = not estimated, empty =
    /// nobody estimated it.
    pub familiarity: Vec<f32>,
    /// (T, 2) presence of left and right hand in the image, 0 to 1; NaN = not estimated, empty = nobody estimated it.
    pub presence: Vec<f32>,
}

impl TactileSequence {
    /// Creates a sequence from forces alone, (T, 1556) N; contact is force > 0.05 N, and unknown where the force is.
    pub fn from_force(topology: Option<Topology>, force: Vec<f32>) -> Self {
        let contact = force.iter().map(|f| if f.is_nan() { f32::NAN } else { f32::from(*f > CONTACT_FORCE_N) });
        Self { topology, contact: contact.collect(), force, ..Self::default() }
    }

    /// Checks that the forces of two sequences mean the same, as far as both say so and know any.
    ///
    /// # Errors
    /// If they are of different kinds.
    pub fn same_force_kind(&self, other: &Self) -> Result<()> {
        let known = |sequence: &Self| sequence.force.iter().any(|force| !force.is_nan());
        match (self.force_kind, other.force_kind) {
            (Some(one), Some(two)) if one != two && known(self) && known(other) => one.must_match(two),
            _ => Ok(()),
        }
    }

    /// Number of frames.
    pub fn n_frames(&self) -> usize {
        self.force.len() / N_FIELD
    }

    /// True if there is no frame.
    pub fn is_empty(&self) -> bool {
        self.n_frames() == 0
    }

    /// Appends one frame to the last episode: supervised and valid where the sequence has masks or validity, without a time
    /// stamp. The first frame sets the topology.
    ///
    /// # Errors
    /// If the field's topology differs from the sequence's.
    pub fn push(&mut self, field: &TactileField) -> Result<()> {
        self.topology.get_or_insert(field.topology).must_match(field.topology)?;
        self.force.extend_from_slice(&field.force);
        self.contact.extend_from_slice(&field.contact);
        for mask in [&mut self.mask_force, &mut self.mask_contact] {
            if !mask.is_empty() {
                mask.resize(self.force.len(), 1);
            }
        }
        if !self.validity.is_empty() {
            self.validity.push(0);
        }
        for (values, width) in [(&mut self.familiarity, 1), (&mut self.presence, 2)] {
            if !values.is_empty() {
                values.resize(width * self.force.len() / N_FIELD, f32::NAN);
            }
        }
        if let Some(end) = self.episode_ends.last_mut() {
            *end += 1;
        }
        Ok(())
    }

    /// Returns one frame, on the default topology if the source does not say which one it has.
    ///
    /// # Errors
    /// If there is no such frame.
    pub fn field(&self, frame: usize) -> Result<TactileField> {
        match frame < self.n_frames() && self.contact.len() == self.force.len() {
            true => Ok(TactileField {
                topology: self.topology.unwrap_or_default(),
                force: self.force_at(frame).to_vec(),
                contact: self.contact_at(frame).to_vec(),
            }),
            false => Err(Error::value("frame", format!("an index below {}", self.n_frames()), frame)),
        }
    }

    /// Returns the forces of one frame, (1556) N.
    pub fn force_at(&self, frame: usize) -> &[f32] {
        &self.force[rows(frame..frame + 1)]
    }

    /// Returns the contacts of one frame, (1556).
    pub fn contact_at(&self, frame: usize) -> &[f32] {
        &self.contact[rows(frame..frame + 1)]
    }

    /// Returns the time stamp of one frame, s; its index where stamps are not given.
    pub fn stamp_or_index(&self, frame: usize) -> f64 {
        self.timestamps.get(frame).copied().unwrap_or(frame as f64)
    }

    /// Returns the frames of each episode.
    pub fn episodes(&self) -> Vec<Range<usize>> {
        match self.episode_ends.as_slice() {
            [] => std::iter::once(0..self.n_frames()).collect(),
            ends => episode_ranges(ends).collect(),
        }
    }

    /// Returns frames per second by the median step of the time stamps; None without at least two that grow.
    pub fn fps(&self) -> Option<f64> {
        fps(&self.timestamps)
    }

    /// Returns the mask of the forces that count, (T, 1556): frames that are not valid are masked out; empty = all count.
    pub fn counted_force(&self) -> Cow<'_, [u8]> {
        self.counted(&self.mask_force)
    }

    /// Returns the mask of the contacts that count, as [`counted_force`](Self::counted_force).
    pub fn counted_contact(&self) -> Cow<'_, [u8]> {
        self.counted(&self.mask_contact)
    }

    fn counted<'a>(&self, mask: &'a [u8]) -> Cow<'a, [u8]> {
        if self.validity.iter().all(|code| *code == 0) {
            return Cow::Borrowed(mask);
        }
        let of = |(entry, valid): (usize, bool)| u8::from(valid && mask.get(entry).is_none_or(|m| *m != 0));
        let valid = self.validity.iter().flat_map(|code| std::iter::repeat_n(*code == 0, N_FIELD));
        Cow::Owned(valid.enumerate().map(of).collect())
    }

    /// Returns the given frames in the given order. A new episode begins wherever the frame comes from another episode than
    /// the one before it.
    pub fn select(&self, frames: impl IntoIterator<Item = usize>) -> Self {
        let frames: Vec<usize> = frames.into_iter().collect();
        let episode_of = |frame: usize| self.episode_ends.partition_point(|end| *end <= frame);
        let mut episode_ends = Vec::new();
        if !self.episode_ends.is_empty() {
            let changes = frames.windows(2).enumerate().filter(|(_, pair)| episode_of(pair[0]) != episode_of(pair[1]));
            episode_ends.extend(changes.map(|(index, _)| index + 1));
            episode_ends.extend((!frames.is_empty()).then_some(frames.len()));
        }
        Self {
            topology: self.topology,
            force_kind: self.force_kind,
            timestamps: gather(&self.timestamps, &frames, 1),
            episode_ends,
            force: gather(&self.force, &frames, N_FIELD),
            contact: gather(&self.contact, &frames, N_FIELD),
            mask_force: gather(&self.mask_force, &frames, N_FIELD),
            mask_contact: gather(&self.mask_contact, &frames, N_FIELD),
            validity: gather(&self.validity, &frames, 1),
            familiarity: gather(&self.familiarity, &frames, 1),
            presence: gather(&self.presence, &frames, 2),
        }
    }

    /// Appends the episodes of another sequence. A mask or validity that one of the two lacks is filled with "supervised" or
    /// "valid"; time stamps stay only where both have them.
    ///
    /// # Errors
    /// If the two sequences are on different topologies, or have known forces of different kinds.
    pub fn append(&mut self, other: &Self) -> Result<()> {
        if let (Some(before), Some(this)) = (self.topology, other.topology) {
            before.must_match(this)?;
        }
        self.same_force_kind(other)?;
        self.topology = self.topology.or(other.topology);
        self.force_kind = self.force_kind.or(other.force_kind);
        let (before, added) = (self.n_frames(), other.n_frames());
        if added == 0 {
            return Ok(());
        }
        if before > 0 || !other.episode_ends.is_empty() {
            if before > 0 && self.episode_ends.is_empty() {
                self.episode_ends.push(before);
            }
            self.episode_ends.extend(other.episodes().iter().map(|episode| before + episode.end));
        }
        let stamped = (before == 0 || !self.timestamps.is_empty()) && !other.timestamps.is_empty();
        match stamped {
            true => self.timestamps.extend_from_slice(&other.timestamps),
            false => self.timestamps.clear(),
        }
        self.force.extend_from_slice(&other.force);
        self.contact.extend_from_slice(&other.contact);
        let (rows_before, rows_after) = (before * N_FIELD, (before + added) * N_FIELD);
        join(&mut self.mask_force, &other.mask_force, rows_before, rows_after, 1);
        join(&mut self.mask_contact, &other.mask_contact, rows_before, rows_after, 1);
        join(&mut self.validity, &other.validity, before, before + added, 0);
        join(&mut self.familiarity, &other.familiarity, before, before + added, f32::NAN);
        join(&mut self.presence, &other.presence, 2 * before, 2 * (before + added), f32::NAN);
        Ok(())
    }

    /// Checks that all arrays are of `T` frames and that the episode ends grow and end at `T`.
    ///
    /// # Errors
    /// If one does not; the error names the array.
    pub fn check(&self) -> Result<()> {
        let n_frames = self.n_frames();
        for (name, values) in [("force", &self.force), ("contact", &self.contact)] {
            check_rows(name, values.len(), n_frames)?;
        }
        for (name, mask) in [("mask_force", &self.mask_force), ("mask_contact", &self.mask_contact)] {
            if !mask.is_empty() {
                check_rows(name, mask.len(), n_frames)?;
            }
        }
        for (name, length) in [("timestamps", self.timestamps.len()), ("validity", self.validity.len())] {
            if length != 0 && length != n_frames {
                return Err(Error::shape(name, format!("({n_frames})"), [length]));
            }
        }
        for (name, values, width) in [("familiarity", &self.familiarity, 1), ("presence", &self.presence, 2)] {
            if !values.is_empty() && values.len() != width * n_frames {
                return Err(Error::shape(name, format!("({n_frames}, {width})"), [values.len()]));
            }
        }
        let ends = &self.episode_ends;
        let growing = ends.iter().zip(std::iter::once(&0).chain(ends)).all(|(end, before)| end > before);
        if !ends.is_empty() && (!growing || ends.last() != Some(&n_frames)) {
            let expected = format!("growing ends, the last one {n_frames}");
            return Err(Error::value("episode_ends", expected, format!("{ends:?}")));
        }
        Ok(())
    }
}

/// Checks that an array of `length` values has the shape (`n_frames`, 1556).
pub(crate) fn check_rows(name: &str, length: usize, n_frames: usize) -> Result<()> {
    match length == n_frames * N_FIELD {
        true => Ok(()),
        false => Err(Error::shape(name, format!("({n_frames}, {N_FIELD})"), [length / N_FIELD, length % N_FIELD])),
    }
}

/// Returns the frames of each episode, from exclusive cumulative ends.
pub fn episode_ranges(ends: &[usize]) -> impl Iterator<Item = Range<usize>> + Clone + '_ {
    std::iter::once(0).chain(ends.iter().copied()).zip(ends).map(|(start, end)| start..*end)
}

/// Returns frames per second by the median step of `timestamps`, s; None without at least two that grow.
pub fn fps(timestamps: &[f64]) -> Option<f64> {
    median_step(timestamps).map(|step| 1.0 / step)
}

/// Returns the median of the growing steps of `timestamps`, in their unit. Episodes may begin anew at zero, so steps back in
/// time are left out.
pub(crate) fn median_step(timestamps: &[f64]) -> Option<f64> {
    let mut steps: Vec<f64> = timestamps.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// Entries of some frames in an array of shape (T, 1556).
fn rows(frames: Range<usize>) -> Range<usize> {
    frames.start * N_FIELD..frames.end * N_FIELD
}

/// Returns the rows of `frames`, `width` values each; nothing of an array that is not given.
fn gather<T: Copy>(values: &[T], frames: &[usize], width: usize) -> Vec<T> {
    let mut gathered = Vec::new();
    if !values.is_empty() {
        gathered.reserve(frames.len() * width);
        frames.iter().for_each(|frame| gathered.extend_from_slice(&values[frame * width..(frame + 1) * width]));
    }
    gathered
}

/// Appends an optional array to another one; where only one of them is given, `default` stands for the other's entries.
fn join<T: Copy>(values: &mut Vec<T>, other: &[T], before: usize, after: usize, default: T) {
    if !values.is_empty() || !other.is_empty() {
        values.resize(before, default);
        values.extend_from_slice(other);
        values.resize(after, default);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A sequence of two episodes with all arrays, every entry another one.
    fn sequence() -> TactileSequence {
        let entries = 5 * N_FIELD;
        TactileSequence {
            topology: Some(Topology::EgotacHand1),
            force_kind: Some(ForceKind::Reading),
            timestamps: vec![0.0, 0.04, 0.08, 0.0, 0.05],
            episode_ends: vec![3, 5],
            force: (0..entries).map(|i| i as f32).collect(),
            contact: (0..entries).map(|i| i as f32 / entries as f32).collect(),
            mask_force: (0..entries).map(|i| u8::from(i % 3 > 0)).collect(),
            mask_contact: (0..entries).map(|i| u8::from(i % 5 > 0)).collect(),
            validity: vec![0, 7, 0, 0, 2],
            familiarity: vec![0.1, 0.2, 0.3, 0.4, 0.5],
            presence: (0..10).map(|i| i as f32 / 16.0).collect(),
        }
    }

    #[test]
    fn episodes_appended_one_by_one_give_the_whole() {
        let whole = sequence();
        let mut joined = TactileSequence::default();
        for episode in whole.episodes() {
            joined.append(&whole.select(episode)).unwrap();
        }
        assert_eq!(joined, whole);
        assert_eq!(whole.select(0..5), whole);
        assert_eq!(joined.check().map_err(|e| e.to_string()), Ok(()));
    }

    #[test]
    fn frames_pushed_one_by_one_give_the_whole() {
        let whole = sequence();
        let mut pushed = TactileSequence::default();
        for frame in 0..whole.n_frames() {
            pushed.push(&whole.field(frame).unwrap()).unwrap();
        }
        assert_eq!((&pushed.force, &pushed.contact, pushed.topology), (&whole.force, &whole.contact, whole.topology));
        let mut longer = whole.clone();
        longer.timestamps.push(0.1);
        longer.push(&whole.field(0).unwrap()).unwrap();
        longer.check().unwrap();
        assert_eq!(longer.episode_ends, [3, 6]);
        assert!(whole.field(5).unwrap_err().to_string().contains("below 5"));
    }

    #[test]
    fn episodes_lie_behind_each_other_and_cover_all_frames() {
        let mut sequence = sequence();
        assert_eq!(sequence.episodes(), [0..3, 3..5]);
        sequence.episode_ends.clear();
        assert_eq!(sequence.episodes(), std::iter::once(0..5).collect::<Vec<_>>());
        assert_eq!(episode_ranges(&[2, 2, 7]).map(|range| range.len()).sum::<usize>(), 7);
    }

    #[test]
    fn arrays_that_one_part_lacks_are_filled_and_stamps_are_dropped() {
        let (whole, bare) = (sequence(), TactileSequence::from_force(None, vec![1.0; 2 * N_FIELD]));
        let mut joined = bare.clone();
        joined.append(&whole).unwrap();
        joined.check().unwrap();
        assert_eq!((joined.episode_ends.as_slice(), joined.timestamps.len()), (&[2, 5, 7][..], 0));
        assert_eq!(joined.validity, [0, 0, 0, 7, 0, 0, 2]);
        assert!(joined.familiarity[..2].iter().chain(&joined.presence[..4]).all(|x| x.is_nan()));
        assert_eq!((&joined.familiarity[2..], &joined.presence[4..]), (&whole.familiarity[..], &whole.presence[..]));
        assert!(joined.mask_force[..2 * N_FIELD].iter().all(|mask| *mask == 1));
        assert_eq!(joined.mask_force[2 * N_FIELD..], whole.mask_force);
        let mut other = whole.clone();
        other.append(&bare).unwrap();
        other.check().unwrap();
        assert!(other.mask_contact[5 * N_FIELD..].iter().all(|mask| *mask == 1));
    }

    #[test]
    fn two_topologies_are_not_joined() {
        let mut whole = sequence();
        let mano = TactileSequence { topology: Some(Topology::Mano), ..sequence() };
        assert!(whole.append(&mano).is_err());
        assert!(whole.push(&TactileField::zeros(Topology::Mano)).is_err());
        assert_eq!(whole, sequence());
    }

    #[test]
    fn selected_frames_keep_the_borders_of_their_episodes() {
        let chosen = sequence().select([0, 2, 4]);
        assert_eq!(
            (chosen.episode_ends.as_slice(), chosen.timestamps.as_slice()),
            (&[2, 3][..], &[0.0, 0.08, 0.05][..])
        );
        assert_eq!(chosen.force_at(2), sequence().force_at(4));
        assert_eq!(sequence().select([]).episode_ends, [0; 0]);
    }

    #[test]
    fn frames_that_are_not_valid_do_not_count() {
        let whole = sequence();
        let mask = whole.counted_force();
        for frame in 0..5 {
            let of = |mask: &[u8]| mask[rows(frame..frame + 1)].to_vec();
            let expected = if whole.validity[frame] == 0 { of(&whole.mask_force) } else { vec![0; N_FIELD] };
            assert_eq!(of(&mask), expected, "frame {frame}");
        }
        let valid = TactileSequence { validity: Vec::new(), mask_contact: Vec::new(), ..whole };
        assert!(valid.counted_contact().is_empty());
    }

    #[test]
    fn errors_of_shape_name_the_array() {
        let refused = |spoil: fn(&mut TactileSequence), name: &str| {
            let mut sequence = sequence();
            spoil(&mut sequence);
            let error = sequence.check().unwrap_err().to_string();
            assert!(error.contains(name), "{name} is not in: {error}");
        };
        refused(|s| s.force.push(0.0), "force");
        refused(|s| s.contact.truncate(7), "contact");
        refused(|s| s.mask_force.truncate(N_FIELD), "mask_force");
        refused(|s| s.mask_contact.truncate(1), "mask_contact");
        refused(|s| s.timestamps.truncate(4), "timestamps");
        refused(|s| s.validity.push(0), "validity");
        refused(|s| s.familiarity.push(0.5), "familiarity");
        refused(|s| s.presence.truncate(5), "presence");
        for ends in [vec![3, 4], vec![0, 5], vec![4, 3, 5], vec![3, 3, 5]] {
            let error = TactileSequence { episode_ends: ends, ..sequence() }.check().unwrap_err().to_string();
            assert!(error.contains("episode_ends"), "{error}");
        }
        assert!(TactileSequence::default().check().is_ok());
    }
}
