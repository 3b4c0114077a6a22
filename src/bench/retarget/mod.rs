//! What retargeting costs and how exact it is: time, objective, limits, touch, jitter, beside other programs.

pub mod follow;
pub mod trajectory;
