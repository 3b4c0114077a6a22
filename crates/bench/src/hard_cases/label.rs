//! Labels on faulty meshes and points.

use egotac::error::Result;
use egotac::geometry::{ForceSpreader, LinkContact, SIGMA, SampledSurface, resample};
use egotac::hand::{HandModel, HandParams, N_VERTICES, Side, vertex_areas, vertex_normals};
use glam::{DVec3, Vec3};

use super::{Family, HardCase, Outcome, accepted};

const FAMILY: Family = Family::Label;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case(
        "far_contact",
        "a contact 10 m from the hand: every Gaussian weight underflows, and 0 / 0 is shared out",
        "weights relative to the nearest vertex",
        far_contact,
    ),
    FAMILY.case(
        "coincident_vertices",
        "all vertices of the hand and a contact at the same place",
        "none needed",
        coincident_vertices,
    ),
    FAMILY.case(
        "normals_without_area",
        "vertices whose triangles have no area, normalised as they are",
        "a normal of zero",
        normals_without_area,
    ),
    FAMILY.case(
        "broken_surface",
        "distance label of a surface with a hole, faces inwards, and triangles without area",
        "none needed: the label takes points, not sides",
        broken_surface,
    ),
    FAMILY.case(
        "surface_of_10_m",
        "a cube of 10 m sampled at 6 mm: 33 million points",
        "a spacing of 50 mm",
        surface_of_10_m,
    ),
    FAMILY.case("surface_of_1_mm", "a cube of 1 mm sampled at 6 mm", "none needed", surface_of_1_mm),
    FAMILY.case("astronomic_surface", "a triangle of 1e30 m sampled at 6 mm", "a triangle of 100 mm", astronomic),
];

fn contact(position: DVec3) -> LinkContact {
    LinkContact { link: 3, position, normal: DVec3::Y, force: 2.0 }
}

fn far_contact() -> Result<Outcome> {
    let model = HandModel::builtin(Side::Right);
    let vertices = model.forward(&HandParams::default()).vertices;
    let far = DVec3::new(10.0, 0.0, 0.0);
    let weight = |v: &Vec3| (-v.as_dvec3().distance_squared(far) / (2.0 * SIGMA * SIGMA)).exp();
    let all: f64 = vertices.iter().map(weight).sum();
    let plain: f64 = vertices.iter().map(|v| 2.0 * weight(v) / all).sum();
    let label = ForceSpreader::new(&model, SIGMA)?.spread(&vertices, &[contact(far)])?;
    Ok(Outcome {
        error_of: "sum of the forces, relative",
        tolerance: 1e-6,
        unguarded: Some((plain - 2.0).abs() / 2.0),
        guard: "not used: no part of egotac has this formula".into(),
        remedied: label.sum_residual(),
        remedied_guard: String::new(),
    })
}

fn coincident_vertices() -> Result<Outcome> {
    let model = HandModel::builtin(Side::Right);
    let spreader = ForceSpreader::new(&model, SIGMA)?;
    let residual =
        |vertices: &[Vec3]| Ok::<_, egotac::Error>(spreader.spread(vertices, &[contact(DVec3::ZERO)])?.sum_residual());
    Ok(Outcome {
        error_of: "sum of the forces, relative",
        tolerance: 1e-6,
        unguarded: Some(residual(&[Vec3::ZERO; N_VERTICES])?),
        guard: String::new(),
        remedied: residual(&model.forward(&HandParams::default()).vertices)?,
        remedied_guard: String::new(),
    })
}

/// Returns a square of 100 mm at z = 0, and beside it a triangle without area and one of three coincident corners.
fn square() -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let corner = |x: f32, y: f32| Vec3::new(x, y, 0.0);
    let mut vertices = vec![corner(0.0, 0.0), corner(0.1, 0.0), corner(0.1, 0.1), corner(0.0, 0.1)];
    vertices.extend([corner(0.2, 0.0), corner(0.25, 0.0), corner(0.3, 0.0)]);
    (vertices, vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 4, 4]])
}

fn normals_without_area() -> Result<Outcome> {
    let (vertices, faces) = square();
    // Normalising a vector of length 0 gives NaN.
    let plain = vertices[4..].iter().map(|v| (0.0 * *v).normalize()).filter(|n| !n.is_finite()).count();
    let normals = vertex_normals(&vertices, &faces);
    let wrong = normals.iter().enumerate().filter(|(i, n)| **n != if *i < 4 { Vec3::Z } else { Vec3::ZERO }).count();
    let area: f32 = vertex_areas(&vertices, &faces).iter().sum();
    Ok(Outcome {
        error_of: "normals that are wrong",
        tolerance: 0.0,
        unguarded: Some(plain as f64),
        guard: "not used: no part of egotac has this formula".into(),
        remedied: wrong as f64 + f64::from((area - 0.01).abs() > 1e-7),
        remedied_guard: String::new(),
    })
}

fn broken_surface() -> Result<Outcome> {
    let (vertices, faces) = square();
    let inside_out: Vec<[u32; 3]> = faces.iter().map(|[a, b, c]| [*a, *c, *b]).collect();
    let open: Vec<[u32; 3]> = faces[..1].to_vec();
    // Exact answers for the square, and for the half of it that a hole leaves.
    let wrong = |faces: &[[u32; 3]], half: bool| -> Result<usize> {
        let surface = SampledSurface::new(&vertices[..7], faces, 0.002)?;
        let mut wrong = 0;
        for i in 0..40 {
            for j in 0..40 {
                let query = Vec3::new(0.0025 * i as f32, 0.0025 * j as f32, 0.008);
                let on_it = !half || query.y <= query.x;
                let beyond = half && query.y > query.x + 0.01;
                let found = surface.is_within(query, 0.01);
                wrong += usize::from((on_it && !found) || (beyond && found));
            }
        }
        Ok(wrong)
    };
    let unguarded = wrong(&inside_out, false)? + wrong(&open, true)?;
    Ok(Outcome {
        error_of: "queries answered wrongly, of 3200",
        tolerance: 0.0,
        unguarded: Some(unguarded as f64),
        guard: String::new(),
        remedied: wrong(&faces, false)? as f64,
        remedied_guard: String::new(),
    })
}

fn cube(edge: f32) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let corner = |i: u32| Vec3::new((i & 1) as f32 - 0.5, (i >> 1 & 1) as f32 - 0.5, (i >> 2) as f32 - 0.5) * edge;
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    ((0..8).map(corner).collect(), quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect())
}

/// Returns the outcome for a surface that must be refused, because sampling it would take all memory.
fn sampled(bad: Result<SampledSurface>, good: &SampledSurface, above: f32) -> Outcome {
    let (through, guard) = accepted([bad]);
    let near = good.is_within(Vec3::new(0.0, 0.0, above + 0.009), 0.01 + 0.5 * good.spacing());
    let far = good.is_within(Vec3::new(0.0, 0.0, above + 0.011 + 0.5 * good.spacing()), 0.01);
    Outcome {
        error_of: "queries answered wrongly",
        tolerance: 0.0,
        unguarded: None,
        guard: if through > 0.0 { String::new() } else { guard },
        remedied: f64::from(!near) + f64::from(far),
        remedied_guard: String::new(),
    }
}

fn surface_of_10_m() -> Result<Outcome> {
    let (vertices, faces) = cube(10.0);
    let good = SampledSurface::new(&vertices, &faces, 0.05)?;
    Ok(sampled(SampledSurface::new(&vertices, &faces, 0.006), &good, 5.0))
}

fn surface_of_1_mm() -> Result<Outcome> {
    let (vertices, faces) = cube(0.001);
    let wrong = |spacing: f32| -> Result<f64> {
        let surface = SampledSurface::new(&vertices, &faces, spacing)?;
        let at = |distance: f32| surface.is_within(Vec3::new(5e-4, 5e-4, 5e-4 + distance), 0.01);
        Ok(f64::from(!at(0.0099)) + f64::from(at(0.0101)))
    };
    Ok(Outcome {
        error_of: "queries answered wrongly",
        tolerance: 0.0,
        unguarded: Some(wrong(0.006)?),
        guard: String::new(),
        remedied: wrong(0.0001)?,
        remedied_guard: String::new(),
    })
}

fn astronomic() -> Result<Outcome> {
    let triangle = |size: f32| vec![Vec3::ZERO, Vec3::X * size, Vec3::Y * size];
    let good = SampledSurface::from_points(resample(&triangle(0.1), &[[0, 1, 2]], 0.006)?, 0.006)?;
    Ok(sampled(SampledSurface::new(&triangle(1e30), &[[0, 1, 2]], 0.006), &good, 0.0))
}
