//! World of one episode, in which a replay drives hands and objects.

use glam::{DQuat, DVec3};

use crate::dataset::zarr::{OBJECT_POSE, ZarrReader};
use crate::error::{Error, Result};
use crate::hand::Side;
use crate::mujoco::World;
use crate::mujoco::world::{Body, FreeJoint, Servo};
use crate::physics::{Pose, Take};
use crate::sim::effect::Effect;
use crate::sim::rig::{HandRig, JOINT_NAMES};
use crate::sim::scene::EffectPlan;
use crate::sim::{Rollout, RolloutOptions, mjcf, stored_scene};

/// World of one episode, with handles of what moves.
pub(super) struct Stage {
    pub world: World,
    /// Rigs of the left and the right hand.
    pub rigs: [HandRig; 2],
    /// The left and the right hand; None = the hand is never there.
    pub hands: [Option<StageHand>; 2],
    /// Body and joint of each object; None = its shape is unknown.
    pub objects: Vec<Option<(Body, FreeJoint)>>,
    /// First part of the articulated object that each object is a part of; a rigid object is its own.
    pub roots: Vec<usize>,
    /// `stage_from_store`: the recording's world in the stage, whose table is at z = 0 and whose z axis points up.
    pub placing: Pose,
}

/// A hand of the stage.
pub(super) struct StageHand {
    /// Wrist, then hinges.
    pub servos: Vec<Servo>,
    pub links: Vec<Body>,
    /// Position of the wrist, m, and orientation with all servos at zero.
    pub wrist: DVec3,
    pub orientation: DQuat,
}

impl StageHand {
    /// Finds a hand in the world that was made from its rig.
    ///
    /// # Errors
    /// If the world has no such hand.
    pub fn find(world: &World, rig: &HandRig, wrist: DVec3, orientation: DQuat) -> Result<Self> {
        let hinges = rig.hinges.iter().map(|hinge| hinge.name.as_str());
        let servos = mjcf::WRIST.into_iter().chain(hinges).map(|name| world.servo(&rig.name(name)));
        let links = JOINT_NAMES.iter().map(|name| world.body(&rig.name(name)));
        Ok(Self { servos: servos.collect::<Result<_>>()?, links: links.collect::<Result<_>>()?, wrist, orientation })
    }
}

impl Stage {
    /// Builds the world that episode `index` of a store was simulated in. The take was read from that episode, so its objects are
    /// where the seed puts them.
    ///
    /// # Errors
    /// If the store names no scene, or an object does not move freely.
    pub fn simulated(store: &ZarrReader, index: usize, take: &Take) -> Result<Self> {
        let (Some(name), Some(seed)) = stored_scene::origin(store, index) else {
            let expected = "attribute `episodes` with scene and seed, as `egotac sim run` writes it, or `import`";
            return Err(Error::value("store", expected, "neither"));
        };
        let scene = stored_scene::scene(store, name)?;
        // Contacts of sleeping bodies are not listed.
        let effects = Some(EffectPlan::of(&scene.spec)?.effects().without(Effect::Sleep));
        let hands = Side::BOTH.map(|side| take.models[side as usize].clone());
        let options = RolloutOptions { picture: None, effects, hands, ..RolloutOptions::default() };
        let rollout = Rollout::new(&scene, seed, &options)?;
        let mut objects = Vec::new();
        for object in rollout.objects() {
            match (object.body(), object.joint) {
                (Some(body), Some(joint)) => objects.push(Some((body, joint))),
                (Some(_), None) => {
                    let name = format!("object {}", object.name);
                    let expected = "an object that moves freely, for a replay";
                    return Err(Error::value(name, expected, "a joint or a soft body"));
                }
                (None, _) => (),
            }
        }
        if take.poses.len() < objects.len() {
            let expected = format!("(T, >= {}, 7)", objects.len());
            return Err(Error::shape(OBJECT_POSE, expected, [take.times.len(), take.poses.len(), 7]));
        }
        let mut hands = [None, None];
        for hand in &rollout.episode().hands {
            let rig = &rollout.rigs()[hand.side as usize];
            let found = StageHand::find(rollout.world(), rig, hand.wrist, hand.orientation)?;
            hands[hand.side as usize] = Some(found);
        }
        let rigs = rollout.rigs().clone();
        let roots = (0..objects.len()).collect();
        Ok(Self { world: rollout.into_world(), rigs, hands, objects, roots, placing: Pose::IDENTITY })
    }
}
