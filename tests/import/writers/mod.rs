//! Writers of a simulated take in the layouts of data sets, by code that shares nothing with the readers.
//!
//! Tests import what they write; `egotac bench import` measures the readers on it.

use std::path::{Path, PathBuf};

use files::{ManoFiles, glb, tar, write};
use take::{Take, cuboid};

pub mod files;
pub mod gloves;
pub mod h5;
pub mod hot3d;
pub mod pickle;
pub mod raw_glove;
pub mod sensors;
pub mod sets;
pub mod take;
pub mod third;
pub mod videos;

/// Writes a data set of each kind into `root`; returns kinds and folders.
pub fn write_all(root: &Path, take: &Take) -> Vec<(&'static str, PathBuf)> {
    let mano = ManoFiles::write(&root.join("mano"), take, false);
    let at = |kind: &str| root.join(kind);
    write(&at("hot3d/clip-001849.tar"), tar(&hot3d::clip(take, &mano)));
    write(&at("hot3d/object_models/obj_000007.glb"), glb(&take.box_mesh()));
    write(&at("hot3d/object_models/obj_000012.glb"), glb(&cuboid(glam::DVec3::splat(0.05))));
    sets::write_h2o(&at("h2o"), take);
    sets::write_fpha(&at("fpha"), take);
    sets::write_arctic(&at("arctic"), take, &mano);
    sets::write_oakink2(&at("oakink2"), take);
    videos::write_taco(&at("taco"), take);
    videos::write_hoi4d(&at("hoi4d"), take);
    sensors::write_egopressure(&at("egopressure"), take);
    gloves::write_opentouch(&at("opentouch/kitchen.hdf5"), take);
    gloves::write_touchanything(&at("touchanything/pour/1.hdf5"), take);
    gloves::write_egodex(&at("egodex"), take);
    raw_glove::write_raw(&at("egotac-sc-raw"), "0007", take, &[vec![0.5; 132], vec![0.5; 132]], None);
    third::write_dexycb(&at("dexycb"), take, &mano);
    third::write_grab(&at("grab"), take, &mano);
    third::write_contactpose(&at("contactpose"), take, &mano);
    third::write_epic_contact(&at("epic-contact"), take);
    let kinds = [
        "hot3d",
        "h2o",
        "taco",
        "fpha",
        "egopressure",
        "arctic",
        "hoi4d",
        "oakink2",
        "opentouch",
        "touchanything",
        "egodex",
        "dexycb",
        "grab",
        "contactpose",
        "epic-contact",
        "egotac-sc-raw",
    ];
    kinds.into_iter().map(|kind| (kind, at(kind))).collect()
}
