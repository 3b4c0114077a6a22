//! Table of the kinds of data sets that can be imported.

use std::fmt::Write;

use super::kind::{Kind, Mano};
use super::readers;
use crate::error::{Error, Result};

/// All kinds, in the order of the table.
pub static ALL: [Kind; 20] = [
    readers::hot3d::KIND,
    readers::h2o::KIND,
    readers::taco::KIND,
    readers::fpha::KIND,
    readers::egopressure::KIND,
    readers::arctic::KIND,
    readers::hoi4d::KIND,
    readers::oakink2::KIND,
    readers::opentouch::KIND,
    readers::touchanything::KIND,
    readers::egodex::KIND,
    readers::dexycb::KIND,
    readers::grab::KIND,
    readers::contactpose::KIND,
    readers::epic_contact::KIND,
    readers::videos::EPIC,
    readers::videos::EGO4D,
    readers::videos::EGOPAT3D,
    readers::egotac_sc::KIND,
    readers::egotac_sc_raw::KIND,
];

/// Data sets that can't be imported, and the reasons.
const NOT_READ: [(&str, &str); 1] = [(
    "svo2, vrs",
    "recordings of ZED and Aria cameras: extract images with their makers' tools first (docs/import.md).",
)];

/// Returns the kind of a name.
///
/// # Errors
/// If there is none; the error lists the names.
pub fn kind(name: &str) -> Result<&'static Kind> {
    let known = || ALL.iter().map(|kind| kind.name);
    ALL.iter().find(|kind| kind.name == name).ok_or_else(|| Error::unknown("data set kind", name, known()))
}

/// Formats the table of all kinds in Markdown.
pub fn table() -> String {
    let mut text = String::from("| kind | gives | MANO files | data set | licence |\n|---|---|---|---|---|\n");
    for kind in &ALL {
        let mano = match kind.mano {
            Mano::Required => "required",
            Mano::Optional => "for exact hands",
            Mano::Fitted => "for MANO's vertices",
        };
        let Kind { name, gives, origin, licence, .. } = kind;
        // Writing to a String cannot fail.
        let _ = writeln!(text, "| {name} | {gives} | {mano} | {origin} | {licence} |");
    }
    text.push_str("\nNot read:\n\n");
    for (name, why) in NOT_READ {
        let _ = writeln!(text, "- {name}: {why}");
    }
    text
}
