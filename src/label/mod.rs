//! TODO label.
