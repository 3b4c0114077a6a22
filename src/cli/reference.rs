//! Reference texts generated from the command line and from the types: pages of docs/reference, and a first configuration.

mod glove;
mod keys;
#[cfg(feature = "sim")]
mod robot;
#[cfg(feature = "sim")]
mod scene;
mod table;
#[cfg(test)]
mod used;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Command;
use serde_json::json;
use serde_yaml::Value;

use self::keys::{Key, Types};
use super::help;
use crate::file;
use crate::model;
use crate::text::{parse_yaml, put};
use crate::train::Config;
use crate::train::source::TrainingSource;

/// Source of the types of a training configuration; their doc comments describe the keys.
const CONFIG_SOURCE: &str =
    concat!(include_str!("../train/config/mod.rs"), include_str!("../train/config/sections.rs"));
/// Sources of the types of an entry of `data`, and of a network's geometry.
const SOURCE_SOURCE: &str = include_str!("../train/source.rs");
const GEOMETRY_SOURCE: &str = include_str!("../model/config.rs");
/// Keys that a configuration must have, with values to start from. All others have defaults.
const REQUIRED: &str = "{name: first, data: [train.zarr], out: run, model: pocket, seed: 1, steps: 1000}";

/// Arguments of `egotac reference`.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Folder for the pages.
    folder: PathBuf,
}

/// Writes the pages about `command` and about the keys of a training configuration, of a glove and, with the feature `sim`, of a
/// scene and of a robot.
///
/// # Errors
/// If a page can't be written.
pub fn run(args: &Args, command: Command) -> anyhow::Result<ExitCode> {
    file::write(&args.folder.join("cli.md"), commands_page("Commands of egotac", command).as_bytes())?;
    file::write(&args.folder.join("training-keys.md"), training_page()?.as_bytes())?;
    file::write(&args.folder.join("glove-keys.md"), glove::page()?.as_bytes())?;
    #[cfg(feature = "sim")]
    file::write(&args.folder.join("scene-keys.md"), scene::page()?.as_bytes())?;
    #[cfg(feature = "sim")]
    file::write(&args.folder.join("robot-keys.md"), robot::page()?.as_bytes())?;
    Ok(ExitCode::SUCCESS)
}

/// Returns the page about all commands below `command`.
pub fn commands_page(title: &str, command: Command) -> String {
    let mut command = command.disable_help_subcommand(true).term_width(100);
    command.build();
    let mut page = format!("# {title}\n\nWritten by `scripts/reference`.\n");
    describe_below(&command, "egotac", &mut page);
    page
}

fn describe_below(command: &Command, path: &str, page: &mut String) {
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        let path = format!("{path} {}", below.get_name());
        match help::is_runnable(below) {
            false => describe_below(below, &path, page),
            true => {
                let help = below.clone().render_long_help().to_string();
                let lines: Vec<&str> = help.lines().map(str::trim_end).collect();
                put(page, format_args!("\n## {path}\n\n```text\n{}\n```", lines.join("\n").trim_end()));
                describe_below(below, &path, page);
            }
        }
    }
}

/// Returns the keys of a training configuration.
fn training_keys() -> Vec<Key> {
    Types::read(&[CONFIG_SOURCE]).keys("Config")
}

/// Returns the configuration with all defaults.
fn defaults() -> anyhow::Result<Value> {
    let config: Config = parse_yaml(REQUIRED).context("defaults")?;
    Ok(serde_yaml::to_value(config)?)
}

/// Returns a configuration with each key at its default under its description.
///
/// # Errors
/// If a default can't be written as YAML.
pub fn training_config() -> anyhow::Result<String> {
    let defaults = defaults()?;
    let mut text = String::from("# Configuration of `egotac train`.\n");
    write_keys(&training_keys(), &defaults, "", &mut text)?;
    Ok(text)
}

fn write_keys(keys: &[Key], values: &Value, indent: &str, text: &mut String) -> anyhow::Result<()> {
    for key in keys {
        for line in wrapped(&key.text, 100) {
            put(text, format_args!("{indent}# {line}"));
        }
        let value = values.get(key.name.as_str()).unwrap_or(&Value::Null);
        match (value, key.below.is_empty()) {
            (Value::Null, _) => put(text, format_args!("{indent}# {}:", key.name)),
            (value, true) => put(text, format_args!("{indent}{}: {}", key.name, serde_json::to_string(value)?)),
            (value, false) => {
                put(text, format_args!("{indent}{}:", key.name));
                write_keys(&key.below, value, &format!("{indent}  "), text)?;
            }
        }
    }
    Ok(())
}

/// Returns the page about the keys of a training configuration.
fn training_page() -> anyhow::Result<String> {
    let (defaults, needed) = (defaults()?, parse_yaml::<Value>(REQUIRED)?);
    let mut page = String::from(
        "# Keys of a training configuration\n\nWritten by `scripts/reference` from the types. `egotac train --init-config FILE` writes a \
         file with all keys; `--set KEY=VALUE` replaces one, dotted as below.\n\n| key | default | meaning |\n|---|---|---|\n",
    );
    write_rows(&training_keys(), &defaults, &needed, "", &mut page)?;
    page += "\n## Sources\n\nAn entry of `data` is a path, or a mapping with these keys.\n\n| key | default | meaning |\n|---|---|---|\n";
    let needed: Value = parse_yaml("stores: [train.zarr]")?;
    let TrainingSource { quota, mirror, labels, weigh_by_std, .. } =
        parse_yaml("stores: [train.zarr]").context("source")?;
    let defaults = json!({ "quota": quota, "mirror": mirror, "labels": labels, "weigh_by_std": weigh_by_std });
    let keys = Types::read(&[SOURCE_SOURCE]).keys("TrainingSource");
    write_rows(&keys, &serde_yaml::to_value(defaults)?, &needed, "", &mut page)?;
    put(
        &mut page,
        format_args!(
            "\n## Geometry\n\n`model` is the name of a preset ({}), or a mapping with these keys.\n\n| key | in `small` | meaning |\n|---|---|---|",
            model::Config::PRESETS.map(|name| format!("`{name}`")).join(", ")
        ),
    );
    let mut small = serde_yaml::to_value(model::Config::small())?;
    // Left out of files at its default.
    if let Some(values) = small.as_mapping_mut() {
        values.entry("registers".into()).or_insert(0.into());
    }
    write_rows(&Types::read(&[GEOMETRY_SOURCE]).keys("Config"), &small, &Value::Null, "", &mut page)?;
    Ok(page)
}

fn write_rows(keys: &[Key], values: &Value, needed: &Value, before: &str, page: &mut String) -> anyhow::Result<()> {
    for key in keys {
        let name = format!("{before}{}", key.name);
        let value = values.get(key.name.as_str()).unwrap_or(&Value::Null);
        if !key.below.is_empty() {
            write_rows(&key.below, value, &Value::Null, &format!("{name}."), page)?;
            continue;
        }
        let default = match (needed.get(key.name.as_str()), value) {
            (Some(_), _) => "required".to_owned(),
            (None, Value::Null) => "none".to_owned(),
            (None, value) => format!("`{}`", serde_json::to_string(value)?),
        };
        put(page, format_args!("| `{name}` | {default} | {} |", key.text.replace('|', "\\|")));
    }
    Ok(())
}

/// Breaks a text into lines of at most `width` characters, between words.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split(' ').filter(|word| !word.is_empty()) {
        match lines.last_mut() {
            Some(line) if line.len() + word.len() < width => *line += &format!(" {word}"),
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_written_configuration_reads_back_as_the_defaults() {
        let written: Config = parse_yaml(&training_config().unwrap()).unwrap();
        assert_eq!(written, parse_yaml::<Config>(REQUIRED).unwrap());
    }

    #[test]
    fn sources_and_geometry_are_described_with_their_defaults() {
        let page = training_page().unwrap();
        for row in [
            "| `stores` | required |",
            "| `labels` | `\"both\"` | Labels that are supervised. One of `both`, `contact`, `force`, `felt`, `proximity`. |",
            "| `vision_width` | `384` |",
            "| `registers` | `0` |",
        ] {
            assert!(page.contains(row), "{row}");
        }
    }

    #[test]
    fn each_key_of_the_type_is_described() {
        let described = training_keys();
        for (name, value) in defaults().unwrap().as_mapping().unwrap() {
            let key = described.iter().find(|key| Some(key.name.as_str()) == name.as_str());
            let key = key.unwrap_or_else(|| panic!("{name:?}"));
            assert!(!key.text.is_empty(), "{}", key.name);
            for (name, _) in value.as_mapping().into_iter().flatten() {
                assert!(
                    key.below.iter().any(|below| Some(below.name.as_str()) == name.as_str()),
                    "{}.{name:?}",
                    key.name
                );
            }
        }
    }
}
