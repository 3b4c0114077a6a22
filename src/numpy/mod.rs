//! Readers of numpy's files: pickles and `.npz` archives.

mod array;
mod npz;
mod pickle;

pub(crate) use array::{Array, Outcome};
pub(crate) use npz::Npz;
pub(crate) use pickle::{Pickle, expand_indptr, triplets};
