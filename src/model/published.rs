//! Networks that others have published: where they lie, under which licence, and what becomes of their files here.

/// A published network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Published {
    /// Name in `egotac model get`.
    pub name: &'static str,
    /// Contents, for people.
    pub about: &'static str,
    /// Page with the licence.
    pub page: &'static str,
    /// Licence, as its page states it.
    pub licence: &'static str,
    /// Address of the file; None = it must be chosen on the page.
    pub file: Option<&'static str>,
    /// What the file is.
    pub kind: Kind,
}

/// Kind of a published file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A whole network, to be imported by a table of tensor names.
    Network,
    /// A DINOv2 encoder, from which `egotac model init` creates a network to train.
    Encoder,
}

/// Licence of the encoders.
const APACHE: &str = "Apache-2.0";

/// The published networks by name.
pub const PUBLISHED: [Published; 5] = [
    Published {
        name: "egotac",
        about: "the network of the paper EgoTac (arXiv 2608.15060); egotac is an unofficial implementation",
        page: "https://huggingface.co/wkzhang/EgoTac",
        licence: "not stated on the project's page: read it on the model's page before use",
        file: None,
        kind: Kind::Network,
    },
    encoder("dinov2-small", "https://huggingface.co/facebook/dinov2-small"),
    encoder("dinov2-base", "https://huggingface.co/facebook/dinov2-base"),
    encoder("dinov2-small-registers", "https://huggingface.co/facebook/dinov2-with-registers-small"),
    encoder("dinov2-base-registers", "https://huggingface.co/facebook/dinov2-with-registers-base"),
];

const fn encoder(name: &'static str, page: &'static str) -> Published {
    let about = "a DINOv2 encoder, for `egotac model init`";
    Published { name, about, page, licence: APACHE, file: Some("resolve/main/model.safetensors"), kind: Kind::Encoder }
}

impl Published {
    /// Finds a network by its name.
    pub fn find(name: &str) -> Option<&'static Self> {
        PUBLISHED.iter().find(|published| published.name == name)
    }

    /// Returns the address of the file; None = it must be chosen on the page.
    pub fn address(&self) -> Option<String> {
        Some(format!("{}/{}", self.page, self.file?))
    }
}
