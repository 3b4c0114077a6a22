//! Service `~/set_enabled`, which sets the parameter `enabled`.

use std::rc::Rc;

use anyhow::Context as _;
use r2r::std_srvs::srv::SetBool;

use super::parameter_services::Setter;
use super::runtime::Runtime;

/// Offers `~/set_enabled` on a node with the parameter `enabled`.
///
/// # Errors
/// If ROS refuses the service name.
pub(crate) fn serve_set_enabled(runtime: &mut Runtime) -> anyhow::Result<()> {
    let setter = runtime.extension::<Rc<Setter>>().context("the node has no parameter services")?;
    let setter = Rc::clone(setter);
    runtime.service::<SetBool::Service>("~/set_enabled", move |request| {
        let set = setter.set_one("enabled", request.data);
        SetBool::Response { success: set.is_ok(), message: set.err().unwrap_or_default() }
    })
}
