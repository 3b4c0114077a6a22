//! Topic `~/keypoints`: keypoints of both hands in the image, as the network estimates them.

use crate::image::Preparation;
use crate::message::{HandKeypoints, Header};
use crate::model::Prediction;
use crate::node::publisher::Publisher;
use crate::node::qos;
use crate::node::runtime::Runtime;

/// Publishes the keypoints.
pub(super) struct Keypoints(Publisher<HandKeypoints>);

impl Keypoints {
    /// Creates the publisher on `topic`.
    ///
    /// # Errors
    /// If ROS refuses the topic.
    pub(super) fn create(runtime: &mut Runtime, topic: &str) -> anyhow::Result<Self> {
        Ok(Self(runtime.publisher(topic, qos::output())?))
    }

    /// Publishes the keypoints in an image of `width` and `height`, pixels, if the topic has a subscriber and the network estimates
    /// them.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses the message.
    pub(super) fn publish(
        &self,
        header: &Header,
        prediction: &Prediction,
        preparation: &Preparation,
        (width, height): (u32, u32),
    ) -> anyhow::Result<()> {
        if self.0.subscriber_count() == 0 {
            return Ok(());
        }
        match HandKeypoints::from_prediction(header.clone(), prediction, preparation, (width, height)) {
            Some(message) => self.0.publish(&message),
            None => Ok(()),
        }
    }
}
