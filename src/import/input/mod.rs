//! Contents of the files that data sets consist of, checked.

pub mod arrays;
pub mod csv;
pub mod folders;
pub mod hdf5;
pub mod hdf5_images;
pub mod images;
pub mod json;
pub mod lazy;
pub mod numbers;
pub mod shard;
pub mod tar;
