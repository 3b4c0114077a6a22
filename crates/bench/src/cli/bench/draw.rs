//! `egotac bench draw`.

use std::path::PathBuf;

/// Arguments of `egotac bench draw`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// JSON files of bench model, sim, glove, physics and retarget, of experiments and of verify; the plots are written beside them.
    #[arg(required = true, value_name = "FILE.json")]
    reports: Vec<PathBuf>,
}

/// Runs the subject.
#[cfg(feature = "sim")]
pub fn run(args: &Args) -> anyhow::Result<()> {
    for report in &args.reports {
        for name in crate::draw::beside(report)? {
            println!("wrote {}", report.with_file_name(name + ".png").display());
        }
    }
    Ok(())
}
