//! Settings of the estimation: how people grip, and how far geometry is trusted.

/// Settings of the estimation.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Settings {
    /// Bandwidth of the motion, 1/s; `None` = the largest at which noise stays small.
    pub bandwidth: Option<f64>,
    /// Median of the ratio between the force of a grip and the least one that holds.
    pub grip: f64,
    /// Standard deviation of the logarithm of this ratio's excess over 1.
    pub grip_spread: f64,
    /// Force at which a hand takes hold of what something else still carries, relative to the force that would hold it.
    pub early_grip: f64,
    /// Standard deviation of the friction coefficient's logarithm.
    pub friction_spread: f64,
    /// Gap up to which a link of a hand with an exact pose is in contact, m: vertices are up to 8 mm apart on round fingers.
    pub contact_gap: f64,
    /// Standard deviation of a contact's place on the surface, m.
    pub place_sd: f64,
    /// Time over which grip forces hold on to their values, s.
    pub memory: f64,
    /// Number of samples of the unknowns.
    pub samples: usize,
    /// Factor on the widths of intervals that the samples span.
    pub inflation: f64,
    /// Half width of the 90 % interval of what the motion does not see of a link's force: a part in N, since hands press with
    /// newtons on things of any weight, and a part relative to the force that would hold the object between two fingers. It is
    /// weighted with the root of the share of variance that the motion leaves, and added in quadrature: where noise widens the
    /// samples already, it adds little.
    ///
    /// The values are the smallest round ones with which the stated interval holds about 90 % of the true forces, as the mean
    /// over scenes: 87 to 90 % at 30 Hz with exact poses and with noise of 1 to 5 mm, in one episode each (seed 100) of
    /// `pinch_cube`, `lift_mug`, `poke`, `palm_push`, `slide_card`, `hold_plate` and `regrasp` (the rows of `egotac bench
    /// physics --rows`). The published bench scores seed 0, and scenes of the split `ood`, which the calibration never saw.
    pub unseen: [f64; 2],
    /// True to move hands within their noise to where contact is possible.
    pub refine: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            bandwidth: None,
            grip: 2.2,
            grip_spread: 0.7,
            early_grip: 1.2,
            friction_spread: 0.15,
            contact_gap: 0.001,
            place_sd: 0.0015,
            memory: 0.15,
            samples: 32,
            inflation: 1.0,
            unseen: [2.0, 1.0],
            refine: false,
        }
    }
}
