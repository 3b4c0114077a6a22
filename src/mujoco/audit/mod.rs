//! A model looked at before its first step: what in it is known to go wrong silently.
//!
//! The engine accepts all of this without a warning. Errors are models whose motion or forces would be false; advice is
//! what costs accuracy or matters only under conditions that a model alone does not tell.

pub mod mesh;
mod rules;
mod touch;

use super::world::World;

pub use mesh::{MeshFault, mesh_faults};
pub use touch::{depth_limits, speed_limits};

/// How grave a finding is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severity {
    /// Costs accuracy, or matters only at times.
    Advice,
    /// Results would be false.
    Error,
}

/// What a model may break.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rule {
    /// Bodies on each other differ in mass by 100 at most, or their contact is stiffened.
    MassRatio,
    /// A timestep is at most half of a contact's time constant; a tenth for accurate forces.
    ContactTime,
    /// Stiffness given directly is within what the timestep bears.
    DirectStiffness,
    /// A contact is damped at least critically, or the timestep is at most an eighth of its time constant.
    ContactDamping,
    /// At the expected speed nothing passes through anything.
    Tunnelling,
    /// Nothing starts inside of something else.
    StartDepth,
    /// A body's radius of gyration is at least 0.1 mm.
    Inertia,
    /// Collision meshes are closed, face outwards and span a volume.
    Mesh,
    /// Friction does not creep.
    Creep,
    /// Bodies at rest stay in the list of contacts.
    Sleep,
}

/// One thing found.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// How grave.
    pub severity: Severity,
    /// What is broken.
    pub rule: Rule,
    /// Which parts of the model, what was expected, what came.
    pub message: String,
}

/// What the model is for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expectation {
    /// Speed at which things meet, m/s.
    pub speed: f64,
}

impl Default for Expectation {
    /// A brisk hand.
    fn default() -> Self {
        Self { speed: 1.0 }
    }
}

/// Looks at a world before its first step, in its start pose, after [`World::forward`]; gravest findings first.
///
/// Of each rule only the worst case is reported.
pub fn audit(world: &World, expectation: Expectation) -> Vec<Finding> {
    let touches = touch::touches(world);
    let mut findings = Vec::new();
    findings.extend(rules::mass_ratio(world, &touches));
    findings.extend(rules::contact_time(world, &touches));
    findings.extend(rules::direct_stiffness(world, &touches));
    findings.extend(rules::contact_damping(world, &touches));
    findings.extend(rules::tunnelling(world, &touches, expectation.speed));
    findings.extend(rules::start_depth(world));
    findings.extend(rules::inertia(world));
    findings.extend(rules::meshes(world));
    findings.extend(rules::creep(world));
    findings.extend(rules::sleep(world));
    findings.sort_by(|a, b| b.severity.cmp(&a.severity).then(a.rule.cmp(&b.rule)));
    findings
}

/// The errors among findings as one error; for those who refuse to simulate such a model.
///
/// # Errors
/// If there is an error among them; it names all of them.
pub fn refuse_errors(findings: &[Finding]) -> crate::Result<()> {
    let errors: Vec<&str> =
        findings.iter().filter(|f| f.severity == Severity::Error).map(|f| f.message.as_str()).collect();
    if errors.is_empty() {
        return Ok(());
    }
    Err(crate::Error::value("model", "one whose results can be trusted", errors.join("; ")))
}
