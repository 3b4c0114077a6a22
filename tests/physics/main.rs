//! Forces from motion.

mod balance;
mod motion;
mod optimum;
#[cfg(feature = "sim")]
mod store;
