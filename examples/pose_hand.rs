//! Poses a hand and prints its fingertips; with a file name, also writes the mesh as Wavefront OBJ.
//!
//! `cargo run --release --example pose_hand -- [MESH.obj] [MANO_RIGHT.pkl]`

use std::fmt::Write;
use std::path::{Path, PathBuf};

use egotac::hand::{HandModel, HandParams, Side};
use glam::Vec3;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<PathBuf> = std::env::args_os().skip(1).map(PathBuf::from).collect();
    let hand = match arguments.get(1) {
        Some(mano) => HandModel::load(mano, Side::Right)?,
        None => HandModel::builtin(Side::Right),
    };

    // Bends the three joints of the index finger by 0.4 rad each, about the axis across the palm.
    let mut params = HandParams::default();
    for joint in &mut params.hand_pose[0..3] {
        *joint = Vec3::new(0.0, 0.0, 0.4);
    }
    let posed = hand.forward(&params);
    let keypoints = hand.keypoints(&posed);
    for (finger, tip) in ["thumb", "index", "middle", "ring", "little"].iter().zip([4, 8, 12, 16, 20]) {
        println!("{finger} tip: {:.4} m", keypoints[tip]);
    }
    if let Some(path) = arguments.first() {
        write_obj(path, &posed.vertices, &hand.faces)?;
        println!("wrote {}", path.display());
    }
    Ok(())
}

/// Writes a mesh; OBJ counts vertices from 1.
fn write_obj(path: &Path, vertices: &[Vec3], faces: &[[u32; 3]]) -> anyhow::Result<()> {
    let mut text = String::new();
    for vertex in vertices {
        writeln!(text, "v {} {} {}", vertex.x, vertex.y, vertex.z)?;
    }
    for [a, b, c] in faces {
        writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1)?;
    }
    Ok(std::fs::write(path, text)?)
}
