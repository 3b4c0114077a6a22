//! Transforms between coordinate frames, from `/tf` and `/tf_static`.

mod buffer;
mod tree;

use std::sync::{Arc, Mutex, MutexGuard};

use super::input_topics::{InputTopic, Need};
use super::lock::lock;
use super::log::Log;
use super::qos;
use super::runtime::Runtime;
use crate::error::Result;
use crate::message::TFMessage;
pub(crate) use tree::{FrameTree, LookupError};

/// Transforms that the node has received; clones share them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Transforms(Arc<Mutex<FrameTree>>);

impl Transforms {
    /// Subscribes to `/tf` and `/tf_static`.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub(crate) fn subscribe(runtime: &mut Runtime) -> anyhow::Result<Self> {
        let transforms = Self::default();
        for (name, qos, is_static) in
            [("/tf", qos::transforms(), false), ("/tf_static", qos::transforms().transient_local(), true)]
        {
            let input = InputTopic { name: name.into(), content: "frames", qos, matches: false, need: Need::Optional };
            let (to, log) = (transforms.clone(), runtime.log().clone());
            runtime.input::<TFMessage>(input, move |message| to.take(message, name, is_static, &log))?;
        }
        Ok(transforms)
    }

    /// Locks the tree of frames.
    pub(crate) fn tree(&self) -> MutexGuard<'_, FrameTree> {
        lock(&self.0)
    }

    fn take(&self, message: Result<TFMessage>, topic: &str, is_static: bool, log: &Log) {
        let message = match message {
            Ok(message) => message,
            Err(error) => return log.warn_throttled(topic, format!("{topic}: message left out: {error}")),
        };
        for transform in &message.transforms {
            if let Err(error) = self.tree().insert(transform, is_static) {
                log.warn_throttled(topic, format!("{topic}: transform left out: {error}"));
            }
        }
    }
}
