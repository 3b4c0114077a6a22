//! Effects that each scene simulates, and the cost of each effect in it.

use egotac::error::Result;
use egotac::machine::Machine;
use egotac::sim::explain::{self, Explained};
use egotac::sim::scene::LookStyle;
use egotac::sim::{Effect, Rollout, RolloutOptions, Scene};
use egotac::text::put;
use serde::Serialize;
use std::time::Instant;

/// Number of frames in which looks are timed, from the middle of the episode.
const LOOK_FRAMES: usize = 12;
/// Styles in the order of the table.
const STYLES: [LookStyle; 3] = [LookStyle::Plain, LookStyle::Varied, LookStyle::Photo];

/// Effects of one scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneEffects {
    /// Name of the scene.
    pub scene: String,
    /// Effects in the order of [`Effect::ALL`], with costs.
    pub effects: Vec<Explained>,
    /// Median time of a whole frame (physics, labels, picture) with the looks plain, varied and photo, ms.
    pub look_ms: [f64; 3],
}

/// Effects of several scenes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EffectsReport {
    /// The command that measures the same again.
    pub command: String,
    /// Version of the program.
    pub version: &'static str,
    /// The machine that it was measured on.
    pub machine: Machine,
    /// One per scene.
    pub scenes: Vec<SceneEffects>,
}

/// Measures each effect in each scene, in the episode of `seed`, pictures of `side` x `side` pixels.
///
/// `progress` is called with scene and effect, the number of measurements done, and the number of all.
///
/// # Errors
/// If a rollout fails, for instance without OpenGL.
pub fn measure(
    command: String,
    scenes: &[Scene],
    seed: u64,
    side: u32,
    mut progress: impl FnMut(&str, usize, usize),
) -> Result<EffectsReport> {
    let options = RolloutOptions { picture: Some((side, side)), ..RolloutOptions::default() };
    let all = scenes.len() * Effect::ALL.len();
    let mut done = 0;
    let mut measured = Vec::new();
    for scene in scenes {
        let mut effects = explain::explain(scene)?;
        for explained in &mut effects {
            progress(&format!("{}: {}", scene.name, explained.effect.name()), done, all);
            explained.cost = Some(explain::cost(scene, seed, &options, explained.effect)?);
            done += 1;
        }
        let look_ms = look_times(scene, seed, &options)?;
        measured.push(SceneEffects { scene: scene.name.clone(), effects, look_ms });
    }
    Ok(EffectsReport { command, version: egotac::VERSION, machine: Machine::this(), scenes: measured })
}

/// Measures frames of a scene in all looks, simulated in turn, ms.
fn look_times(scene: &Scene, seed: u64, options: &RolloutOptions) -> Result<[f64; 3]> {
    let rollout = |style| Rollout::new(scene, seed, &RolloutOptions { style: Some(style), ..options.clone() });
    let mut rollouts = STYLES.into_iter().map(rollout).collect::<Result<Vec<_>>>()?;
    let start = rollouts[0].frame_count() / 2;
    let mut times = [const { Vec::new() }; 3];
    for frame in 0..start + LOOK_FRAMES {
        for (rollout, times) in rollouts.iter_mut().zip(&mut times) {
            if frame < start {
                rollout.skip_frame();
                continue;
            }
            let begun = Instant::now();
            rollout.next_frame()?;
            times.push(1e3 * begun.elapsed().as_secs_f64());
        }
    }
    Ok(times.map(|mut times| {
        times.sort_by(f64::total_cmp);
        times[times.len() / 2]
    }))
}

/// Returns the text of `effects.md`.
pub fn markdown(report: &EffectsReport) -> String {
    let EffectsReport { command, version, machine, .. } = report;
    let mut text = format!(
        "# Effects: what each scene simulates, and at what price\n\n\
         Written by `{command}` (egotac {version}, {machine}).\n\n\
         Milliseconds per simulated second that an effect costs, together with those that come and go with it: the median\n\
         difference of frames with and without it, taken in turn around the middle of the episode. Plain numbers are effects that\n\
         the scene calls for and gets; (in brackets) is the cost of an effect that the scene does not call for and does not pay.\n\
         Differences near 0 may come out negative. Why each is on or off: `egotac sim explain SCENE`.\n\n",
    );
    let header: Vec<&str> = Effect::ALL.iter().map(|effect| effect.name()).collect();
    put(&mut text, format_args!("| scene | {} | saved |", header.join(" | ")));
    put(&mut text, format_args!("|{}", "---|".repeat(Effect::ALL.len() + 2)));
    for scene in &report.scenes {
        let cells: Vec<String> = scene.effects.iter().map(cell).collect();
        let saved: f64 = scene.effects.iter().filter(|e| !e.on).filter_map(|e| e.cost).map(|cost| cost.max(0.0)).sum();
        put(&mut text, format_args!("| {} | {} | {saved:.0} |", scene.scene, cells.join(" | ")));
    }
    text.push_str("\n*saved*: the sum of what is in brackets.\n");
    text.push_str(&looks(&report.scenes));
    text
}

/// Returns the table of looks: frames per second of one process, and the time of a frame beside that of the plain look.
fn looks(scenes: &[SceneEffects]) -> String {
    let mut text = "\n## Looks\n\nWhole frames (physics, labels, picture) of one process: the median time of a frame in each scene, averaged over the scenes; \
        the looks take turns.\n\n| look | ms per frame | frames per second | beside plain |\n|---|---|---|---|\n"
        .to_owned();
    let mean = |style: usize| scenes.iter().map(|scene| scene.look_ms[style]).sum::<f64>() / scenes.len().max(1) as f64;
    for (index, style) in STYLES.iter().enumerate() {
        let (time, plain) = (mean(index), mean(0));
        put(&mut text, format_args!("| {} | {time:.1} | {:.0} | {:.2} |", style.name(), 1e3 / time, time / plain));
    }
    text
}

fn cell(explained: &Explained) -> String {
    match explained.cost {
        Some(cost) if explained.on => format!("{cost:.1}"),
        Some(cost) => format!("({cost:.1})"),
        None => "–".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_that_are_off_stand_in_brackets_and_sum_up_to_the_saving() {
        let effects = Effect::ALL.into_iter().enumerate();
        let effects = effects.map(|(i, effect)| Explained {
            effect,
            on: i != 2 && i != 4,
            reason: String::new(),
            cost: Some(i as f64 - 3.0),
        });
        let scenes =
            vec![SceneEffects { scene: "poke".into(), effects: effects.collect(), look_ms: [10.0, 12.5, 20.0] }];
        let report = EffectsReport { command: "c".into(), version: "0", machine: Machine::this(), scenes };
        let text = markdown(&report);
        let row = text.lines().find(|line| line.starts_with("| poke")).unwrap();
        assert!(row.starts_with("| poke | -3.0 | -2.0 | (-1.0) | 0.0 | (1.0) | 2.0 |"), "{row}");
        assert!(row.ends_with("| 1 |"), "{row}");
        assert!(text.contains("| photo | 20.0 | 50 | 2.00 |"), "{text}");
    }
}
