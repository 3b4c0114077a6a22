//! Touch that the robot should measure if it holds the object as the human does.

use glam::DVec3;

/// Touch expected on one link of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct ExpectedLinkTouch {
    /// Name of the link's body.
    pub name: String,
    /// Normal force, N.
    pub normal_force: f64,
    /// Force of the world on the link, N, in the frame of the keypoints.
    pub force: DVec3,
    /// Torque of that force about the wrist, N m, in the frame of the keypoints.
    pub torque: DVec3,
    /// Point of action relative to the robot's wrist, m, in the axes of the keypoints' frame.
    pub position: DVec3,
    /// The force in the frame of the link's body, N.
    pub body_force: DVec3,
    /// Point of action in the frame of the link's body, m.
    pub body_position: DVec3,
    /// Contact probability.
    pub contact: f64,
}

/// Touch expected on the robot hand.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ExpectedTouch {
    /// Links: three per finger at most, then palm and back.
    pub links: Vec<ExpectedLinkTouch>,
    /// Force of the world on each fingertip by human finger, N, in the frame of the keypoints; zero for fingers that the
    /// robot lacks.
    pub tip_force: [DVec3; 5],
    /// Torque or force with which the joints of each free coordinate press with these forces, N m or N.
    pub torque: Vec<f64>,
    /// True if torque limits reduced forces.
    pub clipped: bool,
    /// Sum of the human's forces that no link takes, N: of segments that the robot lacks or its file excludes.
    pub unassigned_force: f64,
    /// Net force of the human's touch without `unassigned_force`, N, in the frame of the keypoints.
    pub net_force: DVec3,
    /// Net torque of the human's touch about the mean point of action, scaled to the size of the robot hand, N m, in the
    /// frame of the keypoints.
    pub net_torque: DVec3,
}

impl ExpectedTouch {
    /// Returns no touch, for links of these names and `n_coordinates` free coordinates.
    pub(super) fn none(names: impl IntoIterator<Item = String>, n_coordinates: usize) -> Self {
        let link = |name| ExpectedLinkTouch {
            name,
            normal_force: 0.0,
            force: DVec3::ZERO,
            torque: DVec3::ZERO,
            position: DVec3::ZERO,
            body_force: DVec3::ZERO,
            body_position: DVec3::ZERO,
            contact: 0.0,
        };
        Self { links: names.into_iter().map(link).collect(), torque: vec![0.0; n_coordinates], ..Self::default() }
    }

    /// Clears all forces and contacts; keeps names and positions.
    pub(crate) fn clear(&mut self) {
        for link in &mut self.links {
            link.normal_force = 0.0;
            link.contact = 0.0;
            (link.force, link.torque, link.body_force) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO);
        }
        self.tip_force = [DVec3::ZERO; 5];
        self.torque.fill(0.0);
        (self.clipped, self.unassigned_force) = (false, 0.0);
        (self.net_force, self.net_torque) = (DVec3::ZERO, DVec3::ZERO);
    }
}
