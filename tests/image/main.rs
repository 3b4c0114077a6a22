//! Decoding and preparation of images.

mod prepare;
mod raw;
