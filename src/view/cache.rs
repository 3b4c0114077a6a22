//! Packets that were made before, within a limit of memory.

use std::collections::{HashMap, VecDeque};
use std::sync::Arc;

/// Packets by frame; the oldest ones leave when their bytes exceed the limit.
#[derive(Debug)]
pub(super) struct Cache {
    packets: HashMap<usize, Arc<[u8]>>,
    order: VecDeque<usize>,
    bytes: usize,
    limit: usize,
}

impl Cache {
    /// Creates an empty cache of at most `limit` bytes.
    pub(super) fn new(limit: usize) -> Self {
        Self { packets: HashMap::new(), order: VecDeque::new(), bytes: 0, limit }
    }

    /// Returns the packet of a frame.
    pub(super) fn get(&self, frame: usize) -> Option<Arc<[u8]>> {
        self.packets.get(&frame).cloned()
    }

    /// Keeps the packet of a frame that is not in the cache.
    pub(super) fn put(&mut self, frame: usize, packet: Arc<[u8]>) {
        self.bytes += packet.len();
        self.packets.insert(frame, packet);
        self.order.push_back(frame);
        while self.bytes > self.limit {
            let Some(oldest) = self.order.pop_front() else { return };
            self.bytes -= self.packets.remove(&oldest).map_or(0, |packet| packet.len());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_packets_leave_at_the_limit() {
        let mut cache = Cache::new(100);
        for frame in 0..10 {
            cache.put(frame, vec![0; 30].into());
            assert!(cache.packets.values().map(|packet| packet.len()).sum::<usize>() <= 100);
        }
        assert_eq!((6..10).map(|frame| cache.get(frame).is_some()).collect::<Vec<_>>(), [false, true, true, true]);
    }
}
