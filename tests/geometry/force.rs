//! Label (c) conserves force and stays on its link; label (a) does not depend on the object's mesh.

use approx::assert_relative_eq;
use egotac::geometry::force::link_vertices;
use egotac::geometry::{ForceSpreader, LinkContact, PROXIMITY, SIGMA, SampledSurface};
use egotac::hand::{HandModel, HandParams, N_JOINTS, Region, Side};
use glam::{DVec3, Vec3};
use proptest::prelude::*;

fn rest(model: &HandModel) -> Vec<Vec3> {
    model.forward(&HandParams::default()).vertices
}

fn contact(link: usize, position: [f64; 3], force: f64) -> LinkContact {
    LinkContact { link, position: DVec3::from_array(position), normal: DVec3::Y, force }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn forces_sum_to_the_contact_force(
        contacts in prop::collection::vec((0..N_JOINTS, prop::array::uniform3(-0.3..0.3f64), 0.0..50.0f64), 0..12),
        sigma in 1e-3..2e-2f64,
    ) {
        let model = HandModel::builtin(Side::Right);
        let contacts: Vec<_> = contacts.into_iter().map(|(link, at, force)| contact(link, at, force)).collect();
        let label = ForceSpreader::new(&model, sigma).unwrap().spread(&rest(&model), &contacts).unwrap();
        let expected: f64 = contacts.iter().map(|c| c.force).sum();
        let sum: f64 = label.force.iter().map(|f| f64::from(*f)).sum();
        prop_assert!((sum - expected).abs() <= 1e-6 * expected, "{sum} for {expected}");
        prop_assert!(label.sum_residual() <= 1e-6);
        prop_assert!(label.force.iter().all(|f| *f >= 0.0));
    }
}

#[test]
fn a_force_stays_on_the_vertices_of_its_link() {
    for side in Side::BOTH {
        let model = HandModel::builtin(side);
        let vertices = rest(&model);
        let links = link_vertices(&model);
        assert_eq!(links.iter().map(Vec::len).sum::<usize>(), vertices.len());
        let spreader = ForceSpreader::new(&model, SIGMA).unwrap();
        for (link, own) in links.iter().enumerate() {
            let at = vertices[own[0] as usize].as_dvec3().to_array();
            let label = spreader.spread(&vertices, &[contact(link, at, 2.0)]).unwrap();
            let on_link: f32 = own.iter().map(|v| label.force[*v as usize]).sum();
            assert_relative_eq!(on_link, 2.0, epsilon = 1e-5);
        }
    }
}

#[test]
fn link_and_region_agree_on_a_vertex_between_two_joints() {
    let mut model = HandModel::builtin(Side::Right);
    let vertex = model.tip_vertices[1];
    let row = &mut model.lbs_weights[vertex as usize * N_JOINTS..][..N_JOINTS];
    row.fill(0.0);
    (row[1], row[2]) = (0.5, 0.5);
    assert!(link_vertices(&model)[1].contains(&vertex));
    assert_eq!(model.regions()[vertex as usize], Region::IndexProximal);
}

#[test]
fn the_kernel_is_the_stated_gaussian() {
    let model = HandModel::builtin(Side::Right);
    let vertices = rest(&model);
    let own = &link_vertices(&model)[3];
    let at = vertices[own[0] as usize].as_dvec3();
    let label =
        ForceSpreader::new(&model, SIGMA).unwrap().spread(&vertices, &[contact(3, at.to_array(), 1.0)]).unwrap();
    let share = |v: u32| label.force[v as usize] / label.force[own[0] as usize];
    for &v in own {
        let distance = vertices[v as usize].as_dvec3().distance(at);
        let expected = (-0.5 * (distance / 0.004).powi(2)).exp() as f32;
        assert!((share(v) - expected).abs() < 1e-5, "{} for {expected} at {distance} m", share(v));
    }
}

#[test]
fn the_moment_residual_is_the_moment_of_the_spread_forces_about_the_contact() {
    let model = HandModel::builtin(Side::Right);
    let vertices = rest(&model);
    let at = vertices[link_vertices(&model)[6][0] as usize].as_dvec3();
    let one = LinkContact { link: 6, position: at, normal: DVec3::new(0.6, 0.8, 0.0), force: 3.0 };
    let label = ForceSpreader::new(&model, SIGMA).unwrap().spread(&vertices, &[one]).unwrap();
    let moment: DVec3 =
        vertices.iter().zip(&label.force).map(|(v, f)| (v.as_dvec3() - at).cross(one.normal * f64::from(*f))).sum();
    assert!((moment - label.moment_residual).length() < 1e-8);
    // The arm is at most two kernel widths, so the residual is small against force times finger length.
    assert!(label.moment_residual.length() < 3.0 * 2.0 * SIGMA);
}

#[test]
fn an_invalid_contact_is_refused_by_name() {
    let model = HandModel::builtin(Side::Left);
    let vertices = rest(&model);
    let spreader = ForceSpreader::new(&model, SIGMA).unwrap();
    let bad = [
        contact(N_JOINTS, [0.0; 3], 1.0),
        contact(0, [0.0; 3], -1.0),
        contact(0, [0.0; 3], f64::NAN),
        contact(0, [f64::INFINITY, 0.0, 0.0], 1.0),
    ];
    for contact in bad {
        assert!(spreader.spread(&vertices, &[contact]).unwrap_err().to_string().contains("contact"));
    }
    assert!(spreader.spread(&vertices[1..], &[]).is_err());
    assert!(ForceSpreader::new(&model, 0.0).is_err());
}

/// Returns a square of 10 cm in the plane z = 0, as two triangles.
fn square() -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let corner = |x: f32, y: f32| Vec3::new(x, y, 0.0);
    let vertices = vec![corner(0.0, 0.0), corner(0.1, 0.0), corner(0.1, 0.1), corner(0.0, 0.1)];
    (vertices, vec![[0, 1, 2], [0, 2, 3]])
}

#[test]
fn resampling_finds_contact_far_from_the_mesh_vertices() {
    let (vertices, triangles) = square();
    let coarse = SampledSurface::new(&vertices, &triangles, 1.0).unwrap();
    let fine = SampledSurface::new(&vertices, &triangles, 0.006).unwrap();
    let over_the_middle = Vec3::new(0.05, 0.05, 0.009);
    assert!(!coarse.is_within(over_the_middle, PROXIMITY));
    assert!(fine.is_within(over_the_middle, PROXIMITY));
    assert!(!fine.is_within(Vec3::new(0.05, 0.05, 0.0101), PROXIMITY));
    assert!(!fine.is_within(Vec3::new(0.05, 0.05, -0.5), PROXIMITY));
}

#[test]
fn resampled_points_are_at_most_the_spacing_apart() {
    let (vertices, triangles) = square();
    let surface = SampledSurface::new(&vertices, &triangles, 0.006).unwrap();
    for i in 0..=100 {
        for j in 0..=100 {
            let query = Vec3::new(i as f32 * 1e-3, j as f32 * 1e-3, 0.0);
            // A triangle's circumradius is below its longest edge over the square root of 3... for acute ones; half the
            // hypotenuse for the right triangles here.
            assert!(surface.is_within(query, 0.006 * 0.5 + 1e-5), "{query}");
        }
    }
}

#[test]
fn an_invalid_mesh_is_refused() {
    let (vertices, _) = square();
    assert!(SampledSurface::new(&vertices, &[[0, 1, 9]], 0.006).is_err());
    assert!(SampledSurface::new(&vertices, &[[0, 1, 2]], 0.0).is_err());
    assert!(SampledSurface::new(&[Vec3::NAN; 3], &[[0, 1, 2]], 0.006).is_err());
}
