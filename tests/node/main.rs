//! Parts of the nodes that need no ROS.
#![allow(clippy::duplicate_mod)] // the mailbox is compiled with loom's locks, and with the system's

mod mailbox_interleavings;
mod mailbox_threads;
