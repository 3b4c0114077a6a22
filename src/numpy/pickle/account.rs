//! Account of the memory that a pickle makes its reader use.

use super::Outcome;

/// Memory that every pickle may use, bytes. A MANO file needs 1 MB beside its arrays, the dictionary of a large network 10 MB.
const BASE: u64 = 64 << 20;
/// Further memory per byte of the file: strings are copied once, and a character of one byte may become two.
const PER_BYTE: u64 = 2;

/// Sum of all allocations. Nothing is ever refunded, so that the account bounds the number of steps too.
#[derive(Debug)]
pub(super) struct Account {
    left: u64,
    most: u64,
}

impl Account {
    /// Opens the account of a pickle of `length` bytes.
    pub fn new(length: usize) -> Self {
        let most = (length as u64).saturating_mul(PER_BYTE).saturating_add(BASE);
        Self { left: most, most }
    }

    /// Pays for `bytes`, before they are allocated.
    pub fn charge(&mut self, bytes: usize) -> Outcome<()> {
        match self.left.checked_sub(bytes as u64) {
            Some(left) => {
                self.left = left;
                Ok(())
            }
            None => Err(format!("the pickle needs more than {} bytes of memory", self.most)),
        }
    }
}
