//! Topic names as ROS resolves them: expanded by namespace and node name, then remapped by the command line.
//!
//! r2r does not offer this resolution, and the compressed image topic needs it: its name is the resolved image topic
//! followed by `/compressed`.

use super::ros_arguments::{RosArgument, ros_arguments};

/// Name, namespace and remapping rules of one node.
pub(crate) struct TopicNames {
    namespace: String,
    node: String,
    rules: Vec<RemapRule>,
}

struct RemapRule {
    /// Node that the rule applies to; None = all nodes.
    node: Option<String>,
    from: String,
    to: String,
}

impl TopicNames {
    /// Collects the rules of the node `node` in `namespace` (`/` or `/a/b`) from the command line `arguments`.
    pub(crate) fn new(namespace: &str, node: &str, arguments: impl IntoIterator<Item = String>) -> Self {
        let rules = ros_arguments(arguments).filter_map(|argument| match argument {
            RosArgument::Remap(rule) => remap_rule(&rule),
            _ => None,
        });
        Self { namespace: namespace.to_owned(), node: node.to_owned(), rules: rules.collect() }
    }

    /// Returns the full name of `topic` after remapping.
    pub(crate) fn resolve(&self, topic: &str) -> String {
        let full = self.expand(topic);
        let matching = |rule: &&RemapRule| {
            rule.node.as_ref().is_none_or(|node| *node == self.node) && self.expand(&rule.from) == full
        };
        match self.rules.iter().find(matching) {
            Some(rule) => self.expand(&rule.to),
            None => full,
        }
    }

    /// Returns the full name of a relative, private or absolute name.
    fn expand(&self, name: &str) -> String {
        let namespace = self.namespace.trim_end_matches('/');
        if name.starts_with('/') {
            name.to_owned()
        } else if let Some(rest) = name.strip_prefix('~') {
            format!("{namespace}/{}{rest}", self.node)
        } else {
            format!("{namespace}/{name}")
        }
    }
}

/// Parses `[node:]from:=to`; None if `text` is not a topic remapping rule.
fn remap_rule(text: &str) -> Option<RemapRule> {
    let (left, to) = text.split_once(":=")?;
    let (node, from) = match left.split_once(':') {
        // `rostopic://name` names a topic, not a node.
        Some((_, rest)) if rest.starts_with("//") => (None, left),
        Some((node, from)) => (Some(node.to_owned()), from),
        None => (None, left),
    };
    let strip = |name: &str| name.strip_prefix("rostopic://").unwrap_or(name).to_owned();
    // `__ns` and `__node` rename the node; ROS has applied them before.
    (!from.starts_with("__")).then(|| RemapRule { node, from: strip(from), to: strip(to) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(topic: &str, arguments: &str) -> String {
        TopicNames::new("/robot", "predictor", arguments.split_whitespace().map(String::from)).resolve(topic)
    }

    #[test]
    fn names_expand_as_ros_expands_them() {
        assert_eq!(resolve("image", ""), "/robot/image");
        assert_eq!(resolve("~/tactile", ""), "/robot/predictor/tactile");
        assert_eq!(resolve("/image", ""), "/image");
        assert_eq!(TopicNames::new("/", "n", []).resolve("image"), "/image");
    }

    #[test]
    fn the_first_matching_rule_remaps() {
        assert_eq!(resolve("image", "--ros-args -r image:=/cam/image_raw"), "/cam/image_raw");
        assert_eq!(resolve("image", "--ros-args --remap /robot/image:=cam"), "/robot/cam");
        assert_eq!(resolve("image", "--ros-args -r image:=a -r image:=b"), "/robot/a");
        assert_eq!(resolve("image", "--ros-args -r predictor:image:=a"), "/robot/a");
        assert_eq!(resolve("image", "--ros-args -r other:image:=a -r rostopic://image:=b"), "/robot/b");
    }

    #[test]
    fn arguments_outside_ros_args_do_not_remap() {
        assert_eq!(resolve("image", "-r image:=a"), "/robot/image");
        assert_eq!(resolve("image", "--ros-args -- -r image:=a"), "/robot/image");
        assert_eq!(resolve("image", "--ros-args -r __node:=image -p image:=a"), "/robot/image");
    }
}
