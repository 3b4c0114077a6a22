//! MANO files.

use std::path::Path;

use super::{HandModel, Side};
use crate::error::Result;

pub(super) fn load(_path: &Path, _side: Side) -> Result<HandModel> {
    Err(crate::error::Error::file(_path, "MANO files are not read yet"))
}
