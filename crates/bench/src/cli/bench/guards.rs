//! `egotac bench guards`.

use std::path::PathBuf;

#[cfg(feature = "sim")]
use crate::guards;

/// Arguments of `egotac bench guards`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Scenes to measure in.
    #[arg(default_values = ["pinch_cube", "lift_mug", "hover"])]
    scenes: Vec<String>,
    /// Measurements of each kind; the least counts.
    #[arg(long, default_value_t = 2000)]
    rounds: usize,
    /// JSON file to write.
    #[arg(long)]
    out: Option<PathBuf>,
}

/// Runs the subject; false if the guards cost more than [`guards::BUDGET`].
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<bool> {
    anyhow::ensure!(args.rounds > 0, "--rounds: expected at least 1, got 0");
    let scenes: Vec<&str> = args.scenes.iter().map(String::as_str).collect();
    let prices = guards::measure(&scenes, args.rounds)?;
    println!("{:16} {:>8} {:>9} {:>9} {:>9} {:>7}", "scene", "contacts", "step us", "guard us", "frame us", "share");
    for price in &prices.scenes {
        let (step, guard, frame) = (price.step_us, price.guard_us, price.frame_us);
        let percent = 100.0 * price.share;
        println!("{:16} {:8} {step:9.2} {guard:9.2} {frame:9.2} {percent:6.2}%", price.scene, price.contacts);
    }
    if let Some(out) = &args.out {
        egotac::file::write(out, serde_json::to_string_pretty(&prices)?.as_bytes())?;
        println!("wrote {}", out.display());
    }
    let most = prices.scenes.iter().map(|price| price.share).fold(0.0, f64::max);
    if most > guards::BUDGET {
        println!("guards cost {:.1} %, allowed are {:.0} %", 100.0 * most, 100.0 * guards::BUDGET);
    }
    Ok(most <= guards::BUDGET)
}
