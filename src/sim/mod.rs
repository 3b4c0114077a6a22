//! Simulated scenes: hands with contact goals touch objects in front of a head-mounted camera.
//!
//! ```text
//! Scene (YAML) --seed--> EpisodeDraw --> mjcf --> World
//!                             |                     |
//!                             +--> HandDriver ------+--> Rollout --> SimFrame
//!                                  (ik, timeline)        picture, touch, poses, validity
//! ```
//!
//! The world frame has its origin on the table's top and z up; the person sits at negative y and looks along +y. Units
//! are metres, seconds, newtons and radians.

pub(crate) mod appearance;
#[doc(hidden)]
pub mod budget;
pub mod camera;
#[doc(hidden)]
pub mod contact;
pub(crate) mod convex;
pub(crate) mod driver;
pub(crate) mod effect;
pub(crate) mod environment;
#[doc(hidden)]
pub mod explain;
pub(crate) mod frame;
pub(crate) mod generate;
#[doc(hidden)]
pub mod guard;
pub(crate) mod ik;
pub(crate) mod image_sensor;
#[doc(hidden)]
pub mod lens;
#[doc(hidden)]
pub mod mjcf;
#[doc(hidden)]
pub mod object;
pub(crate) mod parts;
pub(crate) mod photo;
#[doc(hidden)]
pub mod physical;
#[doc(hidden)]
pub mod randomize;
pub(crate) mod range;
pub(crate) mod record;
#[doc(hidden)]
pub mod rig;
pub(crate) mod rollout;
pub mod scene;
#[doc(hidden)]
pub mod scene_object;
pub(crate) mod stored_scene;
pub(crate) mod timeline;
pub(crate) mod touchable;
#[doc(hidden)]
pub mod verify;
pub(crate) mod worker_process;

pub use effect::{Effect, EffectSet, EffectsSpec, Observation};
pub use environment::Environment;
pub use frame::{ObjectPose, SimFrame};
pub use generate::{DatasetPlan, GenerateProgress, generate};
pub use object::mesh_faults;
#[doc(hidden)]
pub use object::try_mesh;
pub use photo::{Backgrounds, PropMeshes};
pub use range::UniformRange;
pub use record::{RecordSummary, record};
pub use rollout::{Rollout, RolloutOptions};
pub use scene::{EffectPlan, SHIPPED, Scene};
pub use timeline::ChannelValues;
pub use touchable::{Distances, Touchables};
pub use worker_process::{WorkerCommand, generate_in_processes};
