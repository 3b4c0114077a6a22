//! Safe wrapper of the MuJoCo physics engine: checked options, a world that owns model and data, an offscreen renderer.
//!
//! The engine ends the process on some invalid inputs. Everything that reaches it passes the checks of [`options`] and
//! of [`World::from_mjcf`] first.

pub mod audit;
mod camera;
mod fatal;
mod named_files;
pub mod object;
pub mod options;
pub mod parts;
mod renderer;
pub mod world;

pub use audit::{Expectation, Finding, Rule, Severity, audit};
pub use camera::FreeCamera;
pub use options::{Cone, Integrator, PhysicsOptions, Preset, Solver};
pub use renderer::Renderer;
pub use world::{Contact, Facts, Flex, Grip, World};

/// Returns the version of the engine library in use.
pub fn version() -> &'static str {
    mujoco_rs::mujoco_version()
}
