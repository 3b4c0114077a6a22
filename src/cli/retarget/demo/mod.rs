//! `egotac retarget demo`: a robot hand follows a simulated grasp; both are drawn with their forces.

mod figure;
mod report;

use std::path::PathBuf;

use anyhow::{Context, ensure};

use super::Demo;
use crate::file;
use crate::hand::{HandModel, HandParams, Side};
use crate::model::predictor::{self, Predictor};
use crate::model::shipped;
use crate::retarget::human::Hand;
use crate::retarget::{Input, Options, Output, Retargeter, Robot, Touch, TouchPooling};
use crate::sim::{Rollout, RolloutOptions, Scene};
use crate::tactile::TactileField;
use crate::text::tell;

/// Width and height of the camera image, px.
const PICTURE: u32 = 448;

impl Demo {
    /// Returns the command that repeats this run.
    fn command(&self) -> String {
        let Self { robot, scene, seed, touch, .. } = self;
        let path = |flag: &str, path: &Option<PathBuf>| {
            path.as_ref().map(|path| format!(" --{flag} {}", path.display())).unwrap_or_default()
        };
        let (model, checkpoint) = (path("model", &self.model), path("checkpoint", &self.checkpoint));
        format!("egotac retarget demo --robot {robot}{model} --scene {scene} --seed {seed} --touch {touch}{checkpoint}")
    }
}

/// One frame of the acting human hand and of the robot that follows it.
struct Moment {
    seconds: f64,
    image: image::RgbImage,
    params: HandParams,
    /// (778) force on the human hand that was transferred, N.
    force: Vec<f32>,
    output: Output,
}

/// Runs the command.
///
/// # Errors
/// If the robot or the scene can't be loaded, no hand of the scene touches anything, or a file can't be written.
pub fn demo(args: &Demo) -> anyhow::Result<()> {
    let robot = Robot::load(&args.robot, args.model.as_deref())?;
    let frames = record(args)?;
    // The acting hand is the one that presses more.
    let total = |side: Side| frames.iter().map(|frame| frame.field.total_force(side)).sum::<f32>();
    let side = if total(Side::Left) > total(Side::Right) { Side::Left } else { Side::Right };
    ensure!(total(side) > 0.0, "scene {}, seed {}: no hand touches anything", args.scene, args.seed);

    let model = HandModel::builtin(side);
    let pooling = TouchPooling::new(&model)?;
    let mut retargeter = Retargeter::with_options(robot, Options { side: Some(side), ..Options::default() })?;
    let mut moments = Vec::new();
    let mut held = 0;
    for frame in frames {
        let Some(params) = frame.hands[side as usize].clone() else { continue };
        let (force, contact) = (&frame.field.force[side.range()], &frame.field.contact[side.range()]);
        let mut touch = Touch::default();
        pooling.pool_into(force, contact, &mut touch)?;
        let mut input = Input::new(Hand::of_model(&model, &params), frame.seconds);
        input.touch = Some(touch);
        if let Err(error) = retargeter.push(&input) {
            tell(format_args!("egotac: {:.2} s: {error}; the last good pose is held", frame.seconds));
            held += 1;
        }
        moments.push(Moment {
            seconds: frame.seconds,
            image: frame.image,
            params,
            force: force.to_vec(),
            output: retargeter.output().clone(),
        });
    }
    let summary = report::summary(args, &retargeter, side, &moments, held);
    let shown = report::firmest(&moments).context("the acting hand is in no frame")?;
    let (picture, json) = (args.out.join("retarget.png"), args.out.join("retarget.json"));
    let (robot, _) = retargeter.robot_and_goal_mut();
    figure::write(&picture, &model, robot, &moments, shown)?;
    file::write(&json, format!("{summary:#}\n").as_bytes())?;
    println!("picture  {}\nnumbers  {}\n{}", picture.display(), json.display(), report::headline(&summary));
    Ok(())
}

/// Frame of the simulation.
struct Recorded {
    seconds: f64,
    image: image::RgbImage,
    hands: [Option<HandParams>; 2],
    field: TactileField,
}

/// Plays the scene once; fields are the truth or the network's prediction, as `--touch` says.
fn record(args: &Demo) -> anyhow::Result<Vec<Recorded>> {
    let scene = Scene::load(&args.scene)?;
    let options = RolloutOptions { picture: Some((PICTURE, PICTURE)), ..RolloutOptions::default() };
    let mut rollout = Rollout::new(&scene, args.seed, &options)?;
    let mut predictor = match args.touch.as_str() {
        "predicted" => {
            let path = args.checkpoint.clone().map_or_else(shipped::path, Ok)?;
            let predictor = Predictor::load(&path, predictor::Options::default())?;
            predictor.topology().must_match(rollout.topology())?;
            Some(predictor)
        }
        _ => None,
    };
    let mut frames = Vec::new();
    while let Some(frame) = rollout.next_frame()? {
        let frame = frame.frame;
        let field = match &mut predictor {
            Some(predictor) => predictor.push(&frame.camera_ego_rgb, frame.timestamp)?.field,
            None => frame.field,
        };
        frames.push(Recorded {
            seconds: frame.timestamp,
            image: frame.camera_ego_rgb,
            hands: [frame.left_hand_pose, frame.right_hand_pose],
            field,
        });
    }
    Ok(frames)
}
