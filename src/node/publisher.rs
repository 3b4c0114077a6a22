//! Publisher of messages of one type.

use std::marker::PhantomData;

use anyhow::Context as _;
use r2r::QosProfile;

use crate::message::Message;

/// Publishes messages of type `M`; can move to another thread, and fails once the node is dropped.
pub(crate) struct Publisher<M> {
    inner: r2r::PublisherUntyped,
    message: PhantomData<fn(&M)>,
}

impl<M: Message> Publisher<M> {
    /// Creates a publisher on `topic` (relative, private or absolute; remappable).
    ///
    /// # Errors
    /// If ROS refuses the topic name or the quality of service.
    pub(crate) fn create(node: &mut r2r::Node, topic: &str, qos: QosProfile) -> anyhow::Result<Self> {
        let inner = node.create_publisher_untyped(topic, M::TYPE, qos);
        let inner = inner.with_context(|| format!("cannot publish {topic} as {}", M::TYPE))?;
        Ok(Self { inner, message: PhantomData })
    }

    /// Publishes a message.
    ///
    /// # Errors
    /// If the node was dropped or the middleware refuses the message.
    pub(crate) fn publish(&self, message: &M) -> anyhow::Result<()> {
        Ok(self.inner.publish_raw(&message.to_cdr())?)
    }

    /// Returns the number of connected subscribers; 0 if ROS cannot count them.
    pub(crate) fn subscriber_count(&self) -> usize {
        self.inner.get_inter_process_subscription_count().unwrap_or(0)
    }
}
