//! Parameter `allowed_folder`: folder in which files must lie that other nodes name in services and goals.

use std::path::{Component, Path, PathBuf};

use anyhow::{Context as _, ensure};

use super::params::{Allowed, Parameter, Parameters};

/// Declares the parameter.
pub(crate) fn parameter() -> Parameter {
    Parameter::fixed(
        "allowed_folder",
        "",
        Allowed::Any,
        "Folder in which files must lie that services and goals name, links followed; empty = any.",
    )
}

/// Folder in which files must lie; none if any will do.
#[derive(Debug, Clone)]
pub(crate) struct AllowedFolder(Option<PathBuf>);

impl AllowedFolder {
    /// Reads the parameter.
    ///
    /// # Errors
    /// If the folder does not exist.
    pub(crate) fn of(parameters: &Parameters) -> anyhow::Result<Self> {
        match parameters.get::<String>("allowed_folder") {
            folder if folder.is_empty() => Ok(Self(None)),
            folder => Self::new(Path::new(&folder)),
        }
    }

    fn new(folder: &Path) -> anyhow::Result<Self> {
        let real = folder.canonicalize().with_context(|| format!("parameter allowed_folder: {}", folder.display()))?;
        Ok(Self(Some(real)))
    }

    /// Checks that a file or folder, which need not exist, lies in the allowed folder. `what` names it in the error.
    ///
    /// # Errors
    /// If it lies elsewhere, also by a link.
    pub(crate) fn check(&self, what: &str, path: &Path) -> anyhow::Result<()> {
        let Some(folder) = &self.0 else { return Ok(()) };
        let (expected, got) = (folder.display(), path.display());
        ensure!(
            real(path).is_some_and(|real| real.starts_with(folder)),
            "{what}: expected a path in {expected} (parameter allowed_folder), got {got}"
        );
        Ok(())
    }
}

/// Returns the path without links and dots; of the part that does not exist, only plain names are accepted.
fn real(path: &Path) -> Option<PathBuf> {
    let absolute = std::path::absolute(path).ok()?;
    let existing = absolute.ancestors().find(|part| part.symlink_metadata().is_ok())?;
    let rest = absolute.strip_prefix(existing).ok()?;
    let is_plain = rest.components().all(|component| matches!(component, Component::Normal(_)));
    let real = existing.canonicalize().ok()?;
    is_plain.then(|| real.join(rest))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_outside_of_the_folder_are_refused_also_by_dots_and_links() {
        let root = tempfile::tempdir().unwrap();
        let (inside, outside) = (root.path().join("in"), root.path().join("out"));
        std::fs::create_dir_all(inside.join("runs")).unwrap();
        std::fs::create_dir_all(&outside).unwrap();
        std::fs::write(outside.join("secret"), "x").unwrap();
        std::os::unix::fs::symlink(&outside, inside.join("link")).unwrap();
        std::os::unix::fs::symlink(outside.join("absent"), inside.join("dangling")).unwrap();
        let allowed = AllowedFolder::new(&inside).unwrap();
        let passes = |path: &str| allowed.check("model", &inside.join(path)).is_ok();
        assert!(passes("runs") && passes("runs/new/model.safetensors") && passes("") && passes("runs/../runs"));
        let refused =
            ["..", "../out/secret", "link/secret", "link/new", "dangling", "new/../../out/secret", "runs/../../out"];
        for path in refused {
            assert!(!passes(path), "{path}");
        }
        let error = allowed.check("model", Path::new("/etc/passwd")).unwrap_err().to_string();
        assert!(
            error.contains("model") && error.contains("/etc/passwd") && error.contains("allowed_folder"),
            "{error}"
        );
        assert!(AllowedFolder(None).check("model", Path::new("/etc/passwd")).is_ok());
        assert!(AllowedFolder::new(&root.path().join("none")).is_err());
    }
}
