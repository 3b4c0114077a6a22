//! Layout of the page: HTML with embedded images and styles.

use std::fmt::Write;
use std::path::Path;

use super::frames::frames;
use super::regions::RegionRow;
use super::samples::Sample;
use super::trace::Trace;
use crate::dataset::Labelled;
use crate::hand::{Region, Side};
use crate::score::metrics::{Metrics, table};

const STYLE: &str = "
body { font: 15px/1.45 system-ui, sans-serif; color: #1e1e24; max-width: 1240px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; border-bottom: 1px solid #ddd; }
table { border-collapse: collapse; } th, td { padding: 2px 12px 2px 0; text-align: left; vertical-align: top; }
td.number { text-align: right; font-variant-numeric: tabular-nums; }
#samples { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 16px; } #samples.single { display: block; }
@media (max-width: 800px) { #samples { grid-template-columns: minmax(0, 1fr); } }
#samples.single figure { display: none; } #samples.single figure.shown { display: flex; }
figure { display: flex; flex-wrap: wrap; gap: 8px; margin: 0; padding: 10px; border: 1px solid #e2e2e0; border-radius: 6px; align-items: flex-start; }
figcaption { flex-basis: 100%; color: #555; font-size: 0.85em; } figure > img, .none { flex: 1 1 0; min-width: 0; max-width: 300px; object-fit: contain; }
.none { align-self: stretch; background: #eee; color: #666; padding: 1em; } .palms { display: grid; grid-template-columns: 1fr 1fr; flex: 1 1 0; gap: 6px; }
.palms div { text-align: center; font-size: 0.85em; } .palms img { display: block; max-width: 100%; margin: auto; } .scrub input { width: 24em; vertical-align: middle; }
#plots { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 10px 16px; } #plots:has(> :only-child) { grid-template-columns: minmax(0, 760px); }
svg { width: 100%; max-width: 760px; font: 11px sans-serif; fill: #555; }
.bar { display: inline-block; height: 10px; background: #c2410c; vertical-align: middle; } .left { color: #1b5fae; }
.right { color: #c2410c; } .warning { background: #fdecc8; border: 1px solid #d9a441; padding: 8px 12px; } pre { background: #f6f6f4; padding: 8px; white-space: pre-wrap; }";

/// Assembles the page.
pub fn page(
    path: &Path,
    labelled: &Labelled,
    samples: &[Sample],
    traces: &[Trace],
    regions: &[RegionRow],
    scores: &[(&'static str, Metrics)],
) -> String {
    let name = escaped(&path.file_name().unwrap_or_default().to_string_lossy());
    let mut html = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Touch in {name}</title><style>{STYLE}</style>\
         </head><body>\n<h1>Touch in {name}</h1>\n"
    );
    html += &banner(labelled);
    html += &about(labelled);
    if !scores.is_empty() {
        let columns: Vec<(&str, &Metrics)> = scores.iter().map(|(name, metrics)| (*name, metrics)).collect();
        let table = escaped(&table(&columns));
        html += &format!("<h2 id=\"metrics\">Labels against the truth</h2>\n<pre>{table}</pre>\n");
    }
    html += &frames(samples);
    html += &episodes(labelled, traces);
    html += &region_table(regions);
    html + "</body></html>\n"
}

/// Returns the warning about unfamiliar images, if there is one.
fn banner(labelled: &Labelled) -> String {
    match labelled.info.as_ref().and_then(|info| info.summary.warning()) {
        Some(warning) => format!("<p id=\"warning\" class=\"warning\">{}</p>\n", escaped(&warning)),
        None => String::new(),
    }
}

/// Returns the table of sizes and provenance.
fn about(labelled: &Labelled) -> String {
    let mut rows = vec![
        ("frames", labelled.labels.n_frames().to_string()),
        ("episodes", labelled.labels.episode_ends.len().to_string()),
        ("vertices", labelled.labels.topology.map_or("unknown topology".into(), |topology| topology.id().to_string())),
    ];
    let mut text = String::new();
    if let Some(about) = &labelled.info {
        let provenance = &about.provenance;
        rows.push(("network", format!("{}, SHA-256 {}", provenance.model, provenance.model_sha256)));
        rows.push((
            "thresholds",
            format!("contact {}, force {} N", provenance.thresholds.contact, provenance.thresholds.contact_force),
        ));
        rows.push(("made by", format!("{} {}", provenance.producer, provenance.version)));
        rows.push(("from", provenance.source.join("; ")));
        text = format!("<pre>{}</pre>\n", escaped(&about.summary.text()));
    }
    let rows: String =
        rows.iter().map(|(name, value)| format!("<tr><th>{name}</th><td>{}</td></tr>", escaped(value))).collect();
    format!("<table id=\"about\">{rows}</table>\n{text}")
}

/// Returns the plots of total force.
fn episodes(labelled: &Labelled, traces: &[Trace]) -> String {
    let max_force = traces.iter().map(Trace::max_force).fold(0.0, f64::max);
    let truth = if labelled.truth.is_some() { "; dashed: truth" } else { "" };
    let mut html = format!(
        "<h2 id=\"episodes\">Total force</h2>\n<p><span class=\"left\">left</span> and <span class=\"right\">right</span> hand{truth}.</p>\n"
    );
    html += "<div id=\"plots\">\n";
    for trace in traces {
        // Writing to a String cannot fail.
        let _ = writeln!(html, "<div>episode {}{}</div>", trace.episode, trace.svg(max_force));
    }
    html += "</div>\n";
    if labelled.labels.episode_ends.len() > traces.len() {
        let _ = writeln!(html, "<p>The first {} of {} episodes.</p>", traces.len(), labelled.labels.episode_ends.len());
    }
    html
}

/// Returns the table of contact by region.
fn region_table(regions: &[RegionRow]) -> String {
    if regions.is_empty() {
        return String::new();
    }
    let mut html = "<h2 id=\"regions\">Contact by region</h2>\n<p>Share of the frames in which a vertex of the region is touched, and \
                    the mean force on the region in those.</p>\n<table><tr><th>region</th><th colspan=\"2\">left</th>\
                    <th>force</th><th colspan=\"2\">right</th><th>force</th></tr>\n"
        .to_string();
    for region in Region::ALL {
        let _ = write!(html, "<tr><td>{}</td>", region.name().replace('_', " "));
        for side in Side::BOTH {
            let Some(row) = regions.iter().find(|row| row.side == side && row.region == region) else { continue };
            let force = row.mean_force.map_or(String::new(), |force| format!("{force:.2} N"));
            let _ = write!(
                html,
                "<td class=\"number\">{:.1} %</td><td><span class=\"bar\" style=\"width:{:.0}px\"></span></td><td class=\"number\">{force}</td>",
                100.0 * row.contact_ratio,
                120.0 * row.contact_ratio
            );
        }
        html += "</tr>\n";
    }
    html + "</table>\n"
}

/// Escapes text for HTML: file names may contain any character.
fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
