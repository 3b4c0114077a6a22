//! Values that options of several commands share: checkpoints, lengths, times, JSON output.

use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use clap::builder::{PathBufValueParser, TypedValueParser};

use crate::file;
use crate::model::shipped;
use crate::text::printable;

/// Value of `--checkpoint` that names the network shipped with egotac.
const SHIPPED: &str = "shipped";

/// Returns the parser of `--checkpoint FILE|shipped`: a path, or `shipped` for the network shipped with egotac.
#[doc(hidden)]
pub fn checkpoint() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path: PathBuf| match path == Path::new(SHIPPED) {
        true => shipped::path(),
        false => Ok(path),
    })
}

/// Length, m. On the command line it has a unit: `4mm`, `1cm`, `0.004m`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length(pub f64);

impl FromStr for Length {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let units = [("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)];
        with_unit(text, &units).map(Self).ok_or_else(|| "expected a length with its unit, such as 4mm or 1cm".into())
    }
}

impl fmt::Display for Length {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        // Rounded to a nanometre, which hides the error of the conversion.
        write!(f, "{}mm", (self.0 * 1e9).round() / 1e6)
    }
}

/// Time, s. On the command line it has a unit (`20ms`, `1.5s`, `10min`, `8h`), or is in seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Time(pub f64);

impl FromStr for Time {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let units = [("ms", 1e-3), ("s", 1.0), ("min", 60.0), ("m", 60.0), ("h", 3600.0), ("", 1.0)];
        with_unit(text, &units).map(Self).ok_or_else(|| "expected a time such as 20ms, 1.5s, 10min or 8h".into())
    }
}

impl fmt::Display for Time {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}s", self.0)
    }
}

/// Parses a time above 0.
pub(super) fn positive_time(text: &str) -> Result<Time, String> {
    let Time(secs) = text.parse()?;
    if secs > 0.0 { Ok(Time(secs)) } else { Err("expected a time above 0".into()) }
}

/// Parses a finite number followed by one of `units` and returns it times the unit's factor. The first unit that fits counts.
fn with_unit(text: &str, units: &[(&str, f64)]) -> Option<f64> {
    units.iter().find_map(|(unit, factor)| {
        let number = text.trim().strip_suffix(unit)?.trim().parse::<f64>().ok()?;
        number.is_finite().then_some(number * factor)
    })
}

/// Option `--json [FILE]`.
#[derive(Debug, Default, clap::Args)]
pub struct Json {
    /// Print JSON in place of text; with a FILE, whose name ends in .json, print the text and write JSON to the file.
    #[arg(long, value_name = "FILE", num_args = 0..=1, default_missing_value = "-", value_parser = json_file())]
    json: Option<PathBuf>,
}

impl Json {
    /// Returns true if JSON takes the place of the text.
    pub fn is_printed(&self) -> bool {
        self.json.as_deref() == Some(Path::new("-"))
    }

    /// Returns the file to write.
    pub fn file(&self) -> Option<&Path> {
        self.json.as_deref().filter(|_| !self.is_printed())
    }

    /// Prints or writes `value`, as the option says; returns true if it is printed in place of the text.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn take(&self, value: &serde_json::Value) -> crate::Result<bool> {
        let json = format!("{value:#}\n");
        if self.is_printed() {
            print!("{}", printable(&json));
        } else if let Some(path) = self.file() {
            file::write(path, json.as_bytes())?;
        }
        Ok(self.is_printed())
    }

    /// As [`Json::take`], and prints `text` unless JSON takes its place.
    ///
    /// # Errors
    /// If the file can't be written.
    pub fn show(&self, value: &serde_json::Value, text: impl FnOnce() -> String) -> crate::Result<()> {
        if !self.take(value)? {
            println!("{}", printable(text().trim_end_matches('\n')));
        }
        Ok(())
    }
}

/// Returns the parser of `--json`. It takes no other file names, so that `--json` before a recording can't overwrite the
/// recording.
fn json_file() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path: PathBuf| {
        let is_json = path.extension().is_some_and(|ending| ending == "json");
        match is_json || path == Path::new("-") || path.starts_with("/dev") {
            true => Ok(path),
            false => Err("expected a name that ends in .json, or nothing; write --json behind the other arguments"),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_need_units_and_times_may_be_seconds() {
        for (text, metres) in [("4mm", 0.004), ("1 cm", 0.01), ("0.004m", 0.004), ("-2mm", -0.002)] {
            assert!((text.parse::<Length>().unwrap().0 - metres).abs() < 1e-12, "{text}");
        }
        for text in ["4", "mm", "", "4km", "infmm", "nanm", "4mmm"] {
            assert!(text.parse::<Length>().unwrap_err().contains("4mm"), "{text}");
        }
        for (text, secs) in
            [("20ms", 0.02), ("1.5s", 1.5), ("2", 2.0), ("10min", 600.0), ("10m", 600.0), ("8h", 28800.0)]
        {
            assert!((text.parse::<Time>().unwrap().0 - secs).abs() < 1e-9, "{text}");
        }
        for text in ["s", "", "1d", "nan", "infs"] {
            assert!(text.parse::<Time>().is_err(), "{text}");
        }
        assert!(positive_time("0s").is_err() && positive_time("-1").is_err());
    }

    #[test]
    fn a_length_reads_back_as_it_is_shown() {
        for text in ["4mm", "0.1mm", "12.5mm", "0mm"] {
            assert_eq!(text.parse::<Length>().unwrap().to_string(), text);
        }
    }
}
