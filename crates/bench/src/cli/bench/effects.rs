//! `egotac bench effects`.

#[cfg(feature = "sim")]
use super::{load_scenes, show};
use crate::cli::output::Output;
#[cfg(feature = "sim")]
use crate::effects;

/// Arguments of `egotac bench effects`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Names of scenes (`egotac sim list`), or YAML files; without them, all that are part of the program.
    scenes: Vec<String>,
    /// Seed of the episodes.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Width and height of the picture, pixels.
    #[arg(long, default_value_t = 224, value_parser = clap::value_parser!(u32).range(8..=1024))]
    size: u32,
    #[command(flatten)]
    output: Output,
}

/// Runs the subject.
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<()> {
    let mut words = vec!["egotac bench effects".to_owned()];
    words.extend(args.scenes.iter().cloned());
    words.push(format!("--seed {} --size {}{}", args.seed, args.size, args.output.words()));
    let bar = egotac::cli::progress::told_bar("measurements");
    let scenes = load_scenes(&args.scenes)?;
    let report = effects::measure(words.join(" "), &scenes, args.seed, args.size, |what, done, all| {
        show(&bar, what, done, all);
    })?;
    bar.finish_and_clear();
    args.output.write("effects", &report, &effects::markdown(&report))
}
