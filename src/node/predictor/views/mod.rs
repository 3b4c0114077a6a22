//! Topics that show touch in other forms than `~/tactile`. Each is computed only while it has a subscriber.

mod cloud;
mod contacts;
mod hands;
mod keypoints;
mod markers;
mod overlay;
pub(super) mod regions;
mod wrenches;

use std::sync::Arc;

use ::image::RgbImage;

use super::camera::Camera;
use crate::hand::HandModel;
use crate::image::Preparation;
use crate::message::TactileFrame;
use crate::model::Prediction;
use crate::node::params::Parameters;
use crate::node::runtime::Runtime;
use cloud::Cloud;
use contacts::Contacts;
use hands::Hands;
use keypoints::Keypoints;
use markers::Markers;
use overlay::Overlay;
use regions::Regions;
use wrenches::Wrenches;

/// Publishers of all views.
pub(super) struct Views {
    hands: Hands,
    regions: Regions,
    cloud: Cloud,
    markers: Markers,
    wrenches: Wrenches,
    overlay: Overlay,
    contacts: Contacts,
    keypoints: Keypoints,
    parameters: Arc<Parameters>,
}

impl Views {
    /// Creates the publishers of touch that `camera` sees on `models`, left first, and subscribes to the hand poses.
    ///
    /// # Errors
    /// If ROS refuses a topic.
    pub(super) fn create(runtime: &mut Runtime, camera: &Camera, models: [HandModel; 2]) -> anyhow::Result<Self> {
        let hands = Hands::subscribe(runtime, camera, models)?;
        Ok(Self {
            regions: Regions::create(runtime, &camera.output("regions"), &hands.models)?,
            cloud: Cloud::create(runtime, &camera.output("points"))?,
            markers: Markers::create(runtime, &camera.output("markers"))?,
            wrenches: Wrenches::create(runtime, camera, &hands.models)?,
            overlay: Overlay::create(runtime, &camera.output("overlay/compressed"), &hands.models)?,
            contacts: Contacts::create(runtime, &camera.output("contacts"), &hands.models)?,
            keypoints: Keypoints::create(runtime, &camera.output("keypoints"))?,
            parameters: Arc::clone(runtime.parameters()),
            hands,
        })
    }

    /// Publishes each view of the touch in `image`, which was prepared by `preparation`, that has a subscriber. Touch of another
    /// topology than the hands' is not shown.
    ///
    /// # Errors
    /// If the node is gone or the middleware refuses a message.
    pub(super) fn publish(
        &mut self,
        frame: &TactileFrame,
        prediction: &Prediction,
        image: &RgbImage,
        preparation: &Preparation,
    ) -> anyhow::Result<()> {
        self.keypoints.publish(&frame.header, prediction, preparation, image.dimensions())?;
        let field = &prediction.field;
        if field.topology != self.hands.models[0].topology {
            return Ok(());
        }
        self.regions.publish(frame)?;
        let threshold = self.parameters.get::<f64>("contact_threshold") as f32;
        let points = self.parameters.get::<bool>("publish_points") && self.cloud.is_wanted();
        let contacts = self.parameters.get::<bool>("publish_contacts") && self.contacts.is_wanted();
        if points || contacts || self.markers.is_wanted() || self.wrenches.are_wanted() {
            let (header, hands) = self.hands.at(&frame.header);
            if points {
                self.cloud.publish(header.clone(), field, &hands, threshold)?;
            }
            if contacts {
                let touch = (field, &prediction.certainty);
                self.contacts.publish(&header, touch, &hands, &self.hands.models, threshold)?;
            }
            self.markers.publish(&header, field, &hands, &self.hands.models)?;
            self.wrenches.publish(&header, field, &hands, &self.hands.models)?;
        }
        self.overlay.publish(&frame.header, field, image, &self.hands.models)
    }
}
