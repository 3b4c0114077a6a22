//! TODO metrics.
