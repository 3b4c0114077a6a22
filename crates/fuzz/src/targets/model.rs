//! Robot models and objects: MJCF and URDF.

use std::path::Path;

use egotac::mujoco::object::Shapes;
use egotac::retarget::Robot;
use egotac::{Error, Result};

use super::seed;
use crate::case::Case;
use crate::mutate::{Rng, below, chance, extreme, pick, text};

/// Elements whose numbers decide how much a compiler allocates.
const LARGE: [&str; 6] = [
    "<worldbody><body name=\"x\" pos=\"0 0 9\"><flexcomp name=\"x\" type=\"grid\" count=\"N N N\" spacing=\".1 .1 .1\" radius=\".01\"/></body></worldbody>",
    "<asset><hfield name=\"x\" nrow=\"N\" ncol=\"N\" size=\"1 1 1 1\"/></asset>",
    "<asset><texture name=\"x\" type=\"2d\" builtin=\"flat\" width=\"N\" height=\"N\"/></asset>",
    "<worldbody><replicate count=\"N\" offset=\".1 0 0\"><geom size=\".1\" pos=\"0 0 9\"/></replicate></worldbody>",
    "<size memory=\"N\"/>",
    "<custom><numeric name=\"x\" size=\"N\" data=\"1\"/></custom>",
];

/// Changes a shipped model, or adds an element that asks for much.
pub fn mjcf(rng: &mut Rng) -> Case {
    let name = *pick(rng, &["four_finger", "gripper", "tendon_hand"]);
    let original = String::from_utf8_lossy(&seed(&format!("sim/robots/{name}.xml"))).into_owned();
    if chance(rng, 0.15) {
        let element = pick(rng, &LARGE).replace('N', &extreme(rng).to_string());
        return Case::File(original.replace("</mujoco>", &format!("{element}</mujoco>")).into_bytes());
    }
    changed(rng, original)
}

/// Changes a small hand in URDF.
pub fn urdf(rng: &mut Rng) -> Case {
    let mut hand = "<robot name=\"hand\">\n<link name=\"palm\"/>\n".to_string();
    for finger in ["thumb", "index"] {
        let mut parent = "palm".to_string();
        for part in 0..3 {
            let link = format!("{finger}_{part}");
            hand += &format!("<link name=\"{link}\">\n<collision><geometry>\n");
            hand += *pick(
                rng,
                &["<box size=\"0.01 0.01 0.03\"/>", "<mesh filename=\"a.stl\"/>", "<sphere radius=\"0.01\"/>"],
            );
            hand += "\n</geometry></collision>\n</link>\n";
            hand += &format!(
                "<joint name=\"{link}_joint\" type=\"revolute\">\n<parent link=\"{parent}\"/>\n<child link=\"{link}\"/>\n"
            );
            hand += "<origin xyz=\"0 0 0.03\"/>\n<axis xyz=\"1 0 0\"/>\n<limit lower=\"0\" upper=\"1.5\" effort=\"1\" velocity=\"1\"/>\n</joint>\n";
            parent = link;
        }
    }
    changed(rng, hand + "</robot>\n")
}

fn changed(rng: &mut Rng, mut xml: String) -> Case {
    for _ in 0..1 + below(rng, 3) {
        xml = text::change(rng, &xml);
    }
    if chance(rng, 0.03) {
        xml = "<a>".repeat(*pick(rng, &[100, 10_000, 200_000]));
    }
    Case::File(xml.into_bytes())
}

/// Reads the model as a robot and as an object.
pub fn read(path: &Path, _scratch: &Path) -> Result<()> {
    let name = path.to_str().ok_or_else(|| Error::file(path, "expected a path in UTF-8"))?;
    let robot = Robot::load(name, None).map(drop);
    robot.or(Shapes::read(path).map(drop))
}
