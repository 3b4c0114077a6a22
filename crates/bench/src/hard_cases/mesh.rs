//! Meshes and inertias.

use std::fmt::Write;

use egotac::error::Result;
use egotac::mujoco::audit::mesh_faults;
use egotac::mujoco::{PhysicsOptions, World};
use glam::Vec3;

use super::watch::{Watched, compare, simulate};
use super::{Family, HardCase, Outcome, accepted};

const FAMILY: Family = Family::Mesh;

pub(super) const CASES: &[HardCase] = &[
    FAMILY.case(
        "degenerate_mesh",
        "collision meshes of 4 points in a plane, of 3 points, with a NaN, with a bad index, at scale 1e-8",
        "a cube",
        degenerate,
    ),
    FAMILY.case(
        "silently_faulty_mesh",
        "a triangle without area, three corners on a line, vertices twice, faces inwards, a hole, a needle of 1:20000",
        "a closed, outward-facing surface",
        silently_faulty,
    ),
    FAMILY.case(
        "paper_thin_mesh",
        "a sheet of 100 x 100 mm and 0.1 micrometres lies on the floor",
        "a sheet of 2 mm",
        paper_thin,
    ),
    FAMILY.case(
        "no_inertia",
        "a moving body without mass, with mass 0, with inertia 0, with A + B < C",
        "a ball of 50 g",
        no_inertia,
    ),
    FAMILY.case(
        "tiny_inertia",
        "a ball of 1 kg is given an inertia of 1e-12 and slides over the floor",
        "the inertia of its shape",
        tiny_inertia,
    ),
];

type Mesh = (Vec<Vec3>, Vec<[u32; 3]>);

/// Returns a cube of 40 mm.
fn cube() -> Mesh {
    let corner = |i: u32| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * 0.04 - Vec3::splat(0.02);
    let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let faces = quads.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    ((0..8).map(corner).collect(), faces)
}

fn mjcf((vertices, faces): &Mesh, attributes: &str, height: f32) -> String {
    let mut text = String::from(r#"<mujoco><asset><mesh name="m" vertex=""#);
    for v in vertices {
        let _ = write!(text, "{} {} {} ", v.x, v.y, v.z);
    }
    if !faces.is_empty() {
        text.push_str(r#"" face=""#);
        for [a, b, c] in faces {
            let _ = write!(text, "{a} {b} {c} ");
        }
    }
    let _ = write!(
        text,
        r#"" {attributes}/></asset><worldbody><geom name="floor" type="plane" size="1 1 .1"/><body name="b" pos="0 0 {height}">
        <freejoint name="b"/><geom name="b" type="mesh" mesh="m" mass=".05"/></body></worldbody></mujoco>"#
    );
    text
}

fn loads(mesh: &Mesh, attributes: &str) -> Result<World> {
    World::from_mjcf(&mjcf(mesh, attributes, 0.03), &PhysicsOptions::default())
}

fn degenerate() -> Result<Outcome> {
    let (vertices, faces) = cube();
    let flat = (vertices[..4].to_vec(), vec![]);
    let few = (vertices[..3].to_vec(), vec![]);
    let mut holey = vertices.clone();
    holey[3].x = f32::NAN;
    let mut astray = faces.clone();
    astray[0][0] = 99;
    let calls = [
        loads(&flat, ""),
        loads(&few, ""),
        loads(&(holey, faces.clone()), ""),
        loads(&(vertices.clone(), astray), ""),
        loads(&(vertices.clone(), faces.clone()), r#"scale="1e-8 1e-8 1e-8""#),
    ];
    let (unguarded, guard) = accepted(calls);
    let (remedied, remedied_guard) = match loads(&(vertices, faces), "") {
        Ok(_) => (0.0, String::new()),
        Err(error) => (1.0, error.to_string()),
    };
    let error_of = "meshes wrongly accepted or refused";
    Ok(Outcome { error_of, tolerance: 0.0, unguarded: Some(unguarded), guard, remedied, remedied_guard })
}

fn silently_faulty() -> Result<Outcome> {
    let (vertices, faces) = cube();
    let with = |extra: &[Vec3], triangle: &[[u32; 3]]| -> Mesh {
        let vertices = vertices.iter().chain(extra).copied().collect();
        (vertices, faces.iter().chain(triangle).copied().collect())
    };
    let middle = 0.5 * (vertices[0] + vertices[1]);
    let far = vertices[1] + Vec3::new(1.0, 0.0, 0.0);
    let meshes = [
        with(&[], &[[0, 0, 1]]),
        with(&[middle], &[[0, 8, 1]]),
        with(&[vertices[5]], &[]),
        (vertices.clone(), faces.iter().map(|[a, b, c]| [*a, *c, *b]).collect()),
        (vertices.clone(), faces[1..].to_vec()),
        with(&[far, far + Vec3::Y * 5e-5], &[[1, 8, 9], [1, 9, 8]]),
    ];
    let mut reports = Vec::new();
    for mesh in &meshes {
        let faults = mesh_faults(&mesh.0, &mesh.1);
        // A mesh that passes unnoticed must not hide behind the report of another.
        let Some(first) = faults.first() else { return outcome(&meshes, String::new(), &(vertices, faces)) };
        reports.push(first.to_string());
    }
    outcome(&meshes, format!("the mesh {}", reports.join(" / ")), &(vertices, faces))
}

fn outcome(meshes: &[Mesh], guard: String, clean: &Mesh) -> Result<Outcome> {
    let taken = meshes.iter().filter(|mesh| loads(mesh, r#"inertia="convex""#).is_ok()).count();
    let faults: Vec<String> = mesh_faults(&clean.0, &clean.1).iter().map(ToString::to_string).collect();
    Ok(Outcome {
        error_of: "faulty meshes that the engine accepts",
        tolerance: 0.0,
        unguarded: Some(taken as f64),
        guard,
        remedied: faults.len() as f64,
        remedied_guard: faults.join(", "),
    })
}

fn paper_thin() -> Result<Outcome> {
    let run = |thickness: f32| -> Result<(f64, Watched)> {
        let (vertices, faces) = cube();
        let vertices = vertices.iter().map(|v| *v * Vec3::new(2.5, 2.5, thickness / 0.04)).collect();
        let text = mjcf(&(vertices, faces), r#"inertia="convex""#, 0.5 * thickness);
        let mut lowest = f64::INFINITY;
        let see = |world: &mut World| lowest = lowest.min(world.qpos()[2]);
        let run = simulate(&text, &PhysicsOptions::default(), &["b"], 1.0, |_| (), see)?;
        let thickness = f64::from(thickness);
        Ok((100.0 * (0.5 * thickness - lowest) / thickness, run))
    };
    let (unguarded, remedied) = (run(1e-7)?, run(2e-3)?);
    Ok(compare(unguarded, remedied, "depth in the floor, % of its thickness", 20.0))
}

fn body(inside: &str) -> String {
    format!(
        r#"<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/><body name="b" pos=".1 0 .0301">
        <freejoint name="b"/>{inside}</body></worldbody></mujoco>"#
    )
}

fn no_inertia() -> Result<Outcome> {
    let load = |inside: &str| World::from_mjcf(&body(inside), &PhysicsOptions::default());
    let (unguarded, guard) = accepted([
        load(""),
        load(r#"<geom size=".03" mass="0"/>"#),
        load(r#"<inertial pos="0 0 0" mass=".05" diaginertia="0 0 0"/><geom size=".03"/>"#),
        load(r#"<inertial pos="0 0 0" mass=".05" diaginertia="1e-5 1e-5 1"/><geom size=".03"/>"#),
    ]);
    let (remedied, remedied_guard) = match load(r#"<geom size=".03" mass=".05"/>"#) {
        Ok(_) => (0.0, String::new()),
        Err(error) => (1.0, error.to_string()),
    };
    let error_of = "bodies wrongly accepted or refused";
    Ok(Outcome { error_of, tolerance: 0.0, unguarded: Some(unguarded), guard, remedied, remedied_guard })
}

/// Compares the final speed of a ball that slides and then rolls: a solid ball keeps 5/7 of its speed.
fn tiny_inertia() -> Result<Outcome> {
    const SPEED: f64 = 0.5;
    let run = |inertial: &str| -> Result<(f64, Watched)> {
        let text = body(&format!(r#"{inertial}<geom name="b" size=".03" mass="1"/>"#));
        let slide = |world: &mut World| world.qvel_mut()[0] = SPEED;
        let run = simulate(&text, &PhysicsOptions::default(), &["b"], 1.0, slide, |_| ())?;
        Ok((100.0 * (run.world.qvel()[0] / (SPEED * 5.0 / 7.0) - 1.0), run))
    };
    let unguarded = run(r#"<inertial pos="0 0 0" mass="1" diaginertia="1e-12 1e-12 1e-12"/>"#)?;
    let remedied = run("")?;
    Ok(compare(unguarded, remedied, "speed of a ball that slid and rolls, %", 2.0))
}
