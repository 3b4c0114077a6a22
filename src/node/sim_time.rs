//! Parameter `use_sim_time` while the node runs.

use std::time::Duration;

use super::runtime::Runtime;

/// Time between two looks at the parameter; bounds the delay of a change.
const INTERVAL: Duration = Duration::from_millis(50);

/// Takes the time from `/clock` or from the wall clock, as the parameter says, also when it changes.
pub(crate) fn follow_parameter(runtime: &mut Runtime) {
    let mut is_simulated = runtime.parameters().get::<bool>("use_sim_time");
    runtime.every(INTERVAL, move |runtime| {
        let wanted = runtime.parameters().get::<bool>("use_sim_time");
        if wanted == is_simulated {
            return;
        }
        match runtime.simulate_time(wanted) {
            Ok(()) => {
                runtime.log().info(if wanted { "takes the time from /clock" } else { "takes the wall clock's time" })
            }
            Err(error) => runtime.log().error(format!("use_sim_time: {error:#}")),
        }
        // Also after an error, which would only repeat.
        is_simulated = wanted;
    });
}
