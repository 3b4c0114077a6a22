//! Sampling of training windows: clips of consecutive windows, in shuffled epochs.

use std::ops::Range;

use rand::Rng;
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::model::window;

/// Consecutive windows of one episode; their newest frames are one observation step apart, so that they share most frames.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Clip {
    /// Index of the store.
    pub store: usize,
    /// Frames of the episode within the store.
    pub episode: Range<usize>,
    /// Newest frame of each window.
    pub newest: Vec<usize>,
}

/// Part of every batch that one rank takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    /// Number of the rank, from 0.
    pub rank: usize,
    /// Number of ranks.
    pub ranks: usize,
}

impl Share {
    /// All clips of every batch.
    pub const WHOLE: Self = Self { rank: 0, ranks: 1 };

    /// Returns the clips of a batch that the rank takes, each with its place in the batch. Ranks take turns, so that their numbers of
    /// clips differ by one at most; in a small batch some ranks take none.
    pub fn of<'a>(&self, batch: &'a [Clip]) -> impl Iterator<Item = (usize, &'a Clip)> + use<'a> {
        batch.iter().enumerate().skip(self.rank).step_by(self.ranks.max(1))
    }
}

/// Returns the frames of the window whose newest frame is `newest`, oldest first; see [`model::window`](crate::model::window).
///
/// `timestamps`: seconds of every frame of the store, increasing within the episode that starts at `start`.
pub fn window(timestamps: &[f64], start: usize, newest: usize, horizon: usize, frame_dt: f64) -> Vec<usize> {
    let places = window::window(&timestamps[start..=newest], horizon, frame_dt);
    places.into_iter().map(|place| start + place).collect()
}

/// Returns the frames of steps k = 0 .. `predict` - 1 of a prediction at frame `newest`; `None` beyond the episode, which
/// ends at `end`. See [`model::window`](crate::model::window).
pub fn targets(timestamps: &[f64], end: usize, newest: usize, predict: usize, frame_dt: f64) -> Vec<Option<usize>> {
    let places = window::targets(&timestamps[newest..end], predict, frame_dt);
    places.into_iter().map(|place| place.map(|place| newest + place)).collect()
}

/// Returns the frames between observation steps: `frame_dt` in units of the episode's mean frame interval, at least 1.
pub fn stride(timestamps: &[f64], episode: &Range<usize>, frame_dt: f64) -> usize {
    let frames = episode.len();
    if frames < 2 {
        return 1;
    }
    let mean_dt = (timestamps[episode.end - 1] - timestamps[episode.start]) / (frames - 1) as f64;
    if mean_dt > 0.0 { (frame_dt / mean_dt).round().max(1.0) as usize } else { 1 }
}

/// Cuts one episode into clips of at most `windows` windows, at random places. Every frame is the newest of exactly one
/// window.
fn cut(
    store: usize,
    episode: &Range<usize>,
    stride: usize,
    windows: usize,
    rng: &mut ChaCha8Rng,
    clips: &mut Vec<Clip>,
) {
    for phase in 0..stride.min(episode.len()) {
        let newest: Vec<usize> = (episode.start + phase..episode.end).step_by(stride).collect();
        let first = rng.random_range(0..windows).min(newest.len());
        let (head, tail) = newest.split_at(first);
        let pieces = std::iter::once(head).filter(|head| !head.is_empty()).chain(tail.chunks(windows));
        clips.extend(pieces.map(|newest| Clip { store, episode: episode.clone(), newest: newest.to_vec() }));
    }
}

/// Episodes of one source, and the number of windows that an epoch draws from them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Pool {
    /// Store, frames and stride of each episode.
    pub episodes: Vec<(usize, Range<usize>, usize)>,
    /// Windows per epoch. Fewer than the frames leaves some out; more repeats some.
    pub count: usize,
}

impl Pool {
    /// Creates a pool that draws every frame once per epoch.
    pub fn whole(episodes: Vec<(usize, Range<usize>, usize)>) -> Self {
        let count = episodes.iter().map(|(_, frames, _)| frames.len()).sum();
        Self { episodes, count }
    }

    /// Draws the clips of one epoch, in random order.
    fn draw(&self, windows: usize, rng: &mut ChaCha8Rng) -> Vec<Clip> {
        let (mut drawn, mut left) = (Vec::new(), self.count);
        while left > 0 {
            let mut clips = Vec::new();
            for (store, episode, stride) in &self.episodes {
                cut(*store, episode, *stride, windows, rng, &mut clips);
            }
            clips.shuffle(rng);
            if clips.is_empty() {
                break;
            }
            for mut clip in clips {
                clip.newest.truncate(left);
                left -= clip.newest.len();
                drawn.push(clip);
                if left == 0 {
                    break;
                }
            }
        }
        drawn
    }
}

/// Endless sequence of batches of clips. It depends only on the seed: a run resumes by skipping `n` batches.
#[derive(Debug, Clone)]
pub struct Sampler {
    pools: Vec<Pool>,
    windows: usize,
    clips_per_batch: usize,
    seed: u64,
    epoch: u64,
    left: Vec<Clip>,
}

impl Sampler {
    /// Creates a sampler of the pools of all sources.
    pub fn new(pools: Vec<Pool>, windows: usize, clips_per_batch: usize, seed: u64) -> Self {
        Self { pools, windows, clips_per_batch, seed, epoch: 0, left: Vec::new() }
    }

    /// Returns the number of epochs begun.
    pub fn epoch(&self) -> u64 {
        self.epoch
    }

    fn begin_epoch(&mut self) {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(self.epoch);
        let mut clips: Vec<Clip> = self.pools.iter().flat_map(|pool| pool.draw(self.windows, &mut rng)).collect();
        if self.pools.len() > 1 {
            clips.shuffle(&mut rng);
        }
        self.left = clips;
        self.epoch += 1;
    }
}

impl Iterator for Sampler {
    type Item = Vec<Clip>;

    /// Never ends, unless there is no episode. The last batch of an epoch may be smaller.
    fn next(&mut self) -> Option<Vec<Clip>> {
        if self.left.is_empty() {
            self.begin_epoch();
        }
        let rest = self.left.len().saturating_sub(self.clips_per_batch);
        let batch = self.left.split_off(rest);
        (!batch.is_empty()).then_some(batch)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn windows_and_targets_stay_inside_the_episode() {
        let times: Vec<f64> = (0..20).map(|i| 3.0 + 0.04 * f64::from(i)).collect();
        assert_eq!(window(&times, 0, 10, 3, 0.12), [4, 7, 10]);
        assert_eq!(window(&times, 8, 10, 3, 0.12), [8, 8, 10], "the episode starts at 8");
        assert_eq!(window(&times, 0, 10, 2, 0.1), [7, 10], "0.1 s before lies between 7 (0.12) and 8 (0.08)");
        assert_eq!(targets(&times, 20, 10, 3, 0.12), [Some(10), Some(13), Some(16)]);
        assert_eq!(targets(&times, 14, 10, 3, 0.12), [Some(10), Some(13), None], "the episode ends at 14");
    }

    #[test]
    fn every_frame_is_the_newest_of_one_window_per_epoch() {
        let mut sampler = Sampler::new(vec![Pool::whole(vec![(0, 0..50, 3), (1, 5..7, 3), (1, 7..30, 1)])], 4, 5, 9);
        let mut seen = Vec::new();
        while sampler.epoch() < 2 {
            let batch = sampler.next().unwrap();
            if sampler.epoch() == 2 {
                break;
            }
            assert!(batch.len() <= 5 && batch.iter().all(|clip| (1..=4).contains(&clip.newest.len())));
            seen.extend(batch.iter().flat_map(|clip| clip.newest.iter().map(|f| (clip.store, *f))));
        }
        seen.sort_unstable();
        let expected: Vec<(usize, usize)> = (0..50).map(|f| (0, f)).chain((5..30).map(|f| (1, f))).collect();
        assert_eq!(seen, expected);
    }

    #[test]
    fn an_epoch_draws_exactly_the_count_of_each_pool() {
        let pool = |store, frames: usize, count| Pool { episodes: vec![(store, 0..frames, 2)], count };
        let mut sampler = Sampler::new(vec![pool(0, 100, 37), pool(1, 20, 53), pool(2, 9, 0)], 4, 5, 3);
        for epoch in 1..=3 {
            let mut taken = [Vec::new(), Vec::new(), Vec::new()];
            while taken.iter().map(Vec::len).sum::<usize>() < 90 {
                for clip in sampler.next().unwrap() {
                    taken[clip.store].extend(clip.newest);
                }
            }
            assert_eq!((sampler.epoch(), taken.each_ref().map(Vec::len)), (epoch, [37, 53, 0]));
            // The large pool repeats no frame; the small one repeats each frame once, and 13 of them twice.
            let times = |store: usize, frame: usize| taken[store].iter().filter(|f| **f == frame).count();
            assert!((0..100).all(|frame| times(0, frame) <= 1));
            assert!((0..20).all(|frame| (2..=3).contains(&times(1, frame))));
        }
    }

    #[test]
    fn batches_depend_only_on_the_seed() {
        let make = |seed| Sampler::new(vec![Pool::whole(vec![(0, 0..200, 2)])], 4, 5, seed);
        let batches: Vec<_> = make(1).take(40).collect();
        assert_eq!(batches[17..], make(1).skip(17).take(23).collect::<Vec<_>>());
        assert_ne!(batches, make(2).take(40).collect::<Vec<_>>());
    }
}
