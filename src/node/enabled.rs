//! Service `~/set_enabled`, which sets the parameter `enabled`.

use anyhow::Context as _;
use r2r::std_srvs::srv::SetBool;

use super::runtime::Runtime;

/// Offers `~/set_enabled` on a node with the parameter `enabled`.
///
/// # Errors
/// If ROS refuses the service name.
pub(crate) fn serve_set_enabled(runtime: &mut Runtime) -> anyhow::Result<()> {
    let setter = runtime.parameter_setter().context("the node has no parameter services")?;
    runtime.service::<SetBool::Service>("~/set_enabled", move |request| {
        let set = setter.set_one("enabled", request.data);
        SetBool::Response { success: set.is_ok(), message: set.err().unwrap_or_default() }
    })
}
