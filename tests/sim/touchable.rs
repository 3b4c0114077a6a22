//! Distances of hands from the surfaces that they can touch.

use egotac::geometry::Sides;
use egotac::hand::{HandModel, HandParams, N_BETAS, N_VERTICES, Side};
use egotac::sim::ObjectPose;
use egotac::sim::randomize::EpisodeDraw;
use egotac::sim::rig::HandRig;
use egotac::sim::{Scene, Touchables};
use egotac::tactile::N_FIELD;
use glam::{DQuat, DVec3, Vec3};

/// Distance up to which surfaces are searched, m.
const CUTOFF: f32 = 0.02;

fn episode(scene: &str) -> (EpisodeDraw, [HandModel; 2], Touchables) {
    let hands = Side::BOTH.map(HandModel::builtin);
    let rigs = hands.each_ref().map(|hand| HandRig::new(hand.clone(), [0.0; N_BETAS]).unwrap());
    let episode = EpisodeDraw::sample(&Scene::load(scene).unwrap(), 3, &rigs).unwrap();
    let touchables = Touchables::new(&episode, hands.each_ref(), 0.006).unwrap();
    (episode, hands, touchables)
}

fn poses(episode: &EpisodeDraw, shift: DVec3, turn: DQuat) -> Vec<ObjectPose> {
    let pose = |object: &egotac::sim::randomize::ObjectDraw| ObjectPose {
        name: object.name.clone(),
        position: object.position + shift,
        orientation: turn * object.orientation,
    };
    episode.objects.iter().map(pose).collect()
}

/// Returns the vertices of a hand around `centre`, m.
fn hand_at(model: &HandModel, centre: Vec3) -> Vec<Vec3> {
    let vertices = model.forward(&HandParams::default()).vertices;
    let middle = vertices.iter().sum::<Vec3>() / vertices.len() as f32;
    vertices.iter().map(|v| *v - middle + centre).collect()
}

#[test]
fn distances_match_the_shapes_of_object_and_table() {
    let (episode, [_, right], mut touchables) = episode("lift_mug");
    let turn = DQuat::from_scaled_axis(DVec3::new(0.5, -0.3, 0.9));
    for height in [0.0, 0.05, 0.3] {
        let objects = poses(&episode, DVec3::Z * height, turn);
        // The hand passes through the mug: vertices lie inside the wall, in the hollow and around it.
        let vertices = hand_at(&right, objects[0].position.as_vec3() + Vec3::new(0.01, 0.02, 0.0));
        let distances = touchables.distances([None, Some(&vertices)], &objects, CUTOFF).unwrap();
        assert!(
            distances.surface[Side::Left.range()].iter().all(|d| d.is_infinite()),
            "an absent hand is infinitely far"
        );
        let (mut inside, mut near) = (0, 0);
        for (vertex, index) in vertices.iter().zip(Side::Right.range()) {
            let local = objects[0].orientation.inverse() * (vertex.as_dvec3() - objects[0].position);
            let table = (vertex.as_dvec3() - DVec3::new(0.0, 0.1, -0.02)).abs() - DVec3::new(0.6, 0.45, 0.02);
            let table = table.max(DVec3::ZERO).length() + table.max_element().min(0.0);
            let expected = episode.objects[0].shape.distance(local).min(table);
            let (got, point) = (f64::from(distances.surface[index]), f64::from(distances.points[index]));
            match expected <= f64::from(CUTOFF) {
                true => assert!((got - expected).abs() < 1e-6, "{vertex}: {got} m instead of {expected} m"),
                false => assert!(got.is_infinite(), "{vertex}: {got} m instead of {expected} m"),
            }
            // Points lie on the surface; on a round one, up to a facet's sagitta inside.
            assert!(point >= got.max(0.0) - 1e-3, "{vertex}: a point at {point} m, the surface at {got} m");
            assert!(
                point <= expected.abs() + 0.007 || point.is_infinite() && expected.abs() > 0.012,
                "{point} {expected}"
            );
            inside += usize::from(got < 0.0);
            near += usize::from(got.is_finite());
        }
        assert!(inside > 5 && near > inside && near < N_VERTICES, "{inside} inside, {near} near");
    }
}

#[test]
fn hand_is_near_the_other_hand_but_not_itself() {
    let (episode, [left, right], mut touchables) = episode("hover");
    let far = DVec3::X * 5.0;
    let objects = poses(&episode, far, DQuat::IDENTITY);
    let centre = Vec3::Z * 0.5;
    let (left, right) = (hand_at(&left, centre), hand_at(&right, centre + Vec3::Y * 0.02));
    let alone = touchables.distances([Some(&left), None], &objects, CUTOFF).unwrap();
    assert!(alone.surface.iter().chain(&alone.points).all(|d| d.is_infinite()));
    let both = touchables.distances([Some(&left), Some(&right)], &objects, CUTOFF).unwrap();
    for side in Side::BOTH {
        let inside = both.surface[side.range()].iter().filter(|d| **d < 0.0).count();
        assert!(inside > 20, "{inside} vertices of the {} hand in the other", side.name());
    }
    // No state of the previous frame remains.
    let apart: Vec<Vec3> = right.iter().map(|v| *v + Vec3::Y * 0.4).collect();
    let apart = touchables.distances([Some(&left), Some(&apart)], &objects, CUTOFF).unwrap();
    assert!(apart.surface.iter().all(|d| d.is_infinite()));
}

#[test]
fn absent_objects_are_ignored_and_invalid_vertices_refused() {
    let (episode, [_, right], mut touchables) = episode("pinch_cube");
    let mut objects = poses(&episode, DVec3::Z, DQuat::IDENTITY);
    let mut vertices = hand_at(&right, objects[0].position.as_vec3());
    let mut near = |objects: &[ObjectPose], vertices: &[Vec3]| {
        touchables.distances([None, Some(vertices)], objects, CUTOFF).map(|d| d.surface.iter().any(|d| d.is_finite()))
    };
    assert!(near(&objects, &vertices).unwrap());
    assert!(!near(&[], &vertices).unwrap());
    objects[0].position.x = f64::NAN;
    assert!(!near(&objects, &vertices).unwrap());
    assert!(near(&objects, &vertices[1..]).unwrap_err().to_string().contains("vertices"));
    vertices[5].y = f32::NAN;
    assert!(near(&objects, &vertices).unwrap_err().to_string().contains("vertex 5 of the right hand"));
}

#[test]
fn samplings_name_each_surface_with_its_spacing() {
    let (_, _, touchables) = episode("lift_mug");
    let samplings = touchables.samplings();
    let names: Vec<&str> = samplings.iter().map(|sampling| sampling.name.as_str()).collect();
    assert_eq!(names, ["mug", "left hand", "right hand"]);
    for sampling in &samplings {
        assert!(sampling.points > N_FIELD / 4 && sampling.spacing_mm == 6.0 && sampling.sides == Sides::Closed);
    }
    assert_eq!(samplings[0].parts, 20 + 1 + 7);
}
