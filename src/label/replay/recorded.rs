//! World of an imported episode: its hands, the meshes of its objects, and the support under them.

use glam::{DQuat, DVec3};

use super::stage::{Stage, StageHand};
use crate::dataset::zarr::ZarrReader;
use crate::error::{Error, Result};
use crate::hand::{N_BETAS, Side};
use crate::mujoco::World;
use crate::physics::gravity::SLAB;
use crate::physics::{Pose, RigidBody, Take, Tracked};
use crate::sim::effect::Effect;
use crate::sim::object::Object;
use crate::sim::randomize::{EpisodeDraw, HandDraw, ObjectDraw};
use crate::sim::rig::HandRig;
use crate::sim::scene::EffectPlan;
use crate::sim::{RolloutOptions, Scene, mjcf};

/// Scene with rigid contact and friction, whose surroundings the world takes; nothing of them touches.
const SURROUNDINGS: &str = "pinch_cube";
/// Height over the table at which a recording without a known support plays, m.
const IN_THE_AIR: f64 = 10.0;
/// Colour of everything: no picture shows it.
const GREY: [f64; 3] = [0.5; 3];

/// Returns true if a store was written by `egotac data import`.
pub(super) fn is_import(store: &ZarrReader) -> bool {
    store.raw_attributes().contains_key("import")
}

/// Builds the world of an imported episode.
///
/// # Errors
/// If a mesh spans no volume, or the hands can't be rigged.
pub(super) fn stage(take: &Take) -> Result<Stage> {
    let rig = |side: Side| HandRig::new(take.models[side as usize].clone(), betas(take, side));
    let rigs = [rig(Side::Left)?, rig(Side::Right)?];
    let scene = Scene::load(SURROUNDINGS)?;
    let mut episode = EpisodeDraw::sample(&scene, 0, &rigs)?;
    let Some(hand) = episode.hands.first().cloned() else {
        return Err(Error::value(format!("scene {SURROUNDINGS}"), "a hand", "none"));
    };
    let placing = placing(take);
    let draws = take.bodies.iter().zip(&take.poses).enumerate();
    let draws: Vec<Option<ObjectDraw>> =
        draws.map(|(index, (body, poses))| draw(index, body, poses, &placing)).collect::<Result<_>>()?;
    episode.objects = draws.iter().flatten().cloned().collect();
    let sides = Side::BOTH.into_iter().filter(|side| params(take, *side).next().is_some());
    let at_rest = |side: Side| HandDraw {
        side,
        wrist: DVec3::ZERO,
        orientation: DQuat::IDENTITY,
        posture: vec![0.0; rigs[side as usize].hinges.len()],
        act: None,
        wrap: None,
        glove: None,
        ..hand.clone()
    };
    episode.hands = sides.map(at_rest).collect();

    let effects = Some(EffectPlan::of(&scene.spec)?.effects().without(Effect::Sleep));
    let options = RolloutOptions { picture: None, effects, ..RolloutOptions::default() };
    let (effects, physics) = options.effects_and_physics(&scene.spec)?;
    let (model, files) = mjcf::write(&episode, &rigs, effects, 1.0)?;
    let world = World::from_mjcf_with_files(&model, &files, &physics)?;
    let mut hands = [None, None];
    for hand in &episode.hands {
        let side = hand.side as usize;
        hands[side] = Some(StageHand::find(&world, &rigs[side], hand.wrist, hand.orientation)?);
    }
    let find = |draw: Option<ObjectDraw>| {
        draw.map(|draw| Ok((world.body(&draw.name)?, world.free_joint(&draw.name)?))).transpose()
    };
    let objects = draws.into_iter().map(find).collect::<Result<_>>()?;
    let roots = (0..take.bodies.len()).map(|body| take.root(body)).collect();
    Ok(Stage { world, rigs, hands, objects, roots, placing })
}

/// Returns the known poses of a hand.
fn params<'a>(take: &'a Take, side: Side) -> impl Iterator<Item = &'a crate::hand::HandParams> + use<'a> {
    take.hands[side as usize].iter().filter_map(|tracked| match tracked {
        Tracked::Present(params) => Some(&**params),
        Tracked::Absent | Tracked::Unknown => None,
    })
}

/// Returns the shape of a hand: that of its first known pose.
fn betas(take: &Take, side: Side) -> [f32; N_BETAS] {
    params(take, side).next().map_or([0.0; N_BETAS], |params| params.betas)
}

/// Returns `stage_from_store`: up is the z axis, and the support is the table, if it is known.
fn placing(take: &Take) -> Pose {
    let up = take.gravity.map_or(DVec3::Z, |gravity| -gravity.normalize());
    let orientation = DQuat::from_rotation_arc(up, DVec3::Z);
    let places = take.poses.iter().flatten().flatten().map(|pose| orientation * pose.position);
    let [x, y, z] = [0, 1, 2].map(|axis| crate::statistics::median(places.clone().map(|place| place[axis])));
    let top = take.fixed.first().map(|slab| (orientation * slab.pose.point(DVec3::Z * f64::from(SLAB.z))).z);
    let height = top.map_or(IN_THE_AIR - z, |top| -top);
    Pose { position: DVec3::new(-x, -y, height), orientation }
}

/// Returns an object of the stage; None if its shape is unknown.
fn draw(index: usize, body: &RigidBody, poses: &[Option<Pose>], placing: &Pose) -> Result<Option<ObjectDraw>> {
    let Some((vertices, triangles)) = body.solid.as_ref().and_then(|solid| solid.mesh()) else { return Ok(None) };
    let height = vertices.iter().fold(0.0, |lowest: f64, vertex| lowest.max(f64::from(-vertex.z)));
    let mesh = (vertices.to_vec(), triangles.to_vec());
    let shape = Object::from_foreign_mesh(&format!("mesh of {}", body.name), &mesh, height)?;
    // Bodies with a shape have at least the mass of their class.
    let Some(mass) = body.mass.map(|mass| mass.kilograms) else { return Ok(None) };
    let start = poses.iter().flatten().next().map_or(Pose::IDENTITY, |pose| placing.of(pose));
    Ok(Some(ObjectDraw {
        // Names of recordings may hold characters that a model's can't.
        name: format!("object{index}"),
        shape,
        mass,
        friction: body.friction,
        position: start.position,
        orientation: start.orientation,
        table_friction: None,
        solid: true,
        colour: GREY,
        texture: None,
    }))
}
