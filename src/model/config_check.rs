//! Reading and checking the geometry of a network.

use std::path::Path;

use super::config::Config;
use super::shapes;
use crate::error::{Error, Result};
use crate::file::limits;

/// Largest width. These limits are far beyond published networks; a larger number is a typing error.
const MAX_WIDTH: usize = 8192;
/// Largest number of layers of encoder or decoder.
const MAX_DEPTH: usize = 96;
/// Largest side of image or patch, pixels.
const MAX_IMAGE: usize = 4096;
/// Largest number of observation steps, tactile steps or register tokens.
const MAX_STEPS: usize = 256;
/// Largest number of patches along a side of an image. Memory for attention and for resampled positions grows with its
/// fourth power: 67 MB at 64, 1 GB at 128.
const MAX_GRID: usize = 64;
/// Largest number of values in the tokens of one observation window, whose multiples a predictor keeps: 134 MB in f32.
const MAX_WINDOW: usize = 1 << 25;

impl Config {
    /// Reads the JSON form.
    ///
    /// # Errors
    /// If it is not JSON, a key is unknown or missing, or a value is out of range.
    pub fn from_json(json: &str) -> Result<Self> {
        let config: Self = serde_json::from_str(json)
            .map_err(|error| Error::value("config", "JSON with exactly the keys of the network's geometry", error))?;
        config.check()?;
        Ok(config)
    }

    /// Checks ranges and divisibility; every network is built from a configuration that passed.
    ///
    /// # Errors
    /// Names the first key that is out of range, with its allowed values.
    pub fn check(&self) -> Result<()> {
        let ranges = [
            ("vision_width", self.vision_width, MAX_WIDTH),
            ("vision_depth", self.vision_depth, MAX_DEPTH),
            ("vision_heads", self.vision_heads, MAX_WIDTH),
            ("width", self.width, MAX_WIDTH),
            ("depth", self.depth, MAX_DEPTH),
            ("heads", self.heads, MAX_WIDTH),
            ("image", self.image, MAX_IMAGE),
            ("patch", self.patch, MAX_IMAGE),
            ("pretrain_image", self.pretrain_image, MAX_IMAGE),
            ("horizon", self.horizon, MAX_STEPS),
            ("predict", self.predict, MAX_STEPS),
        ];
        for (key, value, max) in ranges {
            if value == 0 || value > max {
                return Err(Error::value(format!("config.{key}"), format!("1 to {max}"), value));
            }
        }
        if self.registers > MAX_STEPS {
            return Err(Error::value("config.registers", format!("0 to {MAX_STEPS}"), self.registers));
        }
        let divisors = [
            ("vision_width", self.vision_width, "vision_heads", self.vision_heads),
            ("width", self.width, "heads", self.heads),
            ("image", self.image, "patch", self.patch),
            ("pretrain_image", self.pretrain_image, "patch", self.patch),
        ];
        for (key, value, divisor_key, divisor) in divisors {
            if value % divisor != 0 {
                let expected = format!("a multiple of {divisor_key} = {divisor}");
                return Err(Error::value(format!("config.{key}"), expected, value));
            }
        }
        self.check_sizes()
    }

    /// Checks the sizes that follow from several keys, which are in range.
    fn check_sizes(&self) -> Result<()> {
        for (key, grid) in [("image", self.grid()), ("pretrain_image", self.pretrain_grid())] {
            if grid > MAX_GRID {
                let expected = format!("at most {MAX_GRID} patches along a side");
                return Err(Error::value(format!("config.{key}"), expected, grid));
            }
        }
        let window = self.horizon * self.tokens() * self.width;
        if window > MAX_WINDOW {
            let expected = format!("at most {MAX_WINDOW} values in the tokens of a window (horizon x tokens x width)");
            return Err(Error::value("config.horizon", expected, window));
        }
        limits::PARAMETERS.check(Path::new("config"), "size", shapes::count(&shapes::of_network(self)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_passes_its_own_check_and_survives_json() {
        for name in Config::PRESETS {
            let config = Config::preset(name).unwrap();
            config.check().unwrap();
            assert_eq!(Config::from_json(&config.to_json()).unwrap(), config, "{name}");
        }
        let error = Config::preset("huge").unwrap_err().to_string();
        assert!(error.contains("huge") && error.contains("pocket"), "{error}");
    }

    #[test]
    fn a_config_with_an_unknown_missing_or_impossible_key_is_refused() {
        let json = Config::toy().to_json();
        for (from, to, names) in [
            ("\"depth\":2", "\"depht\":2", "depht"),
            ("\"depth\":2,", "", "depth"),
            ("\"heads\":4", "\"heads\":5", "config.width"),
            ("\"image\":56", "\"image\":57", "config.image"),
            ("\"horizon\":3", "\"horizon\":0", "config.horizon"),
            ("\"predict\":2", "\"predict\":-1", "-1"),
            (
                "\"image\":56,\"patch\":14,\"pretrain_image\":70",
                "\"image\":65,\"patch\":1,\"pretrain_image\":5",
                "config.image",
            ),
            (
                "\"image\":56,\"patch\":14,\"pretrain_image\":70",
                "\"image\":5,\"patch\":1,\"pretrain_image\":65",
                "config.pretrain_image",
            ),
            (
                "\"width\":32,\"depth\":2,\"heads\":4,\"image\":56,\"patch\":14,\"pretrain_image\":70,\"horizon\":3",
                "\"width\":64,\"depth\":2,\"heads\":4,\"image\":64,\"patch\":1,\"pretrain_image\":5,\"horizon\":256",
                "config.horizon",
            ),
            (
                "\"width\":32,\"depth\":2,\"heads\":4",
                "\"width\":8192,\"depth\":96,\"heads\":4",
                "at most 2000000000 parameters",
            ),
        ] {
            assert!(json.contains(from), "{json}");
            let error = Config::from_json(&json.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains(names), "{to}: {error}");
        }
    }
}
