//! Arrays as numpy writes them: pickles and `.npz` archives.

pub(crate) mod array;
pub(crate) mod npz;
pub(crate) mod pickle;
