//! Reads a labelled recording (store, bag, LeRobot data set or tensor file) and prints a line for each episode.
//!
//! `cargo run --release --example read_labelled_store -- RECORDING`

use std::path::PathBuf;

use egotac::hand::Side;
use egotac::label::Labelled;

fn main() -> anyhow::Result<()> {
    let Some(path) = std::env::args_os().nth(1).map(PathBuf::from) else {
        anyhow::bail!("usage: read_labelled_store RECORDING")
    };
    let labels = Labelled::read(&path)?.labels;
    println!("episode,frames,left_peak_N,right_peak_N");
    for (episode, frames) in labels.episodes().into_iter().enumerate() {
        let peak = |side: Side| {
            frames.clone().map(|frame| labels.force_at(frame)[side.range()].iter().sum::<f32>()).fold(0.0, f32::max)
        };
        println!("{episode},{},{:.3},{:.3}", frames.len(), peak(Side::Left), peak(Side::Right));
    }
    Ok(())
}
