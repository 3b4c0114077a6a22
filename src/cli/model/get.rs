//! Command `egotac model get`.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use crate::file::limits;
use crate::model::import::Mapping;
use crate::model::published::{Kind, PUBLISHED, Published};
use crate::model::{Checkpoint, checkpoint};
use crate::text::{put, tell};

/// Arguments of `egotac model get`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Without SOURCE, lists the published networks with page and licence. A download needs the program curl and \
    --accept-licence; a file needs neither, and no network. A checkpoint of egotac is checked and copied; one of another \
    program, such as a .pth file, needs --mapping, a table of tensor names (see `egotac model import --help`)."
)]
pub struct Args {
    /// Name of a published network, an https address, or a file.
    source: Option<String>,
    /// Table (YAML) that maps the tensors of another program's checkpoint.
    #[arg(long, value_name = "FILE")]
    mapping: Option<PathBuf>,
    /// Confirm that the licence on the network's page has been read and permits the use.
    #[arg(long)]
    accept_licence: bool,
    /// File to write [default: NAME.safetensors here].
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// Runs the command.
///
/// # Errors
/// If the source is unknown, can't be downloaded, or is no network.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let Some(source) = &args.source else {
        print!("{}", list());
        return Ok(());
    };
    let path = Path::new(source);
    if path.is_file() {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        return take(path, &args.out(&name), args.mapping.as_deref(), None);
    }
    let (address, published) = match Published::find(source) {
        Some(published) => {
            tell(format_args!(
                "{}: {}\npage: {}\nlicence: {}",
                published.name, published.about, published.page, published.licence
            ));
            match published.address() {
                Some(address) => (address, Some(published)),
                None => bail!(
                    "choose the file on {}, then give its https address, or the downloaded file, with a table of its tensors: \
                     egotac model get FILE --mapping TABLE.yaml",
                    published.page
                ),
            }
        }
        None if source.starts_with("https://") => (source.clone(), None),
        None => {
            let names: Vec<&str> = PUBLISHED.iter().map(|published| published.name).collect();
            bail!("{source}: neither a file, nor an https address, nor one of {}", names.join(", "));
        }
    };
    if !args.accept_licence {
        let page = published.map_or(address.as_str(), |published| published.page);
        bail!("read the licence on {page}, then give the command again with --accept-licence");
    }
    let name = match published {
        Some(published) => published.name.to_owned(),
        None => file_name(&address),
    };
    let folder = tempfile::tempdir()?;
    let file = folder.path().join(file_name(&address));
    download(&address, &file)?;
    take(&file, &args.out(&name), args.mapping.as_deref(), published.map(|published| published.kind))
}

impl Args {
    fn out(&self, name: &str) -> PathBuf {
        self.out.clone().unwrap_or_else(|| PathBuf::from(format!("{name}.safetensors")))
    }
}

/// Returns the published networks as text.
fn list() -> String {
    let mut text = String::new();
    for Published { name, about, page, licence, .. } in PUBLISHED {
        put(&mut text, format_args!("{name}\n  {about}\n  page: {page}\n  licence: {licence}"));
    }
    text
}

/// Returns the last part of an address, without a query; letters, digits, dots, dashes and underscores alone.
fn file_name(address: &str) -> String {
    let path = address.split(['?', '#']).next().unwrap_or_default();
    let last = path.trim_end_matches('/').rsplit('/').next().unwrap_or_default();
    let safe: String = last.chars().filter(|c| c.is_ascii_alphanumeric() || "._-".contains(*c)).collect();
    if safe.trim_matches('.').is_empty() { "network".into() } else { safe }
}

/// Downloads a file by curl, over https alone and up to the limit of weights.
fn download(address: &str, to: &Path) -> anyhow::Result<()> {
    let most = limits::WEIGHTS.value().to_string();
    let mut command = Command::new("curl");
    command.args(["--fail", "--location", "--proto", "=https", "--proto-redir", "=https", "--max-filesize", &most]);
    command.args(["--progress-bar", "--output"]).arg(to).arg("--").arg(address).stdin(Stdio::null());
    let status = command.status().context("curl, which downloads files, can't be run; install the package curl")?;
    match status.success() {
        true => Ok(()),
        false => bail!(
            "{address}: curl failed with {status}; a file that was downloaded otherwise can be given in its place"
        ),
    }
}

/// Checks a file and writes what it becomes here.
fn take(file: &Path, out: &Path, mapping: Option<&Path>, kind: Option<Kind>) -> anyhow::Result<()> {
    if let Some(mapping) = mapping {
        let (config, metadata, tensors) = Mapping::read(mapping)?.apply(file)?;
        let sha256 = Checkpoint::save_tensors(out, &config, &metadata, &tensors)?;
        println!("{}: {} tensors, sha256 {sha256}", out.display(), tensors.len());
        return Ok(());
    }
    if kind == Some(Kind::Encoder) {
        // Reads all of it, so that a page in place of the file is found.
        let tensors = checkpoint::read_tensors(file)?;
        copy(file, out)?;
        println!(
            "{}: an encoder of {} tensors; next: egotac model init --encoder {0} --out start.safetensors",
            out.display(),
            tensors.len()
        );
        return Ok(());
    }
    let checkpoint = Checkpoint::load(file, &candle_core::Device::Cpu)
        .context("no checkpoint of egotac; --mapping imports one of another program")?;
    copy(file, out)?;
    println!("{}: {}, sha256 {}", out.display(), checkpoint.metadata.name, checkpoint.sha256);
    Ok(())
}

/// Copies a file in an atomic write.
fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    let bytes = crate::file::input::read(from, limits::WEIGHTS)?;
    Ok(crate::file::write(to, &bytes)?)
}
