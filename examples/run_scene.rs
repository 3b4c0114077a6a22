//! Runs a simulated scene and prints the true contact force on each hand, frame by frame.
//!
//! `cargo run --release --features sim --example run_scene -- [SCENE] [SEED]`; `egotac sim list` names the scenes.

use egotac::hand::Side;
use egotac::sim::{Rollout, RolloutOptions, Scene};

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args().skip(1);
    let scene = Scene::load(&arguments.next().unwrap_or_else(|| "pinch_cube".into()))?;
    let seed = arguments.next().map_or(Ok(0), |seed| seed.parse())?;

    // Without a picture the rollout needs no OpenGL.
    let options = RolloutOptions { picture: None, ..RolloutOptions::default() };
    let mut rollout = Rollout::new(&scene, seed, &options)?;
    println!("time_s,left_N,right_N,validity");
    while let Some(observed) = rollout.next_frame()? {
        let frame = observed.frame;
        let [left, right] = Side::BOTH.map(|side| frame.field.total_force(side));
        println!("{:.2},{left:.3},{right:.3},{}", frame.timestamp, frame.validity.code());
    }
    Ok(())
}
