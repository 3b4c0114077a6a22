//! Holds no code: its dependencies fix the features of crates that egotac shares with others.
