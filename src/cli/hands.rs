//! Which hand models a command uses: the built-in ones, or MANO files.

use std::path::PathBuf;

use crate::hand::{HandModel, Side};

/// Arguments that name hand models.
#[derive(Debug, Default, clap::Args)]
pub struct Hands {
    /// Left MANO file in place of the built-in hand; needs --mano-right.
    #[arg(long, requires = "mano_right")]
    pub mano_left: Option<PathBuf>,
    /// Right MANO file in place of the built-in hand; needs --mano-left.
    #[arg(long, requires = "mano_left")]
    pub mano_right: Option<PathBuf>,
}

impl Hands {
    /// The models of the files, if they were given.
    ///
    /// # Errors
    /// If one can't be read.
    pub fn files(&self) -> crate::Result<Option<[HandModel; 2]>> {
        match (&self.mano_left, &self.mano_right) {
            (Some(left), Some(right)) => {
                Ok(Some([HandModel::load(left, Side::Left)?, HandModel::load(right, Side::Right)?]))
            }
            _ => Ok(None),
        }
    }

    /// The models to use.
    ///
    /// # Errors
    /// If a file can't be read.
    #[cfg_attr(not(feature = "sim"), allow(dead_code))]
    pub fn models(&self) -> crate::Result<[HandModel; 2]> {
        Ok(self.files()?.unwrap_or_else(|| Side::BOTH.map(HandModel::builtin)))
    }
}
