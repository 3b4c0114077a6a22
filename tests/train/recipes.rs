//! The recipes of `models/` are configurations that training accepts.

use std::path::Path;

use egotac::train::Config;

#[test]
fn every_recipe_parses_and_names_what_an_earlier_one_makes() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let card = std::fs::read_to_string(folder.join("README.md")).unwrap();
    let mut count = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_none_or(|extension| extension != "yaml") {
            continue;
        }
        let config = Config::read_unchecked(&path).unwrap();
        // The files that it reads come from commands of the card.
        let stores = config.data.iter().flat_map(|source| &source.stores).chain(&config.validation);
        for store in stores {
            assert!(card.contains(&format!("--out {}", store.display())), "{}: {}", path.display(), store.display());
        }
        let name = path.file_name().unwrap().to_str().unwrap();
        assert!(card.contains(&format!("egotac train --config models/{name}")), "{name}");
        count += 1;
    }
    assert!(count > 10, "{count}");
}
