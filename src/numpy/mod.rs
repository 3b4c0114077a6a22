//! Readers of numpy's files, pickles, `.npz` and `.npy`, and of PyTorch's tensors in pickles.

mod array;
mod npz;
mod pickle;
mod tensor;

pub(crate) use array::{Array, Outcome, check_rank};
pub(crate) use npz::{Npz, first_text, npy_pickle, read_npy};
pub(crate) use pickle::{Id, Names, Pickle, Value, expand_indptr, triplets};
pub(crate) use tensor::{StorageReference, View, array_or_tensor, rebuilt};
