//! Images with their touch, shown on a local page (`egotac view`), in videos (`egotac label --video`), in Foxglove
//! (`egotac label --foxglove`) and in Rerun (`egotac label --rerun`).
//!
//! ```text
//! recording ──> Clip ──> Moment ─┬─> packet ──> Feed ──> server ──> page
//! camera, topic ─────────────────┘ ├──────────> picture ──> video
//!                                  ├──────────> scene (MCAP)
//!                                  └──────────> rerun
//! ```
//!
//! A [`Moment`] is all that is shown of one image. A [`Clip`] gives the moments of a recording in any order; a [`Feed`] encodes
//! the moments of one source for any number of pages. The page asks for each moment, so a slow page gets fewer of them and
//! nothing waits in the server.

mod about;
mod cache;
mod camera;
mod clip;
mod clock;
mod feed;
mod guard;
mod live;
mod markers;
mod moment;
mod packet;
mod page;
mod picture;
mod place;
mod projection;
mod publish;
#[cfg(feature = "rerun")]
mod rerun;
mod scene;
mod server;
mod store_poses;
mod trace;
mod video;

#[cfg(feature = "rerun")]
pub use self::rerun::{send_rerun, write_rerun};
pub use about::{About, Kind};
pub use camera::{is_camera, run as run_camera};
pub use clip::{Clip, ClipOptions, Player, open_clips};
pub use feed::Feed;
pub use live::{LiveFeed, LiveInput};
#[cfg(feature = "ros")]
pub(crate) use markers::{removed, surface};
pub use moment::Moment;
pub use picture::Picture;
pub use scene::{SCENE_EXTENSION, write_scene};
pub use server::{Server, Settings};
pub use video::write_video;
