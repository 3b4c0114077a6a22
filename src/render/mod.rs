//! TODO render.
