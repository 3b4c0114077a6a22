//! The plots of the docs: they are those that their JSON files give, their texts and points are legible, their colours those of the palette.
#![cfg(feature = "sim")]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use egotac::render::font;
use egotac::render::plot::PALETTE;
use egotac_bench::draw::svgs;

/// Reports with plots, below docs/.
const REPORTS: [&str; 24] = [
    "bench/model.json",
    "bench/epyc/model.json",
    "bench/sim.json",
    "bench/friction/sim.json",
    "bench/glove.json",
    "bench/physics.json",
    "bench/retarget.json",
    "results/sources.json",
    "results/scaling.json",
    "results/limits.json",
    "results/motion.json",
    "results/recordings.json",
    "results/hands.json",
    "results/ablations.json",
    "results/sampling.json",
    "results/consistency.json",
    "results/history.json",
    "results/separation.json",
    "results/glove.json",
    "results/decline.json",
    "results/transfer.json",
    "results/reuse.json",
    "results/policy.json",
    "verify/verify.json",
];

fn docs(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs").join(path)
}

/// Returns all plots of the docs: path without ending, and SVG text.
fn plots() -> Vec<(PathBuf, String)> {
    let of = |report: &&str| {
        let path = docs(report);
        svgs(&path).unwrap().into_iter().map(move |(name, text)| (path.with_file_name(name), text))
    };
    REPORTS.iter().flat_map(of).collect()
}

/// Returns an attribute of an SVG element.
fn attribute<'a>(element: &'a str, name: &str) -> Option<&'a str> {
    let begin = element.find(&format!(" {name}=\""))? + name.len() + 3;
    Some(&element[begin..begin + element[begin..].find('"')?])
}

fn number(element: &str, name: &str) -> f64 {
    attribute(element, name).and_then(|text| text.parse().ok()).unwrap_or_else(|| panic!("{name} in {element}"))
}

/// Returns the elements `<NAME ...>` of an SVG file, with the text up to the next element.
fn elements<'a>(svg: &'a str, name: &str) -> Vec<&'a str> {
    let all = svg.split('<').filter(|element| element.starts_with(&format!("{name} ")));
    all.collect()
}

/// A text and the box that its letters cover: left, upper, right, lower.
fn texts(svg: &str) -> Vec<(String, [f64; 4])> {
    let boxed = |element: &&str| {
        let text =
            element.split_once('>').unwrap().1.trim().replace("&lt;", "<").replace("&gt;", ">").replace("&apos;", "'");
        let text = text.replace("&quot;", "\"").replace("&amp;", "&");
        let em = number(element, "font-size");
        let width = f64::from(font::width(&text, em * 1.24));
        let left = match attribute(element, "text-anchor") {
            Some("middle") => -0.5 * width,
            Some("end") => -width,
            _ => 0.0,
        };
        let base = match attribute(element, "dy") {
            Some("0.76em") => 0.76 * em,
            Some("0.5ex") => 0.27 * em,
            _ => -0.27 * em,
        };
        let corners = [[left, base - 0.74 * em], [left + width, base + 0.2 * em]];
        let turned = corners.map(|[x, y]| match attribute(element, "transform").map(|text| &text[..10]) {
            Some("rotate(90,") => [-y, x],
            Some("rotate(270") => [y, -x],
            _ => [x, y],
        });
        let (x, y) = (number(element, "x"), number(element, "y"));
        let low = |axis: usize| turned[0][axis].min(turned[1][axis]);
        let high = |axis: usize| turned[0][axis].max(turned[1][axis]);
        (text, [x + low(0), y + low(1), x + high(0), y + high(1)])
    };
    // Ticks without a label have an empty text.
    elements(svg, "text").iter().map(boxed).filter(|(text, _)| !text.is_empty()).collect()
}

#[test]
fn plots_of_the_docs_are_those_of_their_numbers() {
    for (path, text) in plots() {
        // `egotac verify` writes no SVG.
        let kept = path.with_extension("svg");
        if !kept.ends_with("verify/verify.svg") {
            let kept_text = fs::read_to_string(&kept).unwrap();
            assert!(kept_text == text, "{}: run `egotac bench draw` on its JSON", kept.display());
        }
        assert!(path.with_extension("png").is_file(), "{}", path.display());
    }
}

#[test]
fn texts_lie_inside_the_picture_and_cover_neither_each_other_nor_a_point() {
    for (path, svg) in plots() {
        let root = elements(&svg, "svg")[0];
        let (width, height) = (number(root, "width"), number(root, "height"));
        let texts = texts(&svg);
        assert!(texts.len() > 5, "{}", path.display());
        for (index, (text, spot)) in texts.iter().enumerate() {
            let inside = spot[0] >= 0.0 && spot[1] >= 0.0 && spot[2] <= width && spot[3] <= height;
            assert!(inside, "{}: {text:?} at {spot:?} leaves {width} x {height}", path.display());
            for (other, place) in &texts[..index] {
                let apart = spot[2] <= place[0] || place[2] <= spot[0] || spot[3] <= place[1] || place[3] <= spot[1];
                assert!(apart, "{}: {text:?} at {spot:?} covers {other:?} at {place:?}", path.display());
            }
        }
        for circle in elements(&svg, "circle") {
            let (x, y) = (number(circle, "cx"), number(circle, "cy"));
            assert!((0.0..width).contains(&x) && (0.0..height).contains(&y), "{}: {circle}", path.display());
            let covering = texts
                .iter()
                .find(|(_, [left, upper, right, lower])| (*left..*right).contains(&x) && (*upper..*lower).contains(&y));
            assert!(covering.is_none(), "{}: {covering:?} covers {circle}", path.display());
        }
    }
}

#[test]
fn colours_are_grey_or_of_the_palette_on_white() {
    let palette: Vec<String> =
        PALETTE.iter().map(|color| format!("#{:02X}{:02X}{:02X}", color.0, color.1, color.2)).collect();
    for (path, svg) in plots() {
        let mut elements = svg.split('<').skip(1);
        let ground = elements.find(|element| element.starts_with("rect")).unwrap();
        assert_eq!(attribute(ground, "fill"), Some("#FFFFFF"), "{}", path.display());
        for element in elements {
            for color in ["fill", "stroke"].into_iter().filter_map(|name| attribute(element, name)) {
                let channel = |at: usize| color.get(at..at + 2).and_then(|byte| i32::from_str_radix(byte, 16).ok());
                let channels: Vec<i32> = [1, 3, 5].into_iter().filter_map(channel).collect();
                let is_grey =
                    channels.len() == 3 && channels.iter().max().unwrap() - channels.iter().min().unwrap() <= 24;
                let known = color == "none" || is_grey || palette.iter().any(|known| known == color);
                assert!(known, "{}: {color} in {element}", path.display());
            }
        }
    }
}

#[test]
fn bench_draw_writes_beside_the_report_and_refuses_a_report_without_a_plot() {
    let folder = tempfile::tempdir().unwrap();
    let report = folder.path().join("glove.json");
    fs::copy(docs("bench/glove.json"), &report).unwrap();
    let run = |path: &Path| {
        Command::new(env!("CARGO_BIN_EXE_egotac-bench")).args(["bench", "draw"]).arg(path).output().unwrap()
    };
    let output = run(&report);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(
        folder.path().join("glove.svg").is_file()
            && image::open(folder.path().join("glove.png")).unwrap().width() == 900
    );
    let output = run(&docs("bench/faults.json"));
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && error.contains("faults.json") && error.contains("got another one"), "{error}");
}
