//! Pictures of hands and fields, drawn on the CPU.

pub mod raster;
