//! Scenes embedded in the program.

/// Expands to name and text of a scene in `sim/scenes`.
macro_rules! scene {
    ($name:literal) => {
        ($name, include_str!(concat!("../../../sim/scenes/", $name, ".yaml")))
    };
}

/// Name and YAML text of each shipped scene, in the order of `egotac sim list`.
pub const SHIPPED: [(&str, &str); 19] = [
    scene!("pinch_cube"),
    scene!("lift_mug"),
    scene!("hover"),
    scene!("poke"),
    scene!("tripod"),
    scene!("power_grasp"),
    scene!("palm_push"),
    scene!("press_button"),
    scene!("turn_knob"),
    scene!("open_door"),
    scene!("slide_card"),
    scene!("wipe_table"),
    scene!("squeeze_ball"),
    scene!("hold_plate"),
    scene!("carry_box"),
    scene!("regrasp"),
    scene!("reach_past"),
    scene!("rub_hands"),
    scene!("clutter"),
];
