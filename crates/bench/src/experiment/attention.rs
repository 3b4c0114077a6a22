//! Experiment `attention`: share of a finished network's attention on hands, objects and touch, against their share of the
//! picture.

use std::path::Path;

use candle_core::{Device, Tensor};
use egotac::error::{Error, Result};
use egotac::file;
use egotac::image::resize;
use egotac::model::{EgoTac, Metadata, checkpoint};
use egotac::render::font::{self, Align};
use egotac::render::heat;
use egotac::sim::scene::Split;
use egotac::sim::{Rollout, RolloutOptions, SHIPPED, Scene, SimFrame};
use egotac::tactile::CONTACT_FORCE_N;
use egotac::text::put;
use image::{Rgb, RgbImage, imageops};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::data::{MEASURED_SEED, OOD};
use super::mask::{Mask, Shown, touched};
use super::report::Head;
use super::{Progress, Setup};

/// Frames between two that are measured: neighbours are nearly the same.
const STRIDE: usize = 5;
/// Resamples of an interval.
const RESAMPLES: usize = 1000;
/// Side of a picture of the figure, gap between two, margin of the figure, and height of the headings, pixels.
const FIGURE: [u32; 4] = [280, 8, 16, 72];
/// Examples of each world in the figure.
const EXAMPLES: usize = 2;
/// Regions, in the order of [`Sample`]'s arrays.
const REGIONS: [&str; 3] = ["hand", "object", "touch"];
/// Layers, in the order of [`Sample`]'s arrays.
const LAYERS: [&str; 2] = ["temporal token", "CLS, last encoder layer"];

/// Results of the experiment.
#[derive(Debug, Clone, Serialize)]
pub struct AttentionReport {
    /// Description of the run.
    #[serde(flatten)]
    pub head: Head,
    /// Results of both worlds.
    pub worlds: Vec<World>,
}

/// Results in one world.
#[derive(Debug, Clone, Serialize)]
pub struct World {
    /// Name.
    pub name: &'static str,
    /// Frames with touch that were measured.
    pub frames: usize,
    /// Episodes.
    pub episodes: usize,
    /// Results by layer and region.
    pub shares: Vec<Share>,
}

/// Attention on one region.
#[derive(Debug, Clone, Serialize)]
pub struct Share {
    /// Layer whose attention it is.
    pub layer: &'static str,
    /// Region of the picture.
    pub region: &'static str,
    /// Share of the picture's area.
    pub area: f64,
    /// Share of the attention.
    pub attention: f64,
    /// Attention over area; 1 is chance.
    pub ratio: f64,
    /// 95 % interval of the ratio over episodes.
    pub interval: [f64; 2],
}

/// One frame.
#[derive(Debug, Clone, Copy, Default)]
struct Sample {
    area: [f64; 3],
    /// By layer and region.
    attention: [[f64; 3]; 2],
}

/// Picture with the attention of both layers, for the figure.
struct Example {
    scene: String,
    picture: RgbImage,
    weights: [Vec<f32>; 2],
}

/// Measures the attention of a network.
///
/// # Errors
/// If a scene can't be simulated, the network can't be read, or the figure can't be written.
pub fn run(setup: &Setup, command: String, out: &Path, progress: &mut dyn FnMut(Progress)) -> Result<AttentionReport> {
    let path = setup.network.path.as_deref().ok_or_else(|| Error::value("--checkpoint", "a checkpoint", "none"))?;
    let (model, metadata) = checkpoint::load_uncompiled(path)?;
    let known: Vec<String> = SHIPPED.iter().map(|(name, _)| (*name).into()).collect();
    let sets = [("known", known), (OOD, Split::named(OOD)?.scene_names(OOD))];
    let sets = sets.map(|(name, scenes)| (name, scenes.into_iter().take(setup.size.scenes).collect::<Vec<_>>()));
    let all: usize = sets.iter().map(|(_, scenes)| scenes.len() * setup.size.held_out).sum();
    let (mut worlds, mut examples, mut done) = (Vec::new(), Vec::new(), 0);
    for (name, scenes) in &sets {
        let (mut episodes, mut found) = (Vec::new(), Vec::new());
        for scene in scenes {
            for episode in 0..setup.size.held_out {
                progress(Progress::Measured(done, all));
                done += 1;
                let seed = MEASURED_SEED + episode as u64;
                let (samples, example) = episode_samples(&model, &metadata, scene, seed, setup.size.image)?;
                if !samples.is_empty() {
                    episodes.push(samples);
                }
                // One of each scene, so that the figure shows different ones.
                found.extend(example.filter(|_| episode == 0));
            }
        }
        let step = found.len().div_ceil(EXAMPLES).max(1);
        examples.extend(found.into_iter().step_by(step));
        worlds.push(world(name, &episodes));
    }
    progress(Progress::Measured(all, all));
    write_figure(&out.join("attention.png"), &examples, &model, &metadata)?;
    Ok(AttentionReport {
        head: Head::new("attention", "Does attention lie on hands, objects and touch?", command, setup),
        worlds,
    })
}

/// Simulates an episode and measures its frames with touch; returns also the frame with the most force.
fn episode_samples(
    model: &EgoTac,
    metadata: &Metadata,
    scene: &str,
    seed: u64,
    side: u32,
) -> Result<(Vec<Sample>, Option<Example>)> {
    let options = RolloutOptions { picture: Some((side, side)), ..RolloutOptions::default() };
    let mut rollout = Rollout::new(&Scene::load(scene)?, seed, &options)?;
    let config = model.config().clone();
    let step = (metadata.frame_dt / rollout.interval()).round().max(1.0) as usize;
    let mut pictures: Vec<RgbImage> = Vec::new();
    let mut samples = Vec::new();
    let mut example: Option<(f32, Example)> = None;
    while let Some(frame) = rollout.next_frame()? {
        pictures.push(frame.frame.camera_ego_rgb.clone());
        let touches = frame.frame.field.contact.iter().any(|contact| *contact > 0.5);
        if !touches || !(pictures.len() - 1).is_multiple_of(STRIDE) {
            continue;
        }
        let newest = pictures.len() - 1;
        let window: Vec<&RgbImage> =
            (0..config.horizon).rev().map(|back| &pictures[newest.saturating_sub(back * step)]).collect();
        let weights = weights(model, metadata, &window)?;
        samples.push(sample(&rollout, &frame, config.grid(), config.image, &weights));
        let force: f32 = frame.frame.field.force.iter().filter(|force| !force.is_nan()).sum();
        if example.as_ref().is_none_or(|(most, _)| force > *most) {
            example = Some((force, Example { scene: scene.into(), picture: pictures[newest].clone(), weights }));
        }
    }
    Ok((samples, example.map(|(_, example)| example)))
}

/// Computes the attention on the patches of a window's newest picture: of the temporal token and of CLS, means over heads.
fn weights(model: &EgoTac, metadata: &Metadata, window: &[&RgbImage]) -> Result<[Vec<f32>; 2]> {
    let config = model.config();
    let preparation = metadata.preparation(config);
    let mut pixels = Vec::new();
    for picture in window {
        pixels.extend(preparation.apply(picture)?);
    }
    let frames = Tensor::from_vec(pixels, (window.len(), 3, config.image, config.image), &Device::Cpu)?;
    let newest = window.len() - 1;
    let temporal = model.temporal_attention(&frames.unsqueeze(0)?)?.get(0)?; // (heads, T, P)
    let temporal = temporal.narrow(1, newest, 1)?.narrow(2, 1, config.tokens() - 1)?.mean(0)?.flatten_all()?;
    let newest = frames.narrow(0, newest, 1)?;
    let cls = model.encoder_attention(&newest, config.vision_depth - 1)?.get(0)?.mean(0)?; // (P - 1)
    Ok([temporal.to_vec1()?, cls.to_vec1()?])
}

/// Measures area and attention of each region.
fn sample(rollout: &Rollout, frame: &SimFrame, grid: usize, side: usize, weights: &[Vec<f32>; 2]) -> Sample {
    let mask = Mask::of(rollout, frame, side);
    let mut near_touch = vec![0.0; grid * grid];
    for [x, y] in touched(rollout, frame, CONTACT_FORCE_N) {
        let inside = |share: f32| (0.0..1.0).contains(&share).then_some((share * grid as f32) as usize);
        if let (Some(x), Some(y)) = (inside(x), inside(y)) {
            near_touch[y * grid + x] = 1.0;
        }
    }
    let regions = [mask.shares(Shown::Hand, grid), mask.shares(Shown::Object, grid), near_touch];
    let area = regions.each_ref().map(|shares| mean(shares));
    let attention = weights.each_ref().map(|weights| {
        let total: f64 = weights.iter().map(|weight| f64::from(*weight)).sum();
        regions.each_ref().map(|shares| {
            let on = shares.iter().zip(weights).map(|(share, weight)| f64::from(share * weight)).sum::<f64>();
            on / total.max(f64::MIN_POSITIVE)
        })
    });
    Sample { area, attention }
}

fn mean(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value)).sum::<f64>() / values.len().max(1) as f64
}

/// Summarises the episodes of a world.
fn world(name: &'static str, episodes: &[Vec<Sample>]) -> World {
    let mut shares = Vec::new();
    for (l, layer) in LAYERS.into_iter().enumerate() {
        for (r, region) in REGIONS.into_iter().enumerate() {
            // Sums over the frames of each episode: attention, area, frames.
            let sums: Vec<[f64; 3]> = episodes
                .iter()
                .map(|samples| {
                    samples
                        .iter()
                        .fold([0.0; 3], |sum, s| [sum[0] + s.attention[l][r], sum[1] + s.area[r], sum[2] + 1.0])
                })
                .collect();
            let total = |chosen: &mut dyn Iterator<Item = &[f64; 3]>| {
                chosen.fold([0.0; 3], |sum, own| [sum[0] + own[0], sum[1] + own[1], sum[2] + own[2]])
            };
            let ratio = |[attention, area, _]: [f64; 3]| attention / area.max(f64::MIN_POSITIVE);
            let [attention, area, frames] = total(&mut sums.iter());
            let mut rng = ChaCha8Rng::seed_from_u64(0);
            let mut drawn: Vec<f64> = (0..RESAMPLES)
                .map(|_| ratio(total(&mut (0..sums.len()).map(|_| &sums[rng.random_range(0..sums.len())]))))
                .collect();
            drawn.sort_by(f64::total_cmp);
            let at = |share: f64| drawn[(share * (RESAMPLES - 1) as f64).round() as usize];
            shares.push(Share {
                layer,
                region,
                area: area / frames.max(1.0),
                attention: attention / frames.max(1.0),
                ratio: ratio([attention, area, frames]),
                interval: [at(0.025), at(0.975)],
            });
        }
    }
    World { name, frames: episodes.iter().map(Vec::len).sum(), episodes: episodes.len(), shares }
}

/// Writes a figure: one row per example with the picture, and the attention of both layers over it.
fn write_figure(path: &Path, examples: &[Example], model: &EgoTac, metadata: &Metadata) -> Result<()> {
    const BLACK: Rgb<u8> = Rgb([0; 3]);
    const WHITE: Rgb<u8> = Rgb([255; 3]);
    let ([side, gap, margin, head], config) = (FIGURE, model.config());
    let [width, height] = [3, examples.len().max(1) as u32].map(|count| count * (side + gap) - gap + 2 * margin);
    let mut figure = RgbImage::from_pixel(width, head + height, WHITE);
    let left_of = |column: u32| margin + column * (side + gap);
    font::draw(&mut figure, "Attention on a frame with touch", (left_of(0) as i32, 16), 22.0, BLACK, Align::Left);
    let titles = ["picture", "attention of the temporal token", "of CLS, last encoder layer"];
    for (column, title) in (0..).zip(titles) {
        font::draw(&mut figure, title, (left_of(column) as i32, 58), 17.0, BLACK, Align::Left);
    }
    for (row, example) in (0..).zip(examples) {
        let square = resize(&example.picture, config.image, metadata.resize, metadata.filter)?;
        let top = margin + head + row * (side + gap);
        let mut put = |column: u32, picture: &RgbImage| {
            imageops::replace(&mut figure, picture, i64::from(left_of(column)), i64::from(top));
        };
        put(0, &imageops::resize(&square, side, side, imageops::FilterType::Triangle));
        for (column, weights) in (1..).zip(&example.weights) {
            let largest = weights.iter().copied().fold(0.0, f32::max);
            put(column, &heat::overlay(&square, weights, config.grid() as u32, largest, side));
        }
        font::draw_on(
            &mut figure,
            &example.scene,
            (left_of(0) as i32 + 8, top as i32 + 6),
            17.0,
            [BLACK, WHITE],
            Align::Left,
        );
    }
    file::write_png(path, &figure)
}

impl AttentionReport {
    /// Returns the report as Markdown.
    pub fn markdown(&self) -> String {
        let network = &self.head.network;
        let mut text = format!(
            "{}\nMeasured is `{}` ({}), which has seen \
             {}.\nOf frames with touch, one in {STRIDE}: share of the newest picture's attention (mean over heads, patches alone) that \
             lies on a region, against\nthe region's share of the picture. `hand` is the hand without the forearm, `object` the \
             objects that the scene names, `touch` the patches\nthat show a vertex with more than 0.05 N. A ratio of 1 is chance; \
             intervals (95 %) are over episodes.\nIn the figure: picture, temporal token, CLS of the last encoder layer; two examples \
             of known scenes, two of `ood`.\n\n![Attention](attention.png)\n",
            self.head.markdown(),
            network.name,
            network.sha256.get(..12).unwrap_or_default(),
            network.has_seen,
        );
        for world in &self.worlds {
            put(
                &mut text,
                format_args!("\n## {} ({} frames, {} episodes)\n", world.name, world.frames, world.episodes),
            );
            put(
                &mut text,
                format_args!(
                    "| attention of | region | share of area | share of attention | ratio |\n|---|---|---|---|---|"
                ),
            );
            for Share { layer, region, area, attention, ratio, interval: [low, high] } in &world.shares {
                put(
                    &mut text,
                    format_args!(
                        "| {layer} | {region} | {area:.3} | {attention:.3} | {ratio:.2} ({low:.2} .. {high:.2}) |"
                    ),
                );
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_attention_has_a_ratio_of_one_and_attention_on_a_region_a_larger_one() {
        let even = Sample { area: [0.1, 0.2, 0.05], attention: [[0.1, 0.2, 0.05], [0.3, 0.2, 0.0]] };
        let episodes = vec![vec![even; 3], vec![even; 5]];
        let world = world("w", &episodes);
        assert_eq!((world.frames, world.episodes), (8, 2));
        let ratios: Vec<f64> = world.shares.iter().map(|share| share.ratio).collect();
        for (ratio, expected) in ratios.iter().zip([1.0, 1.0, 1.0, 3.0, 1.0, 0.0]) {
            assert!((ratio - expected).abs() < 1e-9, "{ratios:?}");
        }
        assert!(world.shares.iter().all(|share| share.interval[0] <= share.ratio + 1e-9));
    }
}
