//! Topic names as ROS resolves them: expanded by namespace and node, then remapped by the command line.
//!
//! A transport's topic is the resolved image topic with `/compressed` behind it; r2r does not offer the resolution.

/// Names and remapping rules of one node.
#[derive(Debug)]
pub(super) struct Names {
    namespace: String,
    node: String,
    rules: Vec<Rule>,
}

#[derive(Debug, PartialEq)]
struct Rule {
    /// The only node it is for; None = all.
    node: Option<String>,
    from: String,
    to: String,
}

impl Names {
    /// Of the node `node` in `namespace` (`/` or `/a/b`), started with the command line `arguments`.
    pub(super) fn new(namespace: &str, node: &str, arguments: impl IntoIterator<Item = String>) -> Self {
        Self { namespace: namespace.to_owned(), node: node.to_owned(), rules: rules(arguments) }
    }

    /// The full name of `topic` after remapping.
    pub(super) fn resolve(&self, topic: &str) -> String {
        let full = self.expand(topic);
        let matching =
            |rule: &&Rule| rule.node.as_ref().is_none_or(|node| *node == self.node) && self.expand(&rule.from) == full;
        match self.rules.iter().find(matching) {
            Some(rule) => self.expand(&rule.to),
            None => full,
        }
    }

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

/// The rules `[node:]from:=to` after `-r` or `--remap`, between `--ros-args` and `--`.
fn rules(arguments: impl IntoIterator<Item = String>) -> Vec<Rule> {
    let mut rules = Vec::new();
    let mut for_ros = false;
    let mut arguments = arguments.into_iter();
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--ros-args" => for_ros = true,
            "--" => for_ros = false,
            "-r" | "--remap" if for_ros => rules.extend(arguments.next().as_deref().and_then(rule)),
            _ => {}
        }
    }
    rules
}

fn rule(text: &str) -> Option<Rule> {
    let (left, to) = text.split_once(":=")?;
    let (node, from) = match left.split_once(':') {
        // `rostopic://name` names a topic, not a node.
        Some((_, rest)) if rest.starts_with("//") => (None, left),
        Some((node, from)) => (Some(node.to_owned()), from),
        None => (None, left),
    };
    let strip = |name: &str| name.strip_prefix("rostopic://").unwrap_or(name).to_owned();
    // `__ns` and `__node` rename the node, which already happened.
    (!from.starts_with("__")).then(|| Rule { node, from: strip(from), to: strip(to) })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn resolve(topic: &str, arguments: &str) -> String {
        Names::new("/robot", "predictor", arguments.split_whitespace().map(String::from)).resolve(topic)
    }

    #[test]
    fn names_expand_as_ros_expands_them() {
        assert_eq!(resolve("image", ""), "/robot/image");
        assert_eq!(resolve("~/tactile", ""), "/robot/predictor/tactile");
        assert_eq!(resolve("/image", ""), "/image");
        assert_eq!(Names::new("/", "n", []).resolve("image"), "/image");
    }

    #[test]
    fn the_first_rule_that_matches_remaps() {
        assert_eq!(resolve("image", "--ros-args -r image:=/cam/image_raw"), "/cam/image_raw");
        assert_eq!(resolve("image", "--ros-args --remap /robot/image:=cam"), "/robot/cam");
        assert_eq!(resolve("image", "--ros-args -r image:=a -r image:=b"), "/robot/a");
        assert_eq!(resolve("image", "--ros-args -r predictor:image:=a"), "/robot/a");
        assert_eq!(resolve("image", "--ros-args -r other:image:=a -r rostopic://image:=b"), "/robot/b");
    }

    #[test]
    fn what_is_not_for_ros_does_not_remap() {
        assert_eq!(resolve("image", "-r image:=a"), "/robot/image");
        assert_eq!(resolve("image", "--ros-args -- -r image:=a"), "/robot/image");
        assert_eq!(resolve("image", "--ros-args -r __node:=image -p image:=a"), "/robot/image");
    }
}
