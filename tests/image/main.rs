//! Decoding and preparation of images.

mod opencv;
mod prepare;
mod raw;
