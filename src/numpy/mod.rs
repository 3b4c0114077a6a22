//! Readers of numpy's files: pickles and `.npz` archives.

mod array;
mod npz;
mod pickle;

pub(crate) use array::{Array, Outcome, check_rank};
pub(crate) use npz::Npz;
pub(crate) use pickle::{Id, Names, Pickle, Value, expand_indptr, triplets};
