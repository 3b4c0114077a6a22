//! Trees of data sets for measurements of their readers.

use std::path::PathBuf;

use crate::files::ManoFiles;
use crate::take::Take;
use crate::{gloves, sensors, sets, third, videos};

/// Writes a data set of each kind into the folder of the variable `EGOTAC_TREES`.
#[test]
#[ignore = "writes the data sets that `egotac bench import` measures"]
fn trees_are_written() {
    let root = PathBuf::from(std::env::var("EGOTAC_TREES").unwrap());
    let take = Take::simulated();
    let mano = ManoFiles::write(&root, &take, false);
    let at = |kind: &str| root.join(kind);
    sets::write_h2o(&at("h2o"), &take);
    sets::write_fpha(&at("fpha"), &take);
    sets::write_arctic(&at("arctic"), &take, &mano);
    sets::write_oakink2(&at("oakink2"), &take);
    videos::write_taco(&at("taco"), &take);
    videos::write_hoi4d(&at("hoi4d"), &take);
    sensors::write_egopressure(&at("egopressure"), &take);
    gloves::write_opentouch(&at("opentouch/kitchen.hdf5"), &take);
    gloves::write_touchanything(&at("touchanything/pour/1.hdf5"), &take);
    gloves::write_egodex(&at("egodex"), &take);
    third::write_dexycb(&at("dexycb"), &take, &mano);
    third::write_grab(&at("grab_root"), &take, &mano);
    third::write_contactpose(&at("contactpose"), &take, &mano);
}
