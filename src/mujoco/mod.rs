//! MuJoCo behind a safe surface: checked options, a world that owns model and data, a headless renderer.
//!
//! The engine ends the process on some invalid options; nothing reaches it here that [`options`] has not checked.

pub mod audit;
mod contact;
pub mod facts;
mod fatal;
pub mod flex;
mod inspect;
mod names;
pub mod object;
pub mod options;
pub mod parts;
mod pose;
pub mod preset;
pub mod renderer;
pub mod view;
pub mod world;

pub use audit::{Expectation, Finding, Rule, Severity, audit};
pub use contact::Contact;
pub use facts::Facts;
pub use flex::Flex;
pub use inspect::Grip;
pub use options::{Cone, Integrator, PhysicsOptions, Solver};
pub use preset::Preset;
pub use renderer::Renderer;
pub use view::View;
pub use world::World;

/// Version of the engine this program runs with.
pub fn version() -> &'static str {
    mujoco_rs::mujoco_version()
}
