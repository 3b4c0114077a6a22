//! Latency and memory of the network by geometry, precision and threads, beside accuracy.

pub mod estimates;
pub mod growth;
mod image;
pub mod measure;
pub mod pareto;
pub mod peer;
pub mod sweep;
pub mod table;

pub use measure::{Accuracy, Row, Setup, Spread};
pub use sweep::{ModelReport, Plan};
