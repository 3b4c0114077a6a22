//! The node's subscription to images.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use crate::node::diagnostics::Tally;
use crate::node::mailbox::Mailbox;
use crate::node::runtime::Runtime;
use crate::node::{images, qos};

/// What a subscription to images feeds.
pub struct Input {
    /// Where the newest one waits.
    pub images: Arc<Mailbox<Vec<u8>>>,
    /// What became of each.
    pub tally: Tally,
    /// Whether the subscription is reliable, once there is one.
    pub reliable: Arc<AtomicBool>,
}

/// Subscribes now, or with reliability `match` as soon as there is a publisher to match.
///
/// # Errors
/// If ROS refuses the name or the quality of service.
pub fn subscribe(runtime: &mut Runtime, input: Input) -> anyhow::Result<()> {
    let reliability = runtime.parameters().get::<String>("reliability");
    if reliability != "match" {
        return subscribe_as(runtime, reliability == "reliable", input);
    }
    let topic = images::topic(runtime);
    let mut waiting = Some(input);
    runtime.every(Duration::from_millis(100), move |runtime| {
        let reliable = match runtime.publishers_are_reliable(&topic) {
            Ok(publishers) if publishers.is_empty() => return,
            Ok(publishers) => publishers.iter().all(|reliable| *reliable),
            Err(error) => return runtime.log().warn_throttled("match", format!("{topic}: {error:#}")),
        };
        let Some(input) = waiting.take() else { return };
        if let Err(error) = subscribe_as(runtime, reliable, input) {
            runtime.log().error(format!("{topic}: {error:#}"));
        }
    });
    Ok(())
}

fn subscribe_as(runtime: &mut Runtime, reliable: bool, input: Input) -> anyhow::Result<()> {
    let parameters = Arc::clone(runtime.parameters());
    let Input { images: newest, tally, .. } = input;
    input.reliable.store(reliable, Ordering::Relaxed);
    let take = move |payload: Vec<u8>| {
        tally.received();
        match parameters.get("enabled") {
            true => newest.put(payload),
            false => tally.dropped("disabled"),
        }
    };
    let topic = images::topic(runtime);
    let kind = if reliable { "reliable" } else { "best effort" };
    runtime.log().info(format!("images from {topic}, {kind}"));
    images::subscribe(runtime, qos::sensor_input(reliable), take)
}
