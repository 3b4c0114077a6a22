//! The built-in hand is a closed, smooth, human-sized surface that bends like a hand.

use std::collections::{BTreeMap, BTreeSet};

use egotac::hand::{
    HandModel, HandParams, N_BETAS, N_JOINTS, N_VERTICES, PosedHand, Region, Side, Topology, build, edges,
    vertex_areas, vertex_normals,
};
use glam::{Quat, Vec3};
use robust::{Coord3D, orient3d};

fn rest(model: &HandModel) -> PosedHand {
    model.forward(&HandParams::default())
}

#[test]
fn surface_is_closed_and_of_genus_zero() {
    for side in Side::BOTH {
        let hand = HandModel::builtin(side);
        assert_eq!(hand.v_template.len(), N_VERTICES);
        assert_eq!(hand.topology, Topology::EgotacHand1);
        let mut directed = BTreeSet::new();
        for &[a, b, c] in &hand.faces {
            for edge in [(a, b), (b, c), (c, a)] {
                assert!(directed.insert(edge), "{edge:?} runs twice the same way: not an oriented manifold");
            }
        }
        assert!(directed.iter().all(|&(a, b)| directed.contains(&(b, a))), "an edge is open");
        let euler = N_VERTICES as i64 - edges(&hand.faces).len() as i64 + hand.faces.len() as i64;
        assert_eq!(euler, 2);
        assert!(every_vertex_has_one_fan(&hand.faces));
    }
}

/// Returns true if the faces at each vertex form a single fan, so that the surface touches itself at no vertex.
fn every_vertex_has_one_fan(faces: &[[u32; 3]]) -> bool {
    let mut next_around: BTreeMap<u32, BTreeMap<u32, u32>> = BTreeMap::new();
    for &[a, b, c] in faces {
        for (centre, from, to) in [(a, b, c), (b, c, a), (c, a, b)] {
            next_around.entry(centre).or_default().insert(from, to);
        }
    }
    next_around.values().all(|next| {
        let Some((&start, _)) = next.first_key_value() else { return false };
        let mut at = next[&start];
        let mut length = 1;
        while at != start && length <= next.len() {
            at = next[&at];
            length += 1;
        }
        length == next.len()
    })
}

#[test]
fn faces_point_outwards() {
    for side in Side::BOTH {
        let hand = HandModel::builtin(side);
        let volume: f32 = hand
            .faces
            .iter()
            .map(|f| {
                let [a, b, c] = f.map(|v| hand.v_template[v as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        // A medium adult hand holds 0.3 to 0.5 litres.
        assert!((3e-4..5e-4).contains(&volume), "volume {volume} m³");
    }
}

#[test]
fn rest_pose_does_not_intersect_itself() {
    let hand = HandModel::builtin(Side::Right);
    assert_eq!(intersecting_pairs(&hand.v_template, &hand.faces), Vec::<(usize, usize)>::new());
}

#[test]
fn intersection_test_finds_a_pierced_surface() {
    let hand = HandModel::builtin(Side::Right);
    let mut vertices = hand.v_template.clone();
    // Push a fingertip through the palm.
    let tip = hand.tip_vertices[1] as usize;
    vertices[tip] = Vec3::new(0.05, 0.08, 0.0);
    assert!(!intersecting_pairs(&vertices, &hand.faces).is_empty());
}

/// Pairs of faces that cross, by exact predicates: an edge of one passes through the other.
fn intersecting_pairs(vertices: &[Vec3], faces: &[[u32; 3]]) -> Vec<(usize, usize)> {
    let bounds: Vec<(Vec3, Vec3)> = faces
        .iter()
        .map(|face| {
            let [a, b, c] = face.map(|v| vertices[v as usize]);
            (a.min(b).min(c), a.max(b).max(c))
        })
        .collect();
    let mut pairs = Vec::new();
    for i in 0..faces.len() {
        for j in i + 1..faces.len() {
            let apart = bounds[i].0.cmpgt(bounds[j].1).any() || bounds[j].0.cmpgt(bounds[i].1).any();
            if !apart && (pierces(vertices, &faces[i], &faces[j]) || pierces(vertices, &faces[j], &faces[i])) {
                pairs.push((i, j));
            }
        }
    }
    pairs
}

/// Returns true if an edge of `needle` that shares no vertex with `cloth` passes through it.
fn pierces(vertices: &[Vec3], needle: &[u32; 3], cloth: &[u32; 3]) -> bool {
    let coord = |v: u32| {
        let [x, y, z] = vertices[v as usize].to_array().map(f64::from);
        Coord3D { x, y, z }
    };
    let sign = |a, b, c, d| orient3d(coord(a), coord(b), coord(c), coord(d)).partial_cmp(&0.0).unwrap();
    let [a, b, c] = *cloth;
    (0..3).any(|k| {
        let (p, q) = (needle[k], needle[(k + 1) % 3]);
        if cloth.contains(&p) || cloth.contains(&q) {
            return false;
        }
        let through = [sign(p, q, a, b), sign(p, q, b, c), sign(p, q, c, a)];
        sign(a, b, c, p) != sign(a, b, c, q) && through[0] == through[1] && through[1] == through[2]
    })
}

#[test]
fn neighbouring_faces_never_fold_back() {
    let hand = HandModel::builtin(Side::Right);
    let mut normal_at: BTreeMap<(u32, u32), Vec<Vec3>> = BTreeMap::new();
    for &[a, b, c] in &hand.faces {
        let [p, q, r] = [a, b, c].map(|v| hand.v_template[v as usize]);
        let normal = (q - p).cross(r - p).normalize();
        for (from, to) in [(a, b), (b, c), (c, a)] {
            normal_at.entry((from.min(to), from.max(to))).or_default().push(normal);
        }
    }
    let sharpest = normal_at.values().map(|n| n[0].dot(n[1])).fold(1.0, f32::min);
    // The sharpest place is the web between two fingers, a narrow U.
    assert!(sharpest > 100f32.to_radians().cos(), "two neighbours meet at {} degrees", sharpest.acos().to_degrees());
}

#[test]
fn proportions_are_human() {
    let hand = HandModel::builtin(Side::Right);
    let posed = rest(&hand);
    let keypoints = hand.keypoints(&posed);
    let length = keypoints[0].distance(keypoints[12]);
    assert!((0.175..0.20).contains(&length), "hand length {length}");
    let z = |v: &Vec3| v.z;
    let across: Vec<f32> =
        hand.v_template.iter().filter(|v| (0.005..0.03).contains(&v.x) && v.z < 0.045).map(z).collect();
    let breadth = across.iter().fold(f32::MIN, |a, b| a.max(*b)) - across.iter().fold(f32::MAX, |a, b| a.min(*b));
    assert!((0.075..0.092).contains(&breadth), "hand breadth {breadth}");
    let area: f32 = vertex_areas(&hand.v_template, &hand.faces).iter().sum();
    assert!((0.035..0.055).contains(&area), "skin {area} m²");
    // Fingers along -x, palm to -y, thumb to +z.
    assert!(keypoints[12].x < keypoints[9].x && keypoints[9].x < keypoints[0].x);
    assert!(keypoints[4].z > keypoints[8].z && keypoints[8].z > keypoints[20].z);
}

#[test]
fn fingertip_pads_are_sampled_finely() {
    let hand = HandModel::builtin(Side::Right);
    let regions = hand.regions();
    let normals = vertex_normals(&hand.v_template, &hand.faces);
    for finger in [Region::IndexTip, Region::MiddleTip, Region::RingTip, Region::LittleTip] {
        let pad = |v: u32| regions[v as usize] == finger && normals[v as usize].y < -0.6;
        let lengths: Vec<f32> = edges(&hand.faces)
            .into_keys()
            .filter(|&(a, b)| pad(a) && pad(b))
            .map(|(a, b)| hand.v_template[a as usize].distance(hand.v_template[b as usize]))
            .collect();
        let mean = lengths.iter().sum::<f32>() / lengths.len() as f32;
        assert!((0.0025..0.0045).contains(&mean), "{}: {mean}", finger.name());
    }
}

#[test]
fn skinning_weights_sum_to_one_and_stay_on_their_finger() {
    let hand = HandModel::builtin(Side::Right);
    let finger = |joint: usize| joint.div_ceil(3);
    for (vertex, weights) in hand.lbs_weights.chunks_exact(N_JOINTS).enumerate() {
        assert!(weights.iter().all(|w| (0.0..=1.0).contains(w)));
        assert!((weights.iter().sum::<f32>() - 1.0).abs() < 1e-6);
        let strongest = (0..N_JOINTS).max_by(|&a, &b| weights[a].total_cmp(&weights[b])).unwrap();
        // Beyond the web, nothing but the own finger and the palm moves a vertex by more than 3 %.
        if strongest % 3 != 1 && strongest != 0 {
            for joint in 1..N_JOINTS {
                assert!(finger(joint) == finger(strongest) || weights[joint] < 0.03, "vertex {vertex}: {weights:?}");
            }
        }
    }
}

#[test]
fn regressor_gives_joints_inside_the_hand_in_rows_of_sum_one() {
    let hand = HandModel::builtin(Side::Right);
    let joints = rest(&hand).joints;
    for (joint, row) in hand.j_regressor.chunks_exact(N_VERTICES).enumerate() {
        assert!((row.iter().sum::<f32>() - 1.0).abs() < 1e-5);
        assert!(row.iter().filter(|w| **w != 0.0).count() < 40, "row {joint} is not sparse");
    }
    for (joint, expected) in joints.iter().zip(build::rest_joints()) {
        assert!(joint.distance(expected) < 1e-6);
    }
}

#[test]
fn every_region_has_vertices_and_is_connected() {
    let hand = HandModel::builtin(Side::Right);
    let regions = hand.regions();
    for region in Region::ALL {
        let members: BTreeSet<u32> = (0..N_VERTICES as u32).filter(|&v| regions[v as usize] == region).collect();
        assert!(members.len() >= 15, "{} has {} vertices", region.name(), members.len());
        let mut reached = BTreeSet::from([*members.first().unwrap()]);
        let mut queue: Vec<u32> = reached.iter().copied().collect();
        let edges = edges(&hand.faces);
        while let Some(at) = queue.pop() {
            for &(a, b) in edges.keys().filter(|&&(a, b)| a == at || b == at) {
                let other = a + b - at;
                if members.contains(&other) && reached.insert(other) {
                    queue.push(other);
                }
            }
        }
        assert_eq!(reached.len(), members.len(), "{} is in pieces", region.name());
    }
}

#[test]
fn left_hand_mirrors_right_hand() {
    let (left, right) = (HandModel::builtin(Side::Left), HandModel::builtin(Side::Right));
    let mirror = |v: Vec3| Vec3::new(-v.x, v.y, v.z);
    let params = bent(0.7);
    let turned = |v: Vec3| Vec3::new(v.x, -v.y, -v.z);
    let mirrored = HandParams {
        betas: params.betas,
        global_orient: turned(params.global_orient),
        hand_pose: params.hand_pose.map(turned),
        transl: mirror(params.transl),
    };
    let (a, b) = (right.forward(&params), left.forward(&mirrored));
    // transl is added after posing, and the wrist joint is mirrored with the hand.
    for (p, q) in a.vertices.iter().zip(&b.vertices) {
        assert!(mirror(*p).distance(*q) < 1e-6);
    }
    for (p, q) in a.joints.iter().zip(&b.joints) {
        assert!(mirror(*p).distance(*q) < 1e-6);
    }
    assert_eq!(left.regions(), right.regions());
}

/// A pose with all fingers bent by `angle`, some shape and some motion.
fn bent(angle: f32) -> HandParams {
    HandParams {
        betas: std::array::from_fn(|i| (i as f32 * 1.7).sin()),
        global_orient: Vec3::new(0.3, -1.1, 0.4),
        hand_pose: std::array::from_fn(|i| Vec3::new(0.05 * i as f32, -0.1, angle)),
        transl: Vec3::new(0.1, -0.2, 0.3),
    }
}

#[test]
fn rigid_motion_moves_the_posed_hand_rigidly() {
    for side in Side::BOTH {
        let hand = HandModel::builtin(side);
        let still = HandParams { global_orient: Vec3::ZERO, transl: Vec3::ZERO, ..bent(0.9) };
        let (axis, angle, transl) = (Vec3::new(0.48, -0.6, 0.64), 2.8, Vec3::new(1.0, -2.0, 0.5));
        let moved = hand.forward(&HandParams { global_orient: axis * angle, transl, ..still.clone() });
        let still = hand.forward(&still);
        let (rotation, wrist) = (Quat::from_axis_angle(axis.normalize(), angle), still.joints[0]);
        for (p, q) in still.vertices.iter().zip(&moved.vertices) {
            assert!((rotation * (*p - wrist) + wrist + transl).distance(*q) < 2e-6);
        }
        assert!(moved.joints[0].distance(wrist + transl) < 1e-6);
    }
}

#[test]
fn joints_alone_are_bit_equal_to_those_of_the_posed_hand() {
    for side in Side::BOTH {
        let hand = HandModel::builtin(side);
        for angle in [0.0, 0.4, -1.1] {
            let mut params = bent(angle);
            params.betas = std::array::from_fn(|beta| angle * (beta as f32 - 4.0));
            params.global_orient = Vec3::new(angle, 0.3, -0.2);
            params.transl = Vec3::new(0.1, -0.2, 0.3);
            let bits = |joints: [Vec3; N_JOINTS]| joints.map(|joint| joint.to_array().map(f32::to_bits));
            assert_eq!(bits(hand.joints(&params)), bits(hand.forward(&params).joints), "{side:?} {angle}");
        }
    }
}

#[test]
fn bones_keep_their_length_in_any_pose() {
    let hand = HandModel::builtin(Side::Right);
    let params = bent(1.2);
    let straight = hand.forward(&HandParams { betas: params.betas, ..HandParams::default() });
    let posed = hand.forward(&params);
    for joint in 1..N_JOINTS {
        let length = |hand: &PosedHand| hand.joints[joint].distance(hand.joints[build::PARENTS[joint]]);
        assert!((length(&straight) - length(&posed)).abs() < 1e-6);
    }
}

#[test]
fn pose_correctives_keep_the_volume_of_a_fist() {
    let hand = HandModel::builtin(Side::Right);
    let plain = HandModel { posedirs: Vec::new(), ..hand.clone() };
    let fist = HandParams {
        hand_pose: std::array::from_fn(|i| Vec3::Z * if i < 12 { 1.2 } else { 0.3 }),
        ..HandParams::default()
    };
    let volume = |posed: &PosedHand| -> f32 {
        hand.faces
            .iter()
            .map(|f| {
                let [a, b, c] = f.map(|v| posed.vertices[v as usize]);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    };
    let (full, with, without) = (volume(&rest(&hand)), volume(&hand.forward(&fist)), volume(&plain.forward(&fist)));
    assert!((with - full).abs() < (without - full).abs(), "rest {full}, corrected {with}, plain {without}");
}

#[test]
fn each_beta_moves_some_part_by_millimetres_to_centimetres_at_three() {
    let hand = HandModel::builtin(Side::Right);
    let neutral = rest(&hand);
    for beta in 0..N_BETAS {
        let mut params = HandParams::default();
        params.betas[beta] = 3.0;
        let shaped = hand.forward(&params);
        let most = shaped.vertices.iter().zip(&neutral.vertices).map(|(a, b)| a.distance(*b)).fold(0.0, f32::max);
        assert!((0.002..0.03).contains(&most), "beta {beta} moves {most} m");
        // Joints follow: each stays well inside the skin around it.
        for joint in &shaped.joints[1..] {
            let nearest = shaped.vertices.iter().map(|v| v.distance(*joint)).fold(f32::MAX, f32::min);
            assert!(nearest > 0.003, "beta {beta}: a joint lies {nearest} m from the skin");
        }
    }
}

#[test]
fn generator_still_makes_the_committed_surface() {
    let (made, committed) = (build::build(), HandModel::builtin(Side::Right));
    assert_eq!(made.v_template.len(), committed.v_template.len());
    assert_eq!(made.faces.len(), committed.faces.len());
    assert!(edges(&made.faces).values().all(|&count| count == 2));
    assert_eq!(made.v_template.len() + made.faces.len(), edges(&made.faces).len() + 2);
    // Rounding may connect other vertices; every committed vertex must still lie on the generator's surface.
    let surface = build::ImplicitHand::new();
    for vertex in committed.v_template.iter().chain(&made.v_template) {
        assert!(surface.value(vertex.as_dvec3()).abs() < 2e-6, "{vertex} is off the surface");
    }
}
