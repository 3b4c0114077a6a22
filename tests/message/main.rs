//! ROS messages and their bytes.

mod golden;
mod robust;
