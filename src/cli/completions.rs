//! `egotac completions` and `egotac man`.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Command;
use clap_complete::Shell;

use crate::file;

/// Arguments of `egotac completions`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples: `egotac completions bash > ~/.local/share/bash-completion/completions/egotac`; \
    `egotac completions zsh > ~/.zfunc/_egotac`; `egotac completions fish > ~/.config/fish/completions/egotac.fish`")]
pub struct Completions {
    /// Shell whose completions are printed.
    shell: Shell,
}

/// Arguments of `egotac man`.
#[derive(Debug, clap::Args)]
pub struct Man {
    /// Folder for the pages, such as ~/.local/share/man/man1.
    folder: PathBuf,
}

/// Prints the completions of a shell for `command`.
pub fn completions(args: &Completions, mut command: Command) -> anyhow::Result<ExitCode> {
    // Into memory first: clap_complete panics where a write fails.
    let mut script = Vec::new();
    clap_complete::generate(args.shell, &mut command, "egotac", &mut script);
    print!("{}", String::from_utf8_lossy(&script));
    Ok(ExitCode::SUCCESS)
}

/// Writes one manual page for `command` and each of its subcommands.
///
/// # Errors
/// If the folder or a page can't be written.
pub fn man(args: &Man, command: Command) -> anyhow::Result<ExitCode> {
    std::fs::create_dir_all(&args.folder).with_context(|| args.folder.display().to_string())?;
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let pages = write_pages(&command, "egotac", args)?;
    println!("{}: {pages} pages", args.folder.display());
    Ok(ExitCode::SUCCESS)
}

/// Writes the pages of `command`, whose page is called `name`, and of those below it; returns their number.
fn write_pages(command: &Command, name: &str, args: &Man) -> anyhow::Result<usize> {
    let page = clap_mangen::Man::new(command.clone()).title(name);
    let mut text = Vec::new();
    page.render(&mut text)?;
    file::write(&args.folder.join(format!("{name}.1")), &text)?;
    let mut pages = 1;
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        pages += write_pages(below, &format!("{name}-{}", below.get_name()), args)?;
    }
    Ok(pages)
}
