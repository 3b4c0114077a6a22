//! Ranks that are threads of one process, for tests of what ranks compute.

use std::fmt::Display;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use super::Communicator;
use crate::error::{Error, Result};

/// A rank of a process; the other ranks' calls fail once it is dropped.
pub struct Thread {
    rank: usize,
    shared: Arc<Shared>,
}

struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

/// One exchange after the other. A rank begins the next one only when it has taken the result of the last, so one result is enough.
struct State {
    parts: Vec<Option<Values>>,
    result: Arc<Vec<Values>>,
    exchanges: usize,
    /// The first rank that has failed or ended, and why.
    lost: Option<(usize, String)>,
}

/// Contribution of a rank to an exchange.
#[derive(Debug, Clone, PartialEq)]
enum Values {
    F32(Vec<f32>),
    F64(Vec<f64>),
}

/// Creates the ranks of a group of `size`.
pub fn group(size: usize) -> Vec<Thread> {
    let state = State { parts: vec![None; size], result: Arc::default(), exchanges: 0, lost: None };
    let shared = Arc::new(Shared { state: Mutex::new(state), changed: Condvar::new() });
    (0..size).map(|rank| Thread { rank, shared: shared.clone() }).collect()
}

impl Thread {
    fn state(&self) -> MutexGuard<'_, State> {
        self.shared.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Gives the values of this rank and returns those of all, by rank.
    fn exchange(&self, values: Values) -> Result<Arc<Vec<Values>>> {
        let mut state = self.state();
        state.parts[self.rank] = Some(values);
        let exchange = state.exchanges;
        if state.parts.iter().all(Option::is_some) {
            state.result = Arc::new(state.parts.iter_mut().filter_map(Option::take).collect());
            state.exchanges += 1;
            self.shared.changed.notify_all();
        }
        while state.exchanges == exchange {
            if let Some((rank, why)) = &state.lost {
                return Err(Error::value(format!("rank {rank}"), "one that trains on", why));
            }
            state = self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
        Ok(state.result.clone())
    }

    fn lose(&self, why: String) {
        self.state().lost.get_or_insert((self.rank, why));
        self.shared.changed.notify_all();
    }
}

impl Communicator for Thread {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.state().parts.len()
    }

    fn sum_f32(&self, values: &mut [f32]) -> Result<()> {
        let all = self.exchange(Values::F32(values.to_vec()))?;
        let parts: Vec<&[f32]> =
            all.iter().filter_map(|part| if let Values::F32(part) = part { Some(&part[..]) } else { None }).collect();
        check(&parts, values.len(), all.len())?;
        for (i, value) in values.iter_mut().enumerate() {
            *value = parts.iter().map(|part| part[i]).sum();
        }
        Ok(())
    }

    fn sum_f64(&self, values: &mut [f64]) -> Result<()> {
        let all = self.exchange(Values::F64(values.to_vec()))?;
        let parts: Vec<&[f64]> =
            all.iter().filter_map(|part| if let Values::F64(part) = part { Some(&part[..]) } else { None }).collect();
        check(&parts, values.len(), all.len())?;
        for (i, value) in values.iter_mut().enumerate() {
            *value = parts.iter().map(|part| part[i]).sum();
        }
        Ok(())
    }

    fn broadcast(&self, values: &mut [f32]) -> Result<()> {
        let all = self.exchange(Values::F32(values.to_vec()))?;
        match all.first() {
            Some(Values::F32(first)) if first.len() == values.len() => values.copy_from_slice(first),
            _ => return Err(Error::value("broadcast", "the same call on all ranks", "another one on rank 0")),
        }
        Ok(())
    }

    fn barrier(&self) -> Result<()> {
        self.exchange(Values::F64(Vec::new())).map(drop)
    }

    fn abort(&self, error: &dyn Display) {
        self.lose(error.to_string());
    }
}

impl Drop for Thread {
    fn drop(&mut self) {
        self.lose("its end".into());
    }
}

/// Checks that all ranks have given equally many values of the same kind.
fn check<T>(parts: &[&[T]], values: usize, ranks: usize) -> Result<()> {
    match parts.len() == ranks && parts.iter().all(|part| part.len() == values) {
        true => Ok(()),
        false => Err(Error::value("sum over ranks", "as many values of the same kind on each rank", "other ones")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs `work` on each rank of a group and returns the results by rank.
    fn on<T: Send>(size: usize, work: impl Fn(&Thread) -> T + Sync) -> Vec<T> {
        std::thread::scope(|scope| {
            let work = &work;
            let started: Vec<_> = group(size).into_iter().map(|rank| scope.spawn(move || work(&rank))).collect();
            started.into_iter().map(|thread| thread.join().unwrap()).collect()
        })
    }

    #[test]
    fn every_rank_gets_the_sum_and_the_values_of_rank_0() {
        let results = on(5, |ranks| {
            let mut outcome = Vec::new();
            // Many exchanges, so that a fast rank overtakes a slow one wherever it may.
            for round in 0..200 {
                let mut values = [ranks.rank() as f32, round as f32];
                ranks.sum_f32(&mut values).unwrap();
                let mut wide = [1e9 + ranks.rank() as f64];
                ranks.sum_f64(&mut wide).unwrap();
                let mut first = [10.0 * ranks.rank() as f32 + round as f32];
                ranks.broadcast(&mut first).unwrap();
                ranks.barrier().unwrap();
                outcome.push((values, wide, first));
            }
            outcome
        });
        for outcome in results {
            for (round, (values, wide, first)) in outcome.into_iter().enumerate() {
                assert_eq!((values, wide), ([10.0, 5.0 * round as f32], [5e9 + 10.0]));
                assert_eq!(first, [round as f32]);
            }
        }
    }

    #[test]
    fn the_others_fail_when_a_rank_aborts_or_ends() {
        for (aborts, why) in [(true, "no such store"), (false, "its end")] {
            let told = on(3, |ranks| {
                if ranks.rank() == 1 {
                    ranks.sum_f32(&mut [1.0]).unwrap();
                    if aborts {
                        ranks.abort(&"no such store");
                    }
                    return String::new();
                }
                ranks.sum_f32(&mut [1.0]).unwrap();
                ranks.barrier().unwrap_err().to_string()
            });
            assert!([0, 2].iter().all(|rank| told[*rank].contains("rank 1") && told[*rank].contains(why)), "{told:?}");
        }
    }

    #[test]
    fn sums_of_different_lengths_are_refused() {
        let refused = on(2, |ranks| ranks.sum_f32(&mut vec![0.0; 1 + ranks.rank()]).is_err());
        assert_eq!(refused, [true, true]);
    }
}
