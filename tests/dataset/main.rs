//! Formats of recordings.

mod mcap_bag;
mod zarr;
#[cfg(feature = "sim")]
mod zarr_python;
