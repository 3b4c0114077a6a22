//! TODO mujoco.
