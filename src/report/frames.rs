//! Sample frames of the page: image, both hands, truth, certainty, and a slider over them.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::samples::{Sample, png};
use crate::hand::Side;
use crate::render::color_bar;

/// Width and height of the colour bar, pixels.
const BAR: (u32, u32) = (420, 54);

/// Shows one sample at a time while the slider is moved, and its time in the plot of its episode.
const SCRIPT: &str = "
const samples = [...document.querySelectorAll('#samples figure')], slider = document.getElementById('scrub');
const all = document.getElementById('all'), grid = document.getElementById('samples');
const mark = figure => document.querySelectorAll('svg[data-episode]').forEach(plot => {
  const line = plot.querySelector('.now'), { episode, start, seconds } = plot.dataset;
  const share = seconds > 0 ? (figure.dataset.stamp - start) / seconds : 0;
  line.setAttribute('visibility', episode === figure.dataset.episode ? 'visible' : 'hidden');
  for (const end of ['x1', 'x2']) line.setAttribute(end, 46 + 704 * Math.max(0, Math.min(1, share)));
});
slider.addEventListener('input', () => {
  grid.className = 'single';
  all.hidden = false;
  samples.forEach((figure, index) => { figure.className = index === Number(slider.value) ? 'shown' : ''; });
  mark(samples[slider.value]);
});
all.addEventListener('click', () => { grid.className = ''; all.hidden = true; });
";

/// Returns the sample frames.
pub(super) fn frames(samples: &[Sample]) -> String {
    let Some(first) = samples.first() else { return String::new() };
    let truth = if first.truth.is_some() { "; the truth below" } else { "" };
    let mut html = format!(
        "<h2 id=\"frames\">Frames</h2>\n<p>The frame with the most force out of each of {} equal stretches, with the left and the right \
         palm{truth}. Grey: unknown.</p>\n",
        samples.len()
    );
    if let Ok(bar) = png(&color_bar(first.scale, "force on a vertex (darkest: and more)", BAR)) {
        html += &format!(
            "<img class=\"scale\" alt=\"colour bar\" src=\"data:image/png;base64,{}\">\n",
            STANDARD.encode(bar)
        );
    }
    html += &format!(
        "<p class=\"scrub\"><label>One after the other: <input id=\"scrub\" type=\"range\" min=\"0\" max=\"{}\" value=\"0\"></label> \
         <button id=\"all\" type=\"button\" hidden>Show all</button></p>\n<div id=\"samples\">\n",
        samples.len() - 1
    );
    for sample in samples {
        html += &figure(sample);
    }
    html + "</div>\n" + &format!("<script>{SCRIPT}</script>\n")
}

/// Returns one sample.
fn figure(sample: &Sample) -> String {
    let Sample { frame, episode, stamp_secs, .. } = sample;
    let mut html = format!("<figure data-episode=\"{episode}\" data-stamp=\"{stamp_secs}\">");
    html += &match &sample.image {
        Some(image) => {
            format!("<img class=\"camera\" alt=\"camera\" src=\"data:image/jpeg;base64,{}\">", STANDARD.encode(image))
        }
        None => "<span class=\"none\">this image can't be read</span>".into(),
    };
    html += "<div class=\"palms\">";
    html += &palms(&sample.hands, sample.force, "");
    if let Some(truth) = sample.truth {
        html += &palms(&sample.truth_hands, truth, "truth, ");
    }
    let certainty =
        |name: &str, value: f32| if value.is_nan() { String::new() } else { format!(", {name} {value:.2}") };
    let [left, right] = sample.presence;
    html + &format!(
        "</div><figcaption>frame {frame}, episode {episode}, {stamp_secs:.2} s{}{}{}</figcaption></figure>\n",
        certainty("familiarity", sample.familiarity),
        certainty("left hand present", left),
        certainty("right hand present", right),
    )
}

/// Returns both palms, each with its name and total force.
fn palms(hands: &[Vec<u8>], force: [f32; 2], name: &str) -> String {
    let palm = |(side, force): (Side, f32)| {
        let picture = hands.get(side as usize).map_or(String::new(), |picture| {
            let encoded = STANDARD.encode(picture);
            format!("<img alt=\"{name}{} palm\" src=\"data:image/png;base64,{encoded}\">", side.name())
        });
        let force = if force.is_nan() { "unknown".into() } else { format!("{force:.2} N") };
        format!("<div>{picture}<span class=\"{0}\">{name}{0}: {force}</span></div>", side.name())
    };
    Side::BOTH.into_iter().zip(force).map(palm).collect()
}
