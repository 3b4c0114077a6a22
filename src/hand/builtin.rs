//! The built-in 778-vertex hand.

use super::{HandModel, Side};

pub(super) fn hand(_side: Side) -> HandModel {
    unimplemented!()
}
