//! Benchmarks, hard cases and experiments: the library behind the program `egotac-bench`, which `egotac bench` and
//! `egotac experiment` run.
//!
//! | module | measures |
//! |---|---|
//! | [`model`], [`train`] | time and memory of the network and of a training step, beside PyTorch and OpenVINO |
//! | [`gpu`] | time of both on a GPU, beside PyTorch |
//! | [`layers`] | time of each step of the encoder, beside the processor's peak |
//! | [`ranks`] | training on several processes |
//! | [`label`] | time that `egotac label` spends outside the network |
//! | [`import`] | speed of imports: contact by distance, readers of data sets |
//! | `glove` | force on vertices from simulated taxels, beside the simulator's own |
//! | `sim`, `effects`, `guards` | accuracy, effects and guards of the simulation against their cost |
//! | `physics` | forces from motion against the simulator's contacts |
//! | `retarget` | accuracy and time of retargeting, beside other programs |
//! | [`hard_cases`] | inputs that go wrong, the guards that report them, and their remedies |
//! | [`faults`] | kills, errors of the disk and changing inputs while commands write their outputs |
//! | `node` | the ROS 2 nodes under load and faults |
//! | `experiment` | the paper's claims: trainings and measurements, compared |
//! | `policy` | a policy in simulation with and without touch |
//! | `draw` | nothing: plots again from the files of measurements |

pub mod cli;
#[cfg(feature = "sim")]
pub mod draw;
#[cfg(feature = "sim")]
pub mod effects;
#[cfg(feature = "sim")]
pub mod experiment;
pub mod faults;
mod front;
#[cfg(feature = "sim")]
pub mod glove;
pub mod gpu;
#[cfg(feature = "sim")]
pub mod guards;
pub mod hard_cases;
pub mod import;
pub mod label;
pub mod layers;
pub mod model;
pub mod names;
#[cfg(all(feature = "ros", feature = "sim"))]
pub mod node;
pub mod peer;
#[cfg(feature = "sim")]
pub mod physics;
#[cfg(feature = "sim")]
pub mod policy;
pub mod ranks;
#[cfg(feature = "sim")]
pub mod retarget;
#[cfg(feature = "sim")]
pub mod sim;
pub mod train;
#[cfg(feature = "sim")]
#[allow(dead_code)]
#[path = "../../../tests/import/writers/mod.rs"]
mod writers;
