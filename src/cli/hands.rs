//! Arguments that several commands share: hand models, and the width of the force kernel.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use super::options::Length;
use crate::hand::{FieldMap, HandModel, Side};

/// Arguments that name hand models.
#[derive(Debug, Default, clap::Args)]
#[command(next_help_heading = "Hands")]
pub struct Hands {
    /// Left MANO file in place of the built-in hand; needs --mano-right.
    #[arg(long, requires = "mano_right")]
    pub mano_left: Option<PathBuf>,
    /// Right MANO file in place of the built-in hand; needs --mano-left.
    #[arg(long, requires = "mano_left")]
    pub mano_right: Option<PathBuf>,
    /// Registration of the files, made once.
    #[arg(skip)]
    registered: OnceLock<Arc<FieldMap>>,
}

impl Hands {
    /// Loads the MANO files, left first; `None` without files.
    ///
    /// # Errors
    /// If a file can't be read.
    pub fn files(&self) -> crate::Result<Option<[HandModel; 2]>> {
        match (&self.mano_left, &self.mano_right) {
            (Some(left), Some(right)) => {
                Ok(Some([HandModel::load(left, Side::Left)?, HandModel::load(right, Side::Right)?]))
            }
            _ => Ok(None),
        }
    }

    /// Loads the MANO files and registers the built-in hands on them; `None` without files.
    ///
    /// # Errors
    /// If a file can't be read.
    pub fn map(&self) -> crate::Result<Option<Arc<FieldMap>>> {
        match (&self.mano_left, &self.mano_right) {
            (Some(left), Some(right)) => {
                if let Some(map) = self.registered.get() {
                    return Ok(Some(Arc::clone(map)));
                }
                let map = Arc::new(FieldMap::load(left, right)?);
                Ok(Some(Arc::clone(self.registered.get_or_init(|| map))))
            }
            _ => Ok(None),
        }
    }

    /// Loads the MANO files, or returns the built-in hands, left first.
    ///
    /// # Errors
    /// If a file can't be read.
    #[cfg_attr(not(feature = "sim"), allow(dead_code))]
    pub fn models(&self) -> crate::Result<[HandModel; 2]> {
        Ok(self.files()?.unwrap_or_else(|| Side::BOTH.map(HandModel::builtin)))
    }
}

/// Width of the kernel that distributes a contact's force over vertices.
#[derive(Debug, clap::Args)]
#[command(next_help_heading = "Hands")]
pub struct Kernel {
    /// Standard deviation of the Gaussian that distributes a contact's force over vertices (label c).
    #[arg(long, value_name = "LENGTH", default_value = "4mm", value_parser = parse_sigma)]
    pub sigma: Length,
}

impl Kernel {
    /// Returns the standard deviation, m.
    #[cfg_attr(not(feature = "sim"), allow(dead_code))]
    pub fn metres(&self) -> f64 {
        self.sigma.0
    }
}

fn parse_sigma(text: &str) -> Result<Length, String> {
    let sigma: Length = text.parse()?;
    match (1e-4..=0.05).contains(&sigma.0) {
        true => Ok(sigma),
        false => Err("expected 0.1mm to 50mm".into()),
    }
}
