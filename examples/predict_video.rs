//! Predicts touch for a video and prints the total force on each hand, frame by frame.
//!
//! `cargo run --release --example predict_video -- VIDEO [CHECKPOINT]`. Needs ffmpeg. The bundled network has seen only
//! rendered scenes; use it to test a pipeline.

use std::path::PathBuf;

use egotac::dataset::video::Frames;
use egotac::hand::Side;
use egotac::model::{Predictor, predictor::Options, shipped};

fn main() -> anyhow::Result<()> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let Some(video) = arguments.next() else { anyhow::bail!("usage: predict_video VIDEO [CHECKPOINT]") };
    let checkpoint = arguments.next().map_or_else(shipped::path, Ok)?;
    let mut predictor = Predictor::load(&checkpoint, Options::default())?;

    println!("time_s,left_N,right_N,touched_vertices");
    for frame in Frames::open(&video, None)? {
        let (stamp_secs, image) = frame?;
        let field = predictor.push(&image, stamp_secs)?.field;
        let touched = field.contact.iter().filter(|probability| **probability > 0.5).count();
        let [left, right] = Side::BOTH.map(|side| field.total_force(side));
        println!("{stamp_secs:.3},{left:.3},{right:.3},{touched}");
    }
    Ok(())
}
