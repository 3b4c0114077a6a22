//! Names of Python's modules, classes and functions that a pickle may contain. None of them is ever imported or called.

/// The names that occur in one kind of file.
#[derive(Debug)]
pub(crate) struct Names {
    /// Packages all of whose names may occur.
    pub packages: &'static [&'static str],
    /// Further names.
    pub names: &'static [&'static str],
    /// Kind of file, for messages.
    pub kind: &'static str,
}

/// Names in a file of a hand model: [`super::arrays`] interprets them, or ignores them as parts of objects.
pub(super) const HAND_MODEL: Names = Names {
    packages: &["numpy", "scipy.sparse", "chumpy"],
    names: &[
        "copy_reg._reconstructor",
        "copyreg._reconstructor",
        "__builtin__.object",
        "builtins.object",
        "__builtin__.set",
        "builtins.set",
        "__builtin__.bytearray",
        "builtins.bytearray",
        "_codecs.encode",
        "collections.OrderedDict",
        "collections.defaultdict",
    ],
    kind: "a hand model",
};

impl Names {
    /// True if the name of a module may occur.
    pub fn contain(&self, module: &str, name: &str) -> bool {
        let within = |package: &&str| module.strip_prefix(*package).is_some_and(|r| r.is_empty() || r.starts_with('.'));
        let known = |path: &&str| path.strip_suffix(name).and_then(|rest| rest.strip_suffix('.')) == Some(module);
        self.packages.iter().any(within) || self.names.iter().any(known)
    }
}
