//! Checks a model before its first step for faults that the engine accepts without a warning.
//!
//! An error marks a model whose motion or forces would be wrong. Advice marks a loss of accuracy, or a fault that
//! depends on conditions outside of the model.

mod mesh;
mod pairs;
mod rules;

use super::world::World;

pub use mesh::{MeshFault, mesh_faults};
pub use pairs::{depth_limits, speed_limits};

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severity {
    /// Reduces accuracy, or is a fault under some conditions only.
    Advice,
    /// Makes results wrong.
    Error,
}

/// A rule of the audit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rule {
    /// The mass ratio of bodies in contact is at most 100, or their contact is stiffened.
    MassRatio,
    /// The timestep is at most half of a contact's time constant, a tenth for accurate forces.
    ContactTime,
    /// Contact stiffness given directly is stable at the timestep.
    DirectStiffness,
    /// A contact is damped at least critically, or the timestep is at most an eighth of its time constant.
    ContactDamping,
    /// No body passes through another at the expected speed.
    Tunnelling,
    /// No geoms overlap at the start.
    StartDepth,
    /// A body's radius of gyration is at least 0.1 mm.
    Inertia,
    /// Collision meshes are closed, face outwards and enclose a volume.
    Mesh,
    /// Friction is stiff enough to hold an object without creep.
    Creep,
    /// Contacts of resting bodies stay in the contact list.
    Sleep,
}

/// A violation of a rule.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Severity.
    pub severity: Severity,
    /// Violated rule.
    pub rule: Rule,
    /// Elements concerned, expected value and actual value.
    pub message: String,
}

/// Conditions that the model is used under.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expectation {
    /// Speed at which bodies meet, m/s.
    pub speed: f64,
}

impl Default for Expectation {
    /// 1 m/s, the speed of a brisk hand.
    fn default() -> Self {
        Self { speed: 1.0 }
    }
}

/// Audits a world in its initial pose, after [`World::forward`]. Returns the worst violation of each rule, errors
/// first.
pub fn audit(world: &World, expectation: Expectation) -> Vec<Finding> {
    let pairs = pairs::geom_pairs(world);
    let mut findings = Vec::new();
    findings.extend(rules::mass_ratio(world, &pairs));
    findings.extend(rules::contact_time(world, &pairs));
    findings.extend(rules::direct_stiffness(world, &pairs));
    findings.extend(rules::contact_damping(world, &pairs));
    findings.extend(rules::tunnelling(world, &pairs, expectation.speed));
    findings.extend(rules::start_depth(world));
    findings.extend(rules::inertia(world));
    findings.extend(rules::meshes(world));
    findings.extend(rules::creep(world));
    findings.extend(rules::sleep(world));
    findings.sort_by(|a, b| b.severity.cmp(&a.severity).then(a.rule.cmp(&b.rule)));
    findings
}

/// Fails if findings contain errors.
///
/// # Errors
/// If a finding has [`Severity::Error`]; the message names all such findings.
pub fn refuse_errors(findings: &[Finding]) -> crate::Result<()> {
    let errors: Vec<&str> =
        findings.iter().filter(|f| f.severity == Severity::Error).map(|f| f.message.as_str()).collect();
    if errors.is_empty() {
        return Ok(());
    }
    Err(crate::Error::value("model", "one whose results can be trusted", errors.join("; ")))
}
