//! Forces from motion.

mod balance;
mod motion;
mod optimum;
