//! Keys of a file from the types that it is read into: names, descriptions and choices, taken from Rust source.

use std::collections::BTreeMap;

/// Key of a file: its name, its description, and its keys if it holds others.
pub(super) struct Key {
    pub(super) name: String,
    pub(super) text: String,
    pub(super) holds: Holds,
    pub(super) below: Vec<Key>,
}

/// Form in which a key holds other keys.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Holds {
    /// Itself has them, if there are any.
    Keys,
    /// A list of entries has them.
    List,
    /// Entries under names of the user's choice have them.
    Map,
    /// One of several forms has them; the keys below are the forms.
    Choice,
}

/// Structs and enums in Rust source as rustfmt writes it.
#[derive(Default)]
pub(super) struct Types {
    structs: BTreeMap<String, Vec<Field>>,
    enums: BTreeMap<String, Vec<Variant>>,
}

/// Field of a struct: name, type, and doc comment.
struct Field {
    name: String,
    kind: String,
    text: String,
}

/// Variant of an enum, with its fields.
struct Variant {
    name: String,
    text: String,
    fields: Vec<Field>,
}

impl Types {
    /// Reads the types of sources.
    pub(super) fn read(sources: &[&str]) -> Self {
        let mut types = Self::default();
        sources.iter().for_each(|source| types.add(source));
        types
    }

    fn add(&mut self, source: &str) {
        let mut lines = source.lines();
        while let Some(line) = lines.next() {
            let line = line.strip_prefix("pub ").unwrap_or(line);
            let named =
                |word: &str| line.strip_prefix(word).and_then(|rest| rest.strip_suffix(" {")).map(str::to_owned);
            if let Some(name) = named("struct ") {
                let body = lines.by_ref().take_while(|line| *line != "}");
                self.structs.insert(name, fields(body, "    "));
            } else if let Some(name) = named("enum ") {
                let body: Vec<&str> = lines.by_ref().take_while(|line| *line != "}").collect();
                // A file has no such form for variants without names inside.
                if !body.iter().any(|line| line.starts_with("    ") && line.ends_with("),")) {
                    self.enums.insert(name, variants(&body));
                }
            }
        }
    }

    /// Returns the keys of the struct `name`, in the order of the source.
    pub(super) fn keys(&self, name: &str) -> Vec<Key> {
        self.structs.get(name).map(|fields| fields.iter().map(|field| self.key(field)).collect()).unwrap_or_default()
    }

    fn key(&self, field: &Field) -> Key {
        let (holds, kind) = inner(&field.kind);
        let mut key = Key { name: field.name.clone(), text: self.described(field), holds, below: self.keys(kind) };
        let Some(variants) = self.enums.get(kind) else { return key };
        match variants.iter().all(|variant| variant.fields.is_empty()) {
            true => {
                let names: Vec<String> = variants.iter().map(|variant| format!("`{}`", variant.name)).collect();
                key.text += &format!(" One of {}.", names.join(", "));
            }
            false => {
                let form = |variant: &Variant| Key {
                    name: variant.name.clone(),
                    text: variant.text.clone(),
                    holds: Holds::Keys,
                    below: variant.fields.iter().map(|field| self.key(field)).collect(),
                };
                (key.holds, key.below) = (Holds::Choice, variants.iter().map(form).collect());
            }
        }
        key
    }

    /// Returns the description of a field; one that only names a struct takes that of the struct's field of the same name.
    fn described(&self, field: &Field) -> String {
        let other = field.text.strip_prefix("See `").and_then(|rest| rest.strip_suffix("`."));
        let named = other.and_then(|name| self.structs.get(name)?.iter().find(|other| other.name == field.name));
        named.map_or(&field.text, |other| &other.text).clone()
    }
}

/// Returns the type whose keys a field of type `kind` has, and how it holds them.
fn inner(kind: &str) -> (Holds, &str) {
    let within = |outer: &str| kind.strip_prefix(outer).and_then(|rest| rest.strip_suffix('>'));
    if let Some(kind) = within("Option<") {
        return inner(kind);
    }
    if let Some(kind) = within("Vec<") {
        return (Holds::List, kind);
    }
    match within("BTreeMap<").and_then(|rest| rest.split_once(", ")) {
        Some((_, kind)) => (Holds::Map, kind),
        // Checked options are read as the struct of their values.
        None if kind == "PhysicsOptions" => (Holds::Keys, "Unchecked"),
        // A list, or the word `auto`.
        None if kind == "CouplingsSpec" => (Holds::List, "CouplingSpec"),
        None => (Holds::Keys, kind),
    }
}

/// Returns the fields in the lines of a body that is indented by `indent`.
fn fields<'a>(body: impl Iterator<Item = &'a str>, indent: &str) -> Vec<Field> {
    let (mut fields, mut text) = (Vec::new(), Vec::new());
    for line in body.filter_map(|line| line.strip_prefix(indent)) {
        if let Some(doc) = line.strip_prefix("/// ") {
            text.push(doc);
        } else if let Some((name, kind)) = line.strip_prefix("pub ").unwrap_or(line).split_once(": ")
            && !name.starts_with(['#', ' ', '/'])
        {
            fields.push(Field { name: name.into(), kind: kind.trim_end_matches(',').into(), text: joined(&text) });
            text.clear();
        }
    }
    fields
}

/// Returns the variants in the lines of an enum's body; YAML has their names in lower case, or other names that they give.
fn variants(body: &[&str]) -> Vec<Variant> {
    let (mut variants, mut text, mut renamed) = (Vec::new(), Vec::new(), None);
    for (index, line) in body.iter().enumerate() {
        let Some(line) = line.strip_prefix("    ") else { continue };
        if let Some(doc) = line.strip_prefix("/// ") {
            text.push(doc);
        } else if let Some(name) = line.strip_prefix("#[serde(rename = \"").and_then(|rest| rest.strip_suffix("\")]")) {
            renamed = Some(name.to_owned());
        } else if line.starts_with(|first: char| first.is_ascii_uppercase()) {
            let has_fields = line.ends_with(" {");
            let own = body[index + 1..].iter().copied().take_while(|line| has_fields && *line != "    },");
            let name = renamed.take().unwrap_or_else(|| line.trim_end_matches([' ', '{', ',']).to_lowercase());
            variants.push(Variant { name, text: joined(&text), fields: fields(own, "        ") });
            text.clear();
        }
    }
    variants
}

/// Returns a doc comment in one line; links of rustdoc are plain code elsewhere.
fn joined(lines: &[&str]) -> String {
    lines.join(" ").replace("[`", "`").replace("`]", "`")
}
