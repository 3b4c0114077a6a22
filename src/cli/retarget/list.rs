//! `egotac retarget list`.

use super::List;
use crate::retarget::robot::catalogue::{self, Listed};

/// Prints the robots that are part of the program, and where their models are or come from.
///
/// # Errors
/// If a robot's file can't be read.
pub fn list(args: &List) -> anyhow::Result<()> {
    let robots = catalogue::list()?;
    Ok(args.json.show(&serde_json::to_value(&robots)?, || table(&robots))?)
}

/// Returns one line per robot: name, whether its model is found, and the model or its source.
fn table(robots: &[Listed]) -> String {
    let width = robots.iter().map(|robot| robot.name.len()).max().unwrap_or(0);
    let line = |robot: &Listed| {
        let (usable, model) = match &robot.found {
            Some(found) => ("usable", found),
            None => ("no model", &robot.source),
        };
        format!("{:width$}  {usable:8}  {model}\n", robot.name)
    };
    robots.iter().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_robot_has_a_line_with_its_model_or_the_source_of_it() {
        let found = Listed { name: "a", found: Some("/models/a.xml".into()), source: "there".into() };
        let missing = Listed { name: "long_name", found: None, source: "there".into() };
        assert_eq!(table(&[found, missing]), "a          usable    /models/a.xml\nlong_name  no model  there\n");
    }
}
