//! Benchmarks, hard cases and experiments at their smallest size: one program, so that a long test runs beside short ones.

mod draw;
mod experiment;
mod faults;
mod hard_cases;
mod model;
mod policy;
mod read_errors;
mod recordings;
mod retarget;
mod sim;
