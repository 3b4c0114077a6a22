//! Topic `~/contacts`: the regions in contact with position, normal and force, in the form of `tactile_msgs`.

use glam::DVec3;

use crate::hand::{HandModel, Region, Side, vertex_normals};
use crate::message::{Header, Point, TactileContact, TactileContacts, Vector3, Wrench};
use crate::node::placed_hand::PlacedHand;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;
use crate::tactile::{Certainty, TactileField};

/// Publishes the contacts.
pub(super) struct Contacts {
    publisher: Publisher<TactileContacts>,
    /// Region of each vertex of the left and the right hand.
    regions: [Vec<Region>; 2],
}

impl Contacts {
    /// Creates the publisher on `topic`.
    ///
    /// # Errors
    /// If ROS refuses the topic.
    pub(super) fn create(runtime: &mut Runtime, topic: &str, models: &[HandModel; 2]) -> anyhow::Result<Self> {
        let publisher = runtime.publisher(topic, qos::output())?;
        Ok(Self { publisher, regions: models.each_ref().map(HandModel::regions) })
    }

    /// Returns true if the topic has a subscriber.
    pub(super) fn is_wanted(&self) -> bool {
        self.publisher.subscriber_count() > 0
    }

    /// Publishes the contacts on `hands`, which are in `header.frame_id`. `threshold`: probability above which a vertex is in
    /// contact.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses the message.
    pub(super) fn publish(
        &self,
        header: &Header,
        (field, certainty): (&TactileField, &Certainty),
        hands: &[PlacedHand],
        models: &[HandModel; 2],
        threshold: f32,
    ) -> anyhow::Result<()> {
        let mut message = TactileContacts { header: header.clone(), known: [false; 2], contacts: Vec::new() };
        for side in Side::BOTH.into_iter().filter(|side| certainty.counts(*side)) {
            let touch = (&field.force[side.range()], &field.contact[side.range()]);
            let hand = hands.iter().find(|hand| hand.side == side);
            let Some(hand) = hand.filter(|_| touch.1.iter().all(|contact| !contact.is_nan())) else { continue };
            message.known[side as usize] = true;
            let contacts =
                contacts(header, touch, hand, &models[side as usize], &self.regions[side as usize], threshold);
            message.contacts.extend(contacts);
        }
        self.publisher.publish(&message)
    }
}

/// Returns the contacts of a hand in the order of the regions. `touch`: force, N, and contact probability of its vertices, (778) each.
fn contacts(
    header: &Header,
    touch: (&[f32], &[f32]),
    hand: &PlacedHand,
    model: &HandModel,
    regions: &[Region],
    threshold: f32,
) -> Vec<TactileContact> {
    let normals = vertex_normals(&hand.posed.vertices, &model.faces);
    let mut sums = vec![Sums::default(); Region::ALL.len()];
    for (vertex, region) in regions.iter().enumerate() {
        let (force, contact) = (touch.0[vertex], touch.1[vertex]);
        let sums = &mut sums[region.index()];
        sums.touches |= contact > threshold;
        let (position, normal) = (hand.posed.vertices[vertex].as_dvec3(), normals[vertex].as_dvec3());
        sums.by_force.add(f64::from(force), position, normal);
        sums.by_contact.add(f64::from(contact), position, normal);
    }
    let contact = |(region, sums): (&Region, &Sums)| {
        let Mean { weight, force, torque, .. } = sums.by_force;
        // Unknown forces, and contact without force, give no place.
        let place = if weight > 0.0 { sums.by_force } else { sums.by_contact };
        TactileContact {
            header: header.clone(),
            name: format!("{}_{}", hand.side.name(), region.name()),
            position: point(place.position / place.weight),
            normal: vector(place.normal.normalize_or_zero()),
            wrench: Wrench { force: vector(force), torque: vector(torque) },
        }
    };
    Region::ALL.iter().zip(&sums).filter(|(_, sums)| sums.touches).map(contact).collect()
}

/// Sums over the vertices of a region.
#[derive(Clone, Copy, Default)]
struct Sums {
    /// True if a vertex is in contact.
    touches: bool,
    /// Weighted by force.
    by_force: Mean,
    /// Weighted by contact probability.
    by_contact: Mean,
}

/// Sums of weighted vertices.
#[derive(Clone, Copy, Default)]
struct Mean {
    weight: f64,
    position: DVec3,
    normal: DVec3,
    /// The world presses against the skin: the force on a vertex points inwards, along its normal.
    force: DVec3,
    /// About the frame's origin.
    torque: DVec3,
}

impl Mean {
    fn add(&mut self, weight: f64, position: DVec3, normal: DVec3) {
        self.weight += weight;
        self.position += weight * position;
        self.normal += weight * normal;
        let force = -weight * normal;
        self.force += force;
        self.torque += position.cross(force);
    }
}

fn point(DVec3 { x, y, z }: DVec3) -> Point {
    Point { x, y, z }
}

fn vector(DVec3 { x, y, z }: DVec3) -> Vector3 {
    Vector3 { x, y, z }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hand::{HandParams, N_VERTICES};
    use glam::Vec3;

    /// Contacts of a right hand in this pose with one touched vertex, the tip of its index finger.
    fn of(force: f32, params: &HandParams) -> (Vec<TactileContact>, DVec3) {
        let model = HandModel::builtin(Side::Right);
        let tip = model.tip_vertices[1] as usize;
        let (mut forces, mut contacts_) = (vec![0.0; N_VERTICES], vec![0.1; N_VERTICES]);
        (forces[tip], contacts_[tip]) = (force, 0.9);
        let hand = PlacedHand { side: Side::Right, posed: model.forward(params) };
        let place = hand.posed.vertices[tip].as_dvec3();
        let header = Header { frame_id: "table".into(), ..Header::default() };
        (contacts(&header, (&forces, &contacts_), &hand, &model, &model.regions(), 0.5), place)
    }

    #[test]
    fn a_touched_vertex_is_one_contact_at_its_place_with_its_force_against_the_normal() {
        let params = HandParams { transl: Vec3::new(0.3, -0.2, 0.5), ..HandParams::default() };
        let (found, tip) = of(2.0, &params);
        let [contact] = &found[..] else { panic!("{found:?}") };
        assert_eq!((contact.name.as_str(), contact.header.frame_id.as_str()), ("right_index_tip", "table"));
        let [position, normal, force, torque] = [
            DVec3::new(contact.position.x, contact.position.y, contact.position.z),
            dvec3(contact.normal),
            dvec3(contact.wrench.force),
            dvec3(contact.wrench.torque),
        ];
        assert!((position - tip).length() < 1e-9);
        assert!((normal.length() - 1.0).abs() < 1e-6 && (force + 2.0 * normal).length() < 1e-5, "{force} {normal}");
        assert!((torque - tip.cross(force)).length() < 1e-9);
    }

    #[test]
    fn a_contact_of_unknown_force_has_a_place_and_a_normal_but_no_force() {
        let (found, _) = of(f32::NAN, &HandParams::default());
        let [contact] = &found[..] else { panic!("{found:?}") };
        assert!(dvec3(contact.wrench.force).is_nan() && dvec3(contact.wrench.torque).is_nan());
        assert!((dvec3(contact.normal).length() - 1.0).abs() < 1e-6 && contact.position.x.is_finite());
        // The place is within the region, which is a fingertip.
        let (known, _) = of(1.0, &HandParams::default());
        assert!((contact.position.x - known[0].position.x).abs() < 0.03);
    }

    fn dvec3(Vector3 { x, y, z }: Vector3) -> DVec3 {
        DVec3::new(x, y, z)
    }
}
