//! Files of the page, and the description of the sources.

use serde_json::{Value, json};

use super::feed::Feed;
use crate::hand::Region;
use crate::hand::Side;
use crate::render::color::{UNKNOWN, force_color, region_color};

/// Number of colours of the ramp.
const RAMP: usize = 256;

/// A file of the page: path, media type, content.
pub(super) const FILES: [(&str, &str, &str); 6] = [
    ("/", "text/html; charset=utf-8", include_str!("page/index.html")),
    ("/style.css", "text/css; charset=utf-8", include_str!("page/style.css")),
    ("/view.js", "text/javascript; charset=utf-8", include_str!("page/view.js")),
    ("/hands.js", "text/javascript; charset=utf-8", include_str!("page/hands.js")),
    ("/chart.js", "text/javascript; charset=utf-8", include_str!("page/chart.js")),
    ("/link.js", "text/javascript; charset=utf-8", include_str!("page/link.js")),
];

/// Describes the sources and the colours.
pub(super) fn about(feeds: &[Feed]) -> Value {
    let ramp: Vec<[u8; 3]> = (0..RAMP).map(|i| force_color(i as f32, (RAMP - 1) as f32).0).collect();
    json!({
        "version": crate::VERSION,
        "sources": feeds.iter().map(Feed::about).collect::<Vec<_>>(),
        "ramp": ramp,
        "unknown": UNKNOWN.0,
        "region_colors": Region::ALL.map(|region| region_color(region).0),
        "sides": Side::BOTH.map(Side::name),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_asks_for_nothing_but_its_own_files() {
        for (path, _, text) in FILES {
            for outside in ["http://", "https://", "//cdn", "@import", "eval("] {
                let allowed = text.replace("http://www.w3.org", "");
                assert!(!allowed.contains(outside), "{path} contains {outside}");
            }
            let named = text.split(['"', '\'']).filter(|word| word.starts_with('/') && word.ends_with(".js"));
            for word in named {
                assert!(FILES.iter().any(|(path, ..)| *path == word), "{path} names {word}");
            }
        }
    }
}
