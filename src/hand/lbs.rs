//! Linear blend skinning.

use super::{HandModel, HandParams, PosedHand};

pub(super) fn forward(_model: &HandModel, _params: &HandParams) -> PosedHand {
    unimplemented!()
}
