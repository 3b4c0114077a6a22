//! Service `~/set_enabled`, which sets the parameter `enabled`.

use std::sync::Arc;

use r2r::std_srvs::srv::SetBool;

use super::runtime::Runtime;

/// Offers `~/set_enabled` on a node with the parameter `enabled`.
///
/// # Errors
/// If ROS refuses the service name.
pub(crate) fn serve_set_enabled(runtime: &mut Runtime) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    runtime.service::<SetBool::Service>("~/set_enabled", move |request| {
        let set = parameters.set([("enabled".to_owned(), request.data.into())]);
        SetBool::Response { success: set.is_ok(), message: set.err().unwrap_or_default() }
    })
}
