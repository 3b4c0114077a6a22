//! Recordings of others become stores: readers of data sets fill one [`Recording`], from which labels are made.
//!
//! ```text
//! files of a data set ──> Reader ──> Recording, Moment ──> labels from geometry ──> journal ──> store
//! ```
//!
//! A reader (in `readers`, one per [`Kind`]) gives the images of a recording and, for each, a [`recording::Moment`]: hands,
//! objects and camera in one frame. [`labeller`] poses the hands and finds the vertices near an object; a job of
//! [`crate::label`] keeps the labels in a journal, resumes and divides work among shards; [`output`] writes the store. Unknown
//! values are NaN with mask 0.

mod forces;
pub mod glove;
pub mod hands;
mod input;
pub mod kind;
pub mod kinds;
mod known;
pub mod labeller;
pub mod output;
mod readers;
pub mod recording;
pub mod sensors;
pub mod shapes;
mod source;
mod tasks;
mod umetrack;

pub use hands::HandModels;
pub use kind::{Kind, Mano, Options};
pub use kinds::{kind, table};
pub use labeller::ContactRule;
pub use recording::{Moment, Reader, RecordedHand, Recording};
pub use tasks::{ImportTasks, Settings};
