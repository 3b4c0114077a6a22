//! `egotac bench guards`.

use egotac::cli::options::Json;

#[cfg(feature = "sim")]
use egotac::text::{put, tell};

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
    #[command(flatten)]
    json: Json,
}

/// Runs the subject; false if the guards cost more than [`guards::BUDGET`].
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<bool> {
    anyhow::ensure!(args.rounds > 0, "--rounds: expected at least 1, got 0");
    let scenes: Vec<&str> = args.scenes.iter().map(String::as_str).collect();
    let prices = guards::measure(&scenes, args.rounds)?;
    args.json.show(&serde_json::to_value(&prices)?, || table(&prices))?;
    let most = prices.scenes.iter().map(|price| price.share).fold(0.0, f64::max);
    if most > guards::BUDGET {
        tell(format_args!("guards cost {:.1} %, allowed are {:.0} %", 100.0 * most, 100.0 * guards::BUDGET));
    }
    Ok(most <= guards::BUDGET)
}

#[cfg(feature = "sim")]
fn table(prices: &guards::Prices) -> String {
    let mut text = format!(
        "{:16} {:>8} {:>9} {:>9} {:>9} {:>7}\n",
        "scene", "contacts", "step us", "guard us", "frame us", "share"
    );
    for price in &prices.scenes {
        let (step, guard, frame) = (price.step_us, price.guard_us, price.frame_us);
        let percent = 100.0 * price.share;
        put(
            &mut text,
            format_args!("{:16} {:8} {step:9.2} {guard:9.2} {frame:9.2} {percent:6.2}%", price.scene, price.contacts),
        );
    }
    text
}
