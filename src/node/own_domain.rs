//! ROS domains for measurements and tests, which must not hear each other.

use std::fs::{File, OpenOptions};
use std::path::Path;

/// Domains to choose from: the ports of domains 1 to 101 lie below the system's ephemeral ports.
const DOMAINS: u32 = 101;

/// A ROS domain that nothing else that asks for one has on this machine, as long as this value lives.
#[derive(Debug)]
pub struct OwnDomain {
    id: u32,
    /// Locked; None if all domains were taken.
    _lock: Option<File>,
}

impl OwnDomain {
    /// Takes a domain. If all are taken, one is shared.
    pub fn take() -> Self {
        Self::take_in(&std::env::temp_dir())
    }

    /// As [`Self::take`], with the locks of `folder`.
    fn take_in(folder: &Path) -> Self {
        // Each process begins elsewhere: nodes of other programs, which take no lock, are mostly in low domains.
        let first = std::process::id().wrapping_mul(7) % DOMAINS;
        let of = |i: u32| (first + i) % DOMAINS + 1;
        let free = (0..DOMAINS).map(of).find_map(|id| lock(folder, id).map(|file| (id, file)));
        let (id, lock) = free.map_or((of(0), None), |(id, file)| (id, Some(file)));
        Self { id, _lock: lock }
    }

    /// Number of the domain, for `ROS_DOMAIN_ID`.
    pub fn id(&self) -> u32 {
        self.id
    }
}

/// Locks the file of a domain; None if it is locked, or belongs to another user.
fn lock(folder: &Path, id: u32) -> Option<File> {
    let path = folder.join(format!("egotac-ros-domain-{id}.lock"));
    let file = OpenOptions::new().create(true).truncate(false).write(true).open(path).ok()?;
    file.try_lock().ok()?;
    Some(file)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn domains_differ_as_long_as_they_are_kept_and_are_free_again() {
        let folder = tempfile::tempdir().unwrap();
        let mut kept: Vec<OwnDomain> = (0..DOMAINS).map(|_| OwnDomain::take_in(folder.path())).collect();
        let ids: BTreeSet<u32> = kept.iter().map(OwnDomain::id).collect();
        assert_eq!(ids, (1..=DOMAINS).collect());
        // When all are taken, one is shared.
        assert!(ids.contains(&OwnDomain::take_in(folder.path()).id()));
        let freed = kept.remove(40).id();
        assert_eq!(OwnDomain::take_in(folder.path()).id(), freed);
    }
}
