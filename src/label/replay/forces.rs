//! Contact forces of a stage whose hands and objects move along their courses.

use glam::{DQuat, DVec3};

use super::courses::{Courses, ObjectState};
use super::stage::Stage;
use crate::error::Result;
use crate::hand::N_JOINTS;
use crate::physics::Pose;

/// Distance from the table at which hands and objects without a known pose wait, m.
const AWAY: f64 = 50.0;

impl Stage {
    /// Computes the forces of frame `at` of a run: normal forces on the links of both hands, N, and the net force on each object in
    /// the store's frame, N.
    ///
    /// # Errors
    /// If a pose is not finite.
    pub fn forces(&mut self, courses: &Courses, at: usize) -> Result<([[f64; N_JOINTS]; 2], Vec<DVec3>)> {
        let world = &mut self.world;
        for (side, (hand, course)) in self.hands.iter().zip(&courses.servos).enumerate() {
            let Some(hand) = hand else { continue };
            for (index, servo) in hand.servos.iter().enumerate() {
                let away = if index == side { [AWAY, 0.0, 0.0] } else { [0.0; 3] };
                let motion = course.as_ref().map_or(away, |course| course[at][index]);
                world.set_joint_motion(*servo, motion);
            }
        }
        for (index, (object, states)) in self.objects.iter().zip(&courses.objects).enumerate() {
            let Some((_, joint)) = object else { continue };
            let away = Pose { position: DVec3::Z * AWAY * (index + 1) as f64, orientation: DQuat::IDENTITY };
            let at_rest = ObjectState { pose: away, linear: [DVec3::ZERO; 2], angular: [DVec3::ZERO; 2] };
            let ObjectState { pose, linear, angular } = states.as_ref().map_or(at_rest, |states| states[at]);
            world.set_free_motion(*joint, (pose.position, pose.orientation), linear, angular)?;
        }
        world.inverse();
        Ok(self.read(courses))
    }

    fn read(&self, courses: &Courses) -> ([[f64; N_JOINTS]; 2], Vec<DVec3>) {
        let mut links = courses.unknown.map(|unknown| [if unknown { f64::NAN } else { 0.0 }; N_JOINTS]);
        let known = |index: usize| courses.objects[index].is_some();
        let parts = |root: usize| (0..self.roots.len()).filter(move |part| self.roots[*part] == root);
        // The first part of an articulated object stands for all: what its parts push on each other cancels in the sum.
        let start = |index: usize| match self.roots[index] == index && parts(index).all(known) {
            true => DVec3::ZERO,
            false => DVec3::NAN,
        };
        let mut net: Vec<DVec3> = (0..self.objects.len()).map(start).collect();
        let back = self.placing.orientation.inverse();
        for contact in self.world.contacts() {
            for (sign, body) in [-1.0, 1.0].into_iter().zip(contact.bodies) {
                let object = self.objects.iter().position(|object| object.is_some_and(|(object, _)| object == body));
                if let Some(net) = object.and_then(|index| net.get_mut(self.roots[index])) {
                    *net += back * (sign * contact.force);
                }
                for (hand, forces) in self.hands.iter().zip(&mut links) {
                    let links = hand.as_ref().map(|hand| hand.links.as_slice()).unwrap_or_default();
                    if let Some(link) = links.iter().position(|link| *link == body) {
                        forces[link] += contact.normal_force;
                    }
                }
            }
        }
        (links, net)
    }
}
