//! Names of the experiments. The command line knows them also in a build that can't run them.

/// Experiments that train.
pub const TRAINED: [&str; 12] = [
    "sources",
    "consistency",
    "sampling",
    "glove",
    "history",
    "separation",
    "scaling",
    "ablations",
    "limits",
    "motion",
    "recordings",
    "hands",
];
/// Experiments that measure a finished network.
pub const MEASURED: [&str; 4] = ["transfer", "decline", "attention", "reuse"];
