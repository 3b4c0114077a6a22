//! Simulated scenes: hands, driven by contact goals, touch objects before a head-mounted camera.
//!
//! ```text
//! scene (YAML) --seed--> randomize::Episode --> mjcf --> mujoco::World
//!                              |                             |
//!                              +--> driver (ik, timeline) ---+--> rollout: picture, poses, label::force, guard
//! ```
//!
//! World frame: origin on the table's top, z up, the person at negative y looking along +y; metres, seconds, newtons.

pub mod appearance;
#[doc(hidden)]
pub mod budget;
pub mod camera;
pub mod contact;
pub mod convex;
pub mod driver;
pub mod effect;
pub mod explain;
pub mod guard;
pub mod ik;
pub mod lens;
pub mod mjcf;
pub mod object;
pub mod observe;
pub mod randomize;
pub mod range;
pub mod record;
pub mod rig;
pub mod rollout;
pub mod scene;
pub mod scene_object;
pub mod timeline;
pub mod touchable;
pub mod verify;
pub mod view;
pub mod worker_process;

pub use effect::{Effect, EffectPlan, EffectSet};
pub use observe::{ObjectPose, SimFrame};
pub use record::{Generate, Progress, Summary, generate, record};
pub use rollout::{Rollout, RolloutOptions};
pub use scene::{SHIPPED, Scene};
pub use touchable::{Distances, Touchables};
pub use worker_process::{Workers, generate_isolated};
