//! Readers of data sets, one file per kind.

pub mod arctic;
pub mod contactpose;
pub mod dexycb;
pub mod egodex;
pub mod egopressure;
pub mod egotac_sc;
pub mod egotac_sc_raw;
pub mod epic_contact;
pub mod fpha;
pub mod grab;
pub mod h2o;
pub mod hoi4d;
pub mod hot3d;
pub mod oakink2;
pub mod opentouch;
pub mod taco;
pub mod touchanything;
pub mod videos;
