//! Fields are transferred between the built-in hand and a MANO file: total force is conserved, positions and regions
//! agree.
//!
//! The MANO file is the synthetic one of tests/data/hand/make_golden.py: the built-in hand deformed, thickened, rotated
//! and renumbered, so that the true correspondence is known.

use std::io::Read;

use crate::common::hand_data;
use egotac::hand::{HandMap, HandModel, N_VERTICES, Region, Side, Topology};
use egotac::tactile::N_FIELD;
use glam::Vec3;
use proptest::prelude::*;
use safetensors::SafeTensors;

fn right_mano() -> HandModel {
    HandModel::load(&hand_data("right.npz"), Side::Right).unwrap()
}

fn left_mano() -> HandModel {
    let mut plain = Vec::new();
    let bytes = std::fs::read(hand_data("left_plain.pkl.gz")).unwrap();
    flate2::read::GzDecoder::new(&bytes[..]).read_to_end(&mut plain).unwrap();
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), plain).unwrap();
    HandModel::load(file.path(), Side::Left).unwrap()
}

/// Returns the built-in vertex of each MANO vertex.
fn builtin_vertex() -> Vec<usize> {
    let bytes = std::fs::read(hand_data("golden.safetensors")).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let data = file.tensor("builtin_vertex").unwrap().data().to_vec();
    data.as_chunks().0.iter().map(|word| i32::from_le_bytes(*word) as usize).collect()
}

/// Returns the forces of a touch: a Gaussian of 6 mm around a vertex of each hand, 3 N and 1 N in total.
fn touch(vertices: &[Vec3], at: usize) -> Vec<f32> {
    let bump: Vec<f32> =
        vertices.iter().map(|v| (-v.distance_squared(vertices[at]) / (2.0 * 0.006f32.powi(2))).exp()).collect();
    let total: f32 = bump.iter().sum();
    [1.0, 3.0].iter().flat_map(|newton| bump.iter().map(move |b| b / total * newton)).collect()
}

fn totals(force: &[f32]) -> [f64; 2] {
    [Side::Left, Side::Right].map(|side| force[side.range()].iter().map(|f| f64::from(*f)).sum())
}

#[test]
fn interpolation_lands_on_the_true_vertex() {
    for (mano, side) in [(right_mano(), Side::Right), (left_mano(), Side::Left)] {
        let map = HandMap::new(&mano);
        let builtin = HandModel::builtin(side);
        let truth = builtin_vertex();
        let mut errors: Vec<f32> = (0..N_VERTICES)
            .map(|vertex| {
                let place: Vec3 =
                    map.to_mano.contact[vertex].iter().map(|&(v, w)| builtin.v_template[v as usize] * w).sum();
                place.distance(builtin.v_template[truth[vertex]])
            })
            .collect();
        errors.sort_by(f32::total_cmp);
        let (median, most) = (errors[N_VERTICES / 2], errors[N_VERTICES * 95 / 100]);
        assert!(median < 0.003 && most < 0.006, "{side:?}: median {median} m, 95 % {most} m");
    }
}

#[test]
fn regions_agree_after_the_transfer() {
    let mano = right_mano();
    let map = HandMap::new(&mano);
    let (from, to) = (HandModel::builtin(Side::Right).regions(), mano.regions());
    for region in Region::ALL {
        let field: Vec<f32> = [&from, &from].into_iter().flatten().map(|r| f32::from(u8::from(*r == region))).collect();
        let carried = &map.to_mano.contact(&field).unwrap()[Side::Right.range()];
        let both = carried.iter().zip(&to).filter(|(c, r)| **c >= 0.5 && **r == region).count();
        let either = carried.iter().zip(&to).filter(|(c, r)| **c >= 0.5 || **r == region).count();
        assert!(both * 10 >= either * 7, "{}: {both} of {either}", region.name());
    }
}

#[test]
fn touch_stays_where_it_was() {
    let mano = right_mano();
    let map = HandMap::new(&mano);
    let builtin = HandModel::builtin(Side::Right);
    let truth = builtin_vertex();
    for tip in builtin.tip_vertices {
        let force = touch(&builtin.v_template, tip as usize);
        let carried = &map.to_mano.force(&force).unwrap()[Side::Right.range()];
        let centre: Vec3 = carried.iter().zip(&truth).map(|(f, &v)| builtin.v_template[v] * *f).sum::<Vec3>() / 3.0;
        let wanted: Vec3 =
            force[Side::Right.range()].iter().zip(&builtin.v_template).map(|(f, v)| *v * *f).sum::<Vec3>() / 3.0;
        assert!(centre.distance(wanted) < 0.004, "moved by {} m", centre.distance(wanted));
        // The touch covers about as many vertices as before.
        let active = |force: &[f32]| force.iter().filter(|f| **f > 0.05).count();
        let (before, after) = (active(&force[Side::Right.range()]), active(carried));
        assert!(after * 3 >= before * 2 && after <= before * 2, "{before} active vertices became {after}");
    }
}

#[test]
fn contact_everywhere_stays_contact_everywhere() {
    let map = HandMap::new(&right_mano());
    for transfer in [&map.to_mano, &map.to_builtin] {
        assert!(transfer.contact(&[1.0; N_FIELD]).unwrap().iter().all(|c| (c - 1.0).abs() < 1e-5));
        assert_eq!(transfer.mask(&[1; N_FIELD]).unwrap(), [1; N_FIELD]);
    }
    assert!(map.to_mano.force(&[0.0; 778]).unwrap_err().to_string().contains("[1556]"));
    assert_eq!(map.towards(Topology::Mano), &map.to_mano);
}

#[test]
fn unknown_stays_unknown() {
    let map = HandMap::new(&right_mano());
    let force = map.to_mano.force(&[f32::NAN; N_FIELD]).unwrap();
    assert!(force.iter().filter(|f| f.is_nan()).count() > N_FIELD / 2);
    assert!(map.to_mano.contact(&[f32::NAN; N_FIELD]).unwrap().iter().all(|c| c.is_nan()));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn total_force_of_each_hand_survives_the_round_trip(
        force in proptest::collection::vec(prop_oneof![3 => Just(0f32), 1 => 0f32..5.0], N_FIELD),
    ) {
        thread_local!(static MAP: HandMap = HandMap::new(&right_mano()));
        MAP.with(|map| {
            let there = map.to_mano.force(&force).unwrap();
            let back = map.to_builtin.force(&there).unwrap();
            for carried in [&there, &back] {
                prop_assert!(carried.iter().all(|f| *f >= 0.0));
                for (before, after) in totals(&force).into_iter().zip(totals(carried)) {
                    prop_assert!((before - after).abs() <= 1e-5 * before.max(1.0), "{before} N became {after} N");
                }
            }
            Ok(())
        })?;
    }
}
