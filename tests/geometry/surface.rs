//! Label (b) is the exact signed distance of a closed surface, and has no negative distances without an inside.

use std::f32::consts::{PI, TAU};
use std::f64::consts::PI as PI64;

use egotac::geometry::mesh::{MAX_COORDINATE, Sides};
use egotac::geometry::{HandSurface, PROXIMITY, SampledSurface, Solid, Surface};
use egotac::hand::{HandModel, HandParams, Side};
use glam::{DVec3, Quat, Vec3};
use parry3d::math::{Pose, Rotation, Vector};
use proptest::prelude::*;

type Mesh = (Vec<Vec3>, Vec<[u32; 3]>);

/// Returns a box around the origin, counter-clockwise seen from outside.
fn cuboid(half: Vec3) -> Mesh {
    let corners = (0..8).map(|i| {
        let sign = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        half * Vec3::new(sign(0), sign(1), sign(2))
    });
    let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
    (corners.collect(), quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect())
}

fn ball(radius: f32, rows: u32) -> Mesh {
    let mut vertices = vec![Vec3::Z * radius, Vec3::Z * -radius];
    for row in 1..rows {
        for column in 0..2 * rows {
            let (polar, azimuth) = (PI * row as f32 / rows as f32, TAU * column as f32 / (2 * rows) as f32);
            vertices.push(radius * Vec3::new(polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos()));
        }
    }
    let at = |row: u32, column: u32| 2 + (row - 1) * 2 * rows + column % (2 * rows);
    let mut triangles = Vec::new();
    for column in 0..2 * rows {
        triangles.push([0, at(1, column), at(1, column + 1)]);
        triangles.push([1, at(rows - 1, column + 1), at(rows - 1, column)]);
        for row in 1..rows - 1 {
            let (a, b, c, d) = (at(row, column), at(row, column + 1), at(row + 1, column), at(row + 1, column + 1));
            triangles.extend([[a, c, d], [a, d, b]]);
        }
    }
    (vertices, triangles)
}

fn flipped((vertices, triangles): Mesh) -> Mesh {
    (vertices, triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect())
}

fn joined(parts: impl IntoIterator<Item = (Mesh, Vec3)>) -> Mesh {
    let (mut vertices, mut triangles) = Mesh::default();
    for ((v, t), shift) in parts {
        let first = vertices.len() as u32;
        vertices.extend(v.into_iter().map(|v| v + shift));
        triangles.extend(t.into_iter().map(|t| t.map(|index| index + first)));
    }
    (vertices, triangles)
}

fn surface((vertices, triangles): Mesh) -> Surface {
    Surface::new(vertices, triangles).unwrap()
}

fn box_distance(half: DVec3, point: DVec3) -> f64 {
    let q = point.abs() - half;
    q.max(DVec3::ZERO).length() + q.max_element().min(0.0)
}

/// Computes the distance of a point from a triangle by its seven regions, an algorithm independent of the library's.
fn triangle_distance([a, b, c]: [DVec3; 3], p: DVec3) -> f64 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return ap.length();
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return bp.length();
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (ap - ab * (d1 / (d1 - d3))).length();
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return cp.length();
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (ap - ac * (d2 / (d2 - d6))).length();
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return (bp - (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))).length();
    }
    let sum = va + vb + vc;
    (ap - ab * (vb / sum) - ac * (vc / sum)).length()
}

/// Computes the winding number as the sum of solid angles.
fn winding((vertices, triangles): &Mesh, p: DVec3) -> f64 {
    let angles = triangles.iter().map(|t| {
        let [a, b, c] = t.map(|i| vertices[i as usize].as_dvec3() - p);
        let (la, lb, lc) = (a.length(), b.length(), c.length());
        2.0 * a.dot(b.cross(c)).atan2(la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb)
    });
    angles.sum::<f64>() / (4.0 * PI64)
}

fn brute((vertices, triangles): &Mesh, p: DVec3) -> f64 {
    let distance = |t: &[u32; 3]| triangle_distance(t.map(|i| vertices[i as usize].as_dvec3()), p);
    let nearest = triangles.iter().map(distance).fold(f64::INFINITY, f64::min);
    if winding(&(vertices.clone(), triangles.clone()), p) > 0.5 { -nearest } else { nearest }
}

#[test]
fn a_box_mesh_has_the_distances_of_a_box() {
    let half = Vec3::new(0.02, 0.03, 0.05);
    let surface = surface(cuboid(half));
    assert_eq!(surface.sides(), Sides::Closed);
    for i in 0..9 * 9 * 9 {
        // Points on the box's lattice send rays through corners, edges and diagonals of faces.
        let p = half * (Vec3::new((i % 9) as f32, (i / 9 % 9) as f32, (i / 81) as f32) - Vec3::splat(4.0)) / 2.0;
        let (got, expected) = (surface.distance(p, 1.0), box_distance(half.as_dvec3(), p.as_dvec3()));
        assert!((f64::from(got) - expected).abs() < 1e-8, "{p}: {got} m instead of {expected} m");
    }
}

#[test]
fn balls_boxes_and_capsules_have_their_closed_form_distances_in_any_pose() {
    let turn = Quat::from_rotation_arc(Vec3::Z, Vec3::new(1.0, 2.0, -2.0) / 3.0);
    let (shift, half) = (Vec3::new(0.1, -0.05, 0.2), Vec3::new(0.02, 0.03, 0.01));
    let pose =
        Pose::from_parts(Vector::new(shift.x, shift.y, shift.z), Rotation::from_xyzw(turn.x, turn.y, turn.z, turn.w));
    type Add<'a> = &'a dyn Fn(&mut Solid);
    type Formula<'a> = &'a dyn Fn(DVec3) -> f64;
    let solids: [(Add, Formula); 3] = [
        (&|solid| solid.add_ball(0.03, pose).unwrap(), &|p| p.length() - 0.03),
        (&|solid| solid.add_cuboid(half, pose).unwrap(), &|p| box_distance(half.as_dvec3(), p)),
        (&|solid| solid.add_capsule(0.04, 0.01, pose).unwrap(), &|p| {
            (p - DVec3::Z * p.z.clamp(-0.04, 0.04)).length() - 0.01
        }),
    ];
    for (index, (add, formula)) in solids.iter().enumerate() {
        let mut solid = Solid::default();
        add(&mut solid);
        for i in 0..1000 {
            let f = |k: i32| ((i * k % 101) as f32 / 101.0 - 0.5) * 0.15;
            let local = Vec3::new(f(17), f(29), f(61));
            let got = f64::from(solid.distance(turn * local + shift, 1.0));
            assert!((got - formula(local.as_dvec3())).abs() < 1e-6, "{index}, {local}: {got}");
        }
    }
}

#[test]
fn a_union_has_the_distance_of_its_nearest_shape_and_is_solid_inside_each() {
    let mut solid = Solid::from_mesh(surface(cuboid(Vec3::splat(0.02))));
    solid.add_ball(0.02, Pose::from_translation(Vector::new(0.03, 0.0, 0.0))).unwrap();
    assert!((solid.distance(Vec3::X * 0.06, 1.0) - 0.01).abs() < 1e-7);
    assert!((solid.distance(Vec3::X * -0.05, 1.0) - 0.03).abs() < 1e-7);
    // The overlap of two shapes has no outside; deep inside, a small cutoff does not hide the distance.
    for step in -19..=49 {
        assert!(solid.distance(Vec3::X * 1e-3 * step as f32, 1e-3) <= 0.0, "{step} mm");
    }
    assert_eq!(solid.distance(Vec3::X * 0.06, 0.0099), f32::INFINITY);
    assert!(solid.distance(Vec3::NAN, 1.0).is_nan());
    assert!(Solid::default().add_ball(f32::NAN, Pose::IDENTITY).is_err());
    assert!(Solid::default().add_cuboid(Vec3::new(1.0, 0.0, 1.0), Pose::IDENTITY).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn distances_equal_a_brute_force_search_over_all_triangles(
        rows in 3..7u32,
        bumps in prop::collection::vec(0.5..1.5f32, 74),
        second in prop::array::uniform3(-0.06..0.06f32),
        points in prop::collection::vec(prop::array::uniform3(-0.12..0.12f32), 40),
    ) {
        // Two balls with bumps, which may overlap.
        let (vertices, triangles) = ball(0.05, rows);
        let bumpy = vertices.iter().zip(&bumps).map(|(v, bump)| *v * *bump).collect();
        let mesh = joined([((bumpy, triangles), Vec3::ZERO), (ball(0.04, 5), Vec3::from_array(second))]);
        let surface = surface(mesh.clone());
        prop_assert_eq!(surface.sides(), Sides::Closed);
        for point in points.into_iter().map(Vec3::from_array) {
            let expected = brute(&mesh, point.as_dvec3());
            let got = f64::from(surface.distance(point, 1.0));
            prop_assert!((got - expected).abs() < 1e-7, "{point}: {got} m instead of {expected} m");
            let near = f64::from(surface.distance(point, 0.01));
            prop_assert!(near == got && got <= 0.01 + 1e-9 || near.is_infinite() && got > 0.01 - 1e-9, "{near}, {got}");
        }
    }

    /// A ball that the solid can't reach has no point within reach: what it spares is never a contact.
    #[test]
    fn a_ball_out_of_reach_holds_no_near_point(
        centre in prop::array::uniform3(-0.08f32..0.08), radius in 0.001f32..0.03, reach in 0.0f32..0.02,
        directions in prop::collection::vec(prop::array::uniform3(-1.0f32..1.0), 40),
    ) {
        let mut solid = Solid::from_mesh(surface(ball(0.02, 8)));
        solid.add_cuboid(Vec3::new(0.01, 0.02, 0.005), Pose::translation(0.03, 0.0, 0.0)).unwrap();
        let centre = Vec3::from_array(centre);
        let near = directions.into_iter().map(|way| centre + radius * Vec3::from_array(way).normalize_or_zero());
        let touches = near.into_iter().any(|point| solid.distance(point, reach) <= reach);
        prop_assert!(!touches || solid.may_reach(centre, radius + 1e-5, reach));
        prop_assert!(!solid.may_reach(centre + Vec3::X, radius, reach), "a ball a metre away");
    }

    #[test]
    fn a_triangle_soup_has_distances_but_no_inside(
        corners in prop::collection::vec(prop::array::uniform3(-0.05..0.05f32), 9..60),
        points in prop::collection::vec(prop::array::uniform3(-0.08..0.08f32), 20),
    ) {
        let vertices: Vec<Vec3> = corners.into_iter().map(Vec3::from_array).collect();
        let triangles: Vec<[u32; 3]> = (0..vertices.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let surface = surface((vertices.clone(), triangles.clone()));
        prop_assert_eq!(surface.sides(), Sides::Open { edges: 3 * triangles.len() });
        for point in points.into_iter().map(Vec3::from_array) {
            let all = triangles.iter().map(|t| triangle_distance(t.map(|i| vertices[i as usize].as_dvec3()), point.as_dvec3()));
            let expected = all.fold(f64::INFINITY, f64::min);
            prop_assert!((f64::from(surface.distance(point, 1.0)) - expected).abs() < 1e-7);
        }
    }
}

#[test]
fn a_point_beside_another_has_the_same_distance_as_alone() {
    let scattered = |k: usize| Vec3::new((k as f32 * 0.731).sin(), (k as f32 * 1.37).cos(), (k as f32 * 2.11).sin());
    let two = joined([(ball(0.05, 12), Vec3::ZERO), (cuboid(Vec3::new(0.01, 0.04, 0.02)), Vec3::X * 0.08)]);
    let open = (two.0.clone(), two.1[1..].to_vec());
    for surface in [surface(two), surface(open)] {
        let mut previous = Vec3::splat(0.03);
        let mut inside = 0;
        for k in 0..2000 {
            // Steps of 0.1 mm to 0.2 m.
            let point = match k % 3 {
                0 => previous + 1e-4 * scattered(k),
                1 => previous + 0.01 * scattered(k),
                _ => 0.1 * scattered(k),
            };
            let mut known = None;
            surface.distance_beside(previous, f32::MAX, &mut known);
            for cutoff in [0.01, 0.05, f32::MAX] {
                let (alone, beside) =
                    (surface.distance(point, cutoff), surface.distance_beside(point, cutoff, &mut { known }));
                assert!(alone == beside, "{beside} m instead of {alone} m at {point} beside {previous}: {known:?}");
                inside += usize::from(alone < 0.0);
            }
            previous = point;
        }
        assert!(!surface.sides().is_known() || inside > 100, "{inside}");
    }
}

#[test]
fn rays_through_vertices_and_edges_give_the_right_side() {
    // Naive counting of crossings fails for rays through corners and along edges and faces.
    let mesh = ball(0.05, 12);
    let surface = surface(mesh.clone());
    for vertex in &mesh.0 {
        for x in [-0.06f32, -0.03, -0.01, 0.0, 0.02, 0.04, 0.06] {
            let point = vertex.with_x(x);
            let expected = winding(&mesh, point.as_dvec3()).round() as i32;
            if brute(&mesh, point.as_dvec3()).abs() > 1e-7 {
                assert_eq!(surface.winding(point), expected, "{point}");
            }
        }
    }
}

#[test]
fn orientation_decides_if_an_inner_shell_is_solid_or_a_cavity() {
    let inner = ball(0.02, 8);
    let hollow = surface(joined([(ball(0.05, 8), Vec3::ZERO), (flipped(inner.clone()), Vec3::ZERO)]));
    assert_eq!(hollow.sides(), Sides::Closed);
    assert!(hollow.distance(Vec3::ZERO, 1.0) > 0.0 && hollow.distance(Vec3::X * 0.035, 1.0) < 0.0);
    let doubly = surface(joined([(ball(0.05, 8), Vec3::ZERO), (inner.clone(), Vec3::ZERO)]));
    assert!(doubly.distance(Vec3::ZERO, 1.0) < 0.0 && doubly.winding(Vec3::ZERO) == 2);
    // Outside of the other shell it bounds no cavity, so it is inside out.
    let beside = surface(joined([(ball(0.05, 8), Vec3::ZERO), (flipped(inner), Vec3::X * 0.2)]));
    assert_eq!(beside.sides(), Sides::InsideOut { shells: 1 });
}

#[test]
fn a_surface_without_an_inside_names_the_reason_and_has_no_negative_distance() {
    let (vertices, mut triangles) = cuboid(Vec3::splat(0.02));
    let whole = (vertices.clone(), triangles.clone());
    let removed = triangles.pop().unwrap();
    let open = (vertices.clone(), triangles.clone());
    triangles.push([removed[0], removed[2], removed[1]]);
    let twisted = (vertices, triangles);
    for (mesh, sides) in [
        (open, Sides::Open { edges: 3 }),
        (twisted, Sides::Twisted { edges: 3 }),
        (flipped(whole), Sides::InsideOut { shells: 1 }),
    ] {
        let surface = surface(mesh);
        assert_eq!(surface.sides(), sides);
        assert!((surface.distance(Vec3::ZERO, 1.0) - 0.02).abs() < 1e-8, "{sides:?}");
        assert!((surface.distance(Vec3::X * 0.03, 1.0) - 0.01).abs() < 1e-8, "{sides:?}");
    }
}

#[test]
fn triangles_without_area_and_duplicate_vertices_change_nothing() {
    let half = Vec3::new(0.02, 0.03, 0.05);
    let (vertices, triangles) = cuboid(half);
    // Each triangle has corners of its own; a point, a segment and a collinear triangle lie on the surface.
    let mut soup: Vec<Vec3> = triangles.iter().flatten().map(|index| vertices[*index as usize]).collect();
    let mut own: Vec<[u32; 3]> = (0..soup.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let next = soup.len() as u32;
    soup.extend([half, half, half, half * Vec3::new(0.5, 1.0, 1.0), half * Vec3::new(0.25, 1.0, 1.0)]);
    own.extend([[0, 0, 0], [0, 0, 1], [next, next + 1, next + 2]]);
    let surface = surface((soup.clone(), own.clone()));
    assert_eq!(surface.sides(), Sides::Closed);
    for i in 0..500 {
        let f = |k: i32| ((i * k % 97) as f32 / 97.0 - 0.5) * 0.2;
        let p = Vec3::new(f(13), f(31), f(59));
        assert!(
            (f64::from(surface.distance(p, 1.0)) - box_distance(half.as_dvec3(), p.as_dvec3())).abs() < 1e-8,
            "{p}"
        );
    }
    // A collinear triangle alone counts as the segment that it covers.
    let line = surface_of_line();
    assert!((line.distance(Vec3::new(0.5, 0.1, 0.0), 1.0) - 0.1).abs() < 1e-7);
    assert!((line.distance(Vec3::new(-0.3, 0.4, 0.0), 1.0) - 0.5).abs() < 1e-7);
}

fn surface_of_line() -> Surface {
    surface((vec![Vec3::ZERO, Vec3::X, Vec3::X * 0.5], vec![[0, 1, 2]]))
}

#[test]
fn sizes_from_a_millimetre_to_ten_metres_keep_their_accuracy() {
    for size in [1e-3f32, 1e-2, 1.0, 10.0] {
        let half = Vec3::new(1.0, 0.5, 0.25) * size;
        for shift in [Vec3::ZERO, Vec3::new(3.0, -2.0, 1.0)] {
            let (vertices, triangles) = cuboid(half);
            let surface = surface((vertices.iter().map(|v| *v + shift).collect(), triangles));
            assert_eq!(surface.sides(), Sides::Closed, "{size} m at {shift}");
            let p = half * Vec3::new(1.5, 0.1, -0.9);
            let expected = box_distance(half.as_dvec3(), p.as_dvec3());
            let got = f64::from(surface.distance(p + shift, 100.0));
            assert!((got - expected).abs() < 3e-7 * f64::from(size + shift.length()) + 1e-9, "{size}: {got}");
            assert!(surface.distance(shift, 100.0) < 0.0);
        }
    }
}

#[test]
fn an_invalid_mesh_is_refused_by_name() {
    let (vertices, triangles) = cuboid(Vec3::splat(0.02));
    let broken = |index: usize, value: Vec3| {
        let mut vertices = vertices.clone();
        vertices[index] = value;
        Surface::new(vertices, triangles.clone()).unwrap_err().to_string()
    };
    assert!(broken(3, Vec3::NAN).contains("vertex 3"));
    assert!(broken(5, Vec3::X * f32::INFINITY).contains("vertex 5"));
    assert!(broken(0, Vec3::X * 2.0 * MAX_COORDINATE).contains("vertex 0"));
    assert!(Surface::new(vertices.clone(), vec![[0, 1, 8]]).unwrap_err().to_string().contains("triangle index"));
    assert!(Surface::new(vertices.clone(), vec![]).unwrap_err().to_string().contains("triangles"));
    let mut surface = Surface::new(vertices.clone(), triangles.clone()).unwrap();
    assert!(surface.set_vertices(&vertices[1..]).is_err());
    assert!(surface.set_vertices(&[Vec3::NAN; 8]).is_err());
    assert!(surface.distance(Vec3::NEG_INFINITY, 1.0).is_nan());
    // The spacing would give more than four million points.
    assert!(SampledSurface::new(&vertices, &triangles, 1e-6).unwrap_err().to_string().contains("spacing"));
}

#[test]
fn recall_of_the_vertex_rule_grows_with_finer_points() {
    let (vertices, triangles) = cuboid(Vec3::new(0.03, 0.04, 0.02));
    let surface = surface((vertices.clone(), triangles.clone()));
    let skin: Vec<Vec3> = ball(0.045, 40).0;
    let near: Vec<Vec3> = skin.into_iter().filter(|v| surface.distance(*v, 1.0) <= PROXIMITY).collect();
    assert!(near.len() > 500);
    let recall = |spacing: f32| {
        let points = SampledSurface::new(&vertices, &triangles, spacing).unwrap();
        let found = near.iter().filter(|v| points.is_within(**v, PROXIMITY)).count();
        // A point far from the surface is near none of its samples.
        assert!(near.iter().all(|v| points.distance(*v, 1.0) >= surface.distance(*v, 1.0).abs() - 1e-7));
        (points.points().len(), found as f64 / near.len() as f64)
    };
    let all = [0.1, 0.03, 0.015, 0.006, 0.002].map(recall);
    assert!(all.windows(2).all(|pair| pair[0].0 < pair[1].0 && pair[0].1 < pair[1].1), "{all:?}");
    assert!(all[0].1 < 0.3 && all[3].1 > 0.9 && all[4].1 > 0.98, "{all:?}");
}

#[test]
fn sampled_distances_equal_a_search_over_all_points() {
    let (vertices, triangles) = cuboid(Vec3::new(0.03, 0.04, 0.02));
    let mut surface = SampledSurface::new(&vertices, &triangles, 0.007).unwrap();
    let moved: Vec<Vec3> = surface.points().iter().map(|p| Quat::from_rotation_x(0.4) * *p + Vec3::Y * 0.01).collect();
    for turn in 0..2 {
        for i in 0..300 {
            let f = |k: i32| ((i * k % 83) as f32 / 83.0 - 0.5) * 0.15;
            let query = Vec3::new(f(11), f(37), f(53));
            let nearest = surface.points().iter().map(|p| p.distance(query)).fold(f32::INFINITY, f32::min);
            assert_eq!(surface.distance(query, 1.0), nearest, "{turn}");
            assert_eq!(surface.distance(query, 0.02), if nearest <= 0.02 { nearest } else { f32::INFINITY });
            assert_eq!(surface.is_within(query, 0.02), nearest <= 0.02);
        }
        surface.set_points(&moved).unwrap();
    }
    assert!(surface.set_points(&moved[1..]).is_err());
    assert!(surface.distance(Vec3::NAN, 1.0).is_nan());
}

fn bent(side: Side, angle: f32) -> Vec<Vec3> {
    let mut params = HandParams::default();
    let mirror = if side == Side::Left { -1.0 } else { 1.0 };
    params.hand_pose.iter_mut().for_each(|joint| *joint = Vec3::Z * angle * mirror);
    HandModel::builtin(side).forward(&params).vertices
}

#[test]
fn mirrored_hands_are_equally_far_from_each_other() {
    // Palm to palm, with the plane of symmetry between the fingertips.
    let mut hands = Side::BOTH.map(|side| HandSurface::new(&HandModel::builtin(side), 0.006).unwrap());
    let [left, right] = Side::BOTH.map(|side| bent(side, 0.3));
    let reach = right.iter().map(|v| v.x).fold(f32::INFINITY, f32::min);
    let shift = Vec3::X * (-reach - 0.004);
    let right: Vec<Vec3> = right.iter().map(|v| *v + shift).collect();
    let left: Vec<Vec3> = left.iter().map(|v| *v - shift).collect();
    hands[0].set_vertices(&left).unwrap();
    hands[1].set_vertices(&right).unwrap();
    assert_eq!(hands[0].surface().sides(), Sides::Closed);
    let mut touching = 0;
    for (l, r) in left.iter().zip(&right) {
        assert!((*l - *r * Vec3::new(-1.0, 1.0, 1.0)).length() < 1e-5, "not a mirror image: {l} and {r}");
        let (of_left, of_right) = (hands[1].surface().distance(*l, 0.05), hands[0].surface().distance(*r, 0.05));
        let both_far = of_left.is_infinite() && of_right.is_infinite();
        assert!(both_far || (of_left - of_right).abs() < 2e-5, "{of_left} and {of_right}");
        touching += usize::from(of_left < 0.0);
        let (a, b) = (hands[1].points().distance(*l, 0.05), hands[0].points().distance(*r, 0.05));
        assert!(a >= of_left - 1e-6 && (a - b).abs() < 4e-3 || a.is_infinite(), "{a} and {b}");
    }
    assert!(touching > 5, "{touching}");
}

#[test]
fn a_moved_surface_equals_a_new_one() {
    let model = HandModel::builtin(Side::Right);
    let posed = bent(Side::Right, 0.9);
    let mut moved = HandSurface::new(&model, 0.006).unwrap();
    moved.set_vertices(&posed).unwrap();
    let fresh = Surface::new(posed.clone(), model.faces.clone()).unwrap();
    for i in 0..2000 {
        let f = |k: i32| ((i * k % 499) as f32 / 499.0 - 0.5) * 0.25;
        let p = posed[i as usize % posed.len()] + Vec3::new(f(17), f(101), f(211)) * 0.2;
        assert_eq!(moved.surface().distance(p, 0.03), fresh.distance(p, 0.03));
    }
    assert!(moved.set_vertices(&posed[1..]).is_err());
}

#[test]
fn a_hand_that_is_open_at_the_wrist_is_closed_there() {
    // Like MANO's: without the triangles around the vertex farthest from the fingers.
    let mut model = HandModel::builtin(Side::Right);
    let wrist = (0..model.v_template.len()).max_by(|a, b| model.v_template[*a].x.total_cmp(&model.v_template[*b].x));
    let wrist = wrist.unwrap() as u32;
    let before = model.faces.len();
    model.faces.retain(|face| !face.contains(&wrist));
    assert!(model.faces.len() < before);
    let rest = model.forward(&HandParams::default()).vertices;
    assert!(!Surface::new(rest.clone(), model.faces.clone()).unwrap().sides().is_known());
    let skin = HandSurface::new(&model, 0.006).unwrap();
    assert_eq!(skin.surface().sides(), Sides::Closed);
    let palm =
        model.forward(&HandParams::default()).joints[4].lerp(model.forward(&HandParams::default()).joints[0], 0.4);
    assert!(skin.surface().distance(palm, 1.0) < 0.0);
}
