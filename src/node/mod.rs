//! TODO node.
