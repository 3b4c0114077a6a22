//! Forces from motion.

mod balance;
mod joined;
mod motion;
mod optimum;
#[cfg(feature = "sim")]
mod store;
