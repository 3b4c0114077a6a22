//! Parts of the nodes that need no ROS.

mod mailbox_interleavings;
mod mailbox_threads;
