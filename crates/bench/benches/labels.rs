//! Times the labels of one hand of 778 vertices against a mesh of about 10,000 triangles, at most 1 ms together.
//!
//! ```text
//! cargo bench -p egotac-bench --bench labels
//! ```
//!
//! Prints the shortest of many runs, then criterion's statistics. `full` is (a) + (b) + (c) with every fingertip on the mesh:
//! nearest resampled point, signed distance up to 1 cm, and the spread forces of five contacts.

use std::f32::consts::{PI, TAU};
use std::hint::black_box;
use std::time::Instant;

use criterion::{Criterion, criterion_group, criterion_main};
use egotac::geometry::force::link_vertices;
use egotac::geometry::{ForceSpreader, HandSurface, LinkContact, PROXIMITY, SIGMA, SPACING, SampledSurface, Surface};
use egotac::hand::{HandModel, HandParams, Side};
use glam::{DVec3, Vec3};

/// Number of runs; the shortest one is printed.
const RUNS: usize = 500;

/// A bumpy ball of 2 x 71 x 70 triangles, about as big as a fist can hold, around the origin.
fn bumpy_ball() -> (Vec<Vec3>, Vec<[u32; 3]>) {
    const ROWS: u32 = 71;
    const COLUMNS: u32 = 71;
    let mut vertices = vec![Vec3::Z * 0.035, Vec3::Z * -0.035];
    for row in 1..ROWS {
        for column in 0..COLUMNS {
            let (polar, azimuth) = (PI * row as f32 / ROWS as f32, TAU * column as f32 / COLUMNS as f32);
            let radius = 0.035 + 0.002 * (7.0 * azimuth).sin() * (5.0 * polar).sin();
            let direction = Vec3::new(polar.sin() * azimuth.cos(), polar.sin() * azimuth.sin(), polar.cos());
            vertices.push(radius * direction);
        }
    }
    let at = |row: u32, column: u32| 2 + (row - 1) * COLUMNS + column % COLUMNS;
    let mut triangles = Vec::new();
    for column in 0..COLUMNS {
        triangles.push([0, at(1, column), at(1, column + 1)]);
        triangles.push([1, at(ROWS - 1, column + 1), at(ROWS - 1, column)]);
        for row in 1..ROWS - 1 {
            let (a, b, c, d) = (at(row, column), at(row, column + 1), at(row + 1, column), at(row + 1, column + 1));
            triangles.extend([[a, c, d], [a, d, b]]);
        }
    }
    (vertices, triangles)
}

/// A hand whose fingers are bent around the origin.
fn grasp(model: &HandModel) -> Vec<Vec3> {
    let mut params = HandParams::default();
    for finger in [0, 3, 6, 9] {
        for joint in 0..3 {
            params.hand_pose[finger + joint] = Vec3::new(0.0, 0.0, 0.7);
        }
    }
    let mut vertices = model.forward(&params).vertices;
    // The middle of the knuckles' palmar side lies on the ball.
    let palm = [1, 4, 7, 10].map(|joint| model.forward(&params).joints[joint]).iter().sum::<Vec3>() / 4.0;
    vertices.iter_mut().for_each(|v| *v -= palm - Vec3::Y * 0.045);
    vertices
}

/// Returns the shortest of many runs, ms: other load on the machine only lengthens runs.
fn least<T>(run: impl Fn() -> T) -> f64 {
    let time = || {
        let start = Instant::now();
        black_box(run());
        start.elapsed().as_secs_f64() * 1e3
    };
    (0..RUNS).map(|_| time()).fold(f64::INFINITY, f64::min)
}

fn labels(criterion: &mut Criterion) {
    let model = HandModel::builtin(Side::Right);
    let vertices = grasp(&model);
    let (mesh, triangles) = bumpy_ball();
    let points = SampledSurface::new(&mesh, &triangles, SPACING).expect("points");
    let surface = Surface::new(mesh, triangles).expect("surface");
    let spreader = ForceSpreader::new(&model, SIGMA).expect("spreader");
    let links = link_vertices(&model);
    let contacts = [3, 6, 9, 12, 15].map(|link| {
        let position = vertices[links[link][0] as usize].as_dvec3();
        LinkContact { link, position, normal: DVec3::Y, force: 1.0 }
    });
    let near = vertices.iter().filter(|v| surface.distance(**v, PROXIMITY) <= PROXIMITY).count();
    let inside = vertices.iter().filter(|v| surface.distance(**v, PROXIMITY) < 0.0).count();
    println!(
        "{} triangles, {} points, {} vertices: {near} within 1 cm, {inside} of them inside",
        surface.n_triangles(),
        points.points().len(),
        vertices.len()
    );

    let a = || vertices.iter().map(|v| u32::from(points.distance(*v, PROXIMITY) <= PROXIMITY)).sum::<u32>();
    let b = || vertices.iter().map(|v| u32::from(surface.distance(*v, PROXIMITY) <= 0.005)).sum::<u32>();
    let c = || spreader.spread(&vertices, &contacts).expect("forces").total;
    for (name, least) in [("a", least(a)), ("b", least(b)), ("c", least(c)), ("a + b + c", least(|| (a(), b(), c())))] {
        println!("{name}: least of {RUNS} runs {least:.3} ms");
    }
    let mut group = criterion.benchmark_group("labels");
    group.bench_function("a_points_1cm", |bencher| bencher.iter(|| black_box(a())));
    group.bench_function("b_signed_distance", |bencher| bencher.iter(|| black_box(b())));
    group.bench_function("c_spread_forces", |bencher| bencher.iter(|| black_box(c())));
    group.bench_function("full", |bencher| bencher.iter(|| black_box((a(), b(), c()))));
    let mut skin = HandSurface::new(&model, SPACING).expect("skin");
    group.bench_function("move_the_other_hand", |bencher| {
        bencher.iter(|| skin.set_vertices(black_box(&vertices)).expect("vertices"))
    });
    group.finish();
}

criterion_group!(benches, labels);
criterion_main!(benches);
