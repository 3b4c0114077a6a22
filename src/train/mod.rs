//! TODO train.
