//! Cameras of the predictor, by which its topics are named.

use anyhow::bail;

use crate::node::params::{Allowed, Parameter, Parameters};

/// Most cameras of one node; bounds the number of its topics.
const MAX_CAMERAS: usize = 16;
/// Names of the node's own topics and services. No camera may have one of them, or its topics would lie below that name.
const TAKEN: [&str; 10] = [
    "tactile",
    "regions",
    "contacts",
    "keypoints",
    "wrench",
    "markers",
    "overlay",
    "points",
    "model_info",
    "transition_event",
];

/// A camera of the node: the only one, or one of several.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Camera {
    /// Name of one of several cameras; empty for the only one.
    name: String,
}

impl Camera {
    /// Declares the parameter `cameras`.
    pub(super) fn parameter() -> Parameter {
        Parameter::fixed(
            "cameras",
            Vec::<String>::new(),
            Allowed::Any,
            "Names of several cameras: each NAME takes NAME/image and gives ~/NAME/tactile, and ~/tactile is fused from all; \
             empty = one camera, image.",
        )
    }

    /// Returns the cameras that the parameter `cameras` names, or the only one.
    ///
    /// # Errors
    /// If a name is not valid in a topic's name, is the name of one of the node's topics, or occurs twice.
    pub(super) fn all(parameters: &Parameters) -> anyhow::Result<Vec<Self>> {
        let names = parameters.get::<Vec<String>>("cameras");
        for (index, name) in names.iter().enumerate() {
            let is_part = name.starts_with(|c: char| c.is_ascii_alphabetic())
                && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
            if !is_part {
                bail!("parameter cameras: expected names of letters, digits and underscores, got {name:?}");
            }
            if TAKEN.contains(&name.as_str()) || names[..index].contains(name) {
                bail!(
                    "parameter cameras: expected names that differ from each other and from {}, got {name:?}",
                    TAKEN.join(", ")
                );
            }
        }
        if names.len() > MAX_CAMERAS {
            bail!("parameter cameras: expected at most {MAX_CAMERAS} names, got {}", names.len());
        }
        Ok(match names.is_empty() {
            true => vec![Self { name: String::new() }],
            false => names.into_iter().map(|name| Self { name }).collect(),
        })
    }

    /// True for one of several cameras.
    pub(super) fn is_named(&self) -> bool {
        !self.name.is_empty()
    }

    /// Name of one of several cameras; empty for the only one.
    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Returns the name of an input, for instance `left/image` or `image`.
    pub(super) fn input(&self, topic: &str) -> String {
        match self.is_named() {
            true => format!("{}/{topic}", self.name),
            false => topic.to_owned(),
        }
    }

    /// Returns the name of an output, for instance `~/left/tactile` or `~/tactile`.
    pub(super) fn output(&self, topic: &str) -> String {
        match self.is_named() {
            true => format!("~/{}/{topic}", self.name),
            false => format!("~/{topic}"),
        }
    }

    /// Returns the name of a frame of `/tf`, for instance `left_thumb` with the prefix of one of several cameras.
    pub(super) fn frame(&self, prefix: &str, frame: &str) -> String {
        match self.is_named() {
            true => format!("{prefix}{}_{frame}", self.name),
            false => format!("{prefix}{frame}"),
        }
    }

    /// Returns the name of the camera's task in diagnostics.
    pub(super) fn task(&self) -> String {
        match self.is_named() {
            true => format!("images {}", self.name),
            false => "images".to_owned(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cameras(names: &[&str]) -> anyhow::Result<Vec<Camera>> {
        let names = r2r::ParameterValue::StringArray(names.iter().map(|name| (*name).to_owned()).collect());
        Camera::all(&Parameters::new(&[Camera::parameter()], [("cameras", &names)])?.0)
    }

    #[test]
    fn topics_of_several_cameras_lie_in_namespaces_and_those_of_one_do_not() {
        let [only] = cameras(&[]).unwrap().try_into().unwrap();
        assert_eq!((only.input("image"), only.output("tactile")), ("image".into(), "~/tactile".into()));
        assert_eq!((only.frame("a_", "left_thumb"), only.task()), ("a_left_thumb".into(), "images".into()));
        let [left, _] = cameras(&["left", "wrist_2"]).unwrap().try_into().unwrap();
        assert_eq!((left.input("image"), left.output("tactile")), ("left/image".into(), "~/left/tactile".into()));
        assert_eq!((left.frame("", "left_thumb"), left.task()), ("left_left_thumb".into(), "images left".into()));
    }

    #[test]
    fn names_that_are_no_topics_or_come_twice_are_refused_by_name() {
        for names in [&["a/b"][..], &[""], &["1st"], &["kinect-2"], &["a", "b", "a"], &["regions"]] {
            let error = cameras(names).unwrap_err().to_string();
            assert!(error.contains(&format!("got {:?}", names[names.len() - 1])), "{error}");
        }
        assert!(cameras(&["c"; 17]).is_err());
    }
}
