//! OXT-style Zarr v2 stores.
