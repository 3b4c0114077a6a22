//! Data and network of a run, before its first step.

use std::sync::Arc;

use candle_core::Device;
use candle_nn::VarMap;

use super::batch::Collate;
use super::config::Config;
use super::data::{Dataset, Statistics};
use super::fixed_encoder::FixedEncoder;
use super::source::TrainingSource;
use super::{Started, initial_weights, keypoints};
use crate::error::{Error, Result};
use crate::hand::FieldMap;
use crate::model::{self, EgoTac, Metadata};
use crate::tactile::TactileSequence;

/// Stores of a run, and the metadata of the checkpoint that follow from them.
pub struct Data {
    /// Training stores.
    pub training: Dataset,
    /// Held-out stores and their truth, if there are any.
    pub validation: Option<(Dataset, TactileSequence)>,
    /// Metadata of the checkpoint, with topology and force scale of the training stores.
    pub metadata: Metadata,
    statistics: Statistics,
    /// MANO files whose vertices all labels are on; None = the stores' topology.
    mano: Option<Arc<FieldMap>>,
}

impl Data {
    /// Opens the stores that `config` names.
    ///
    /// # Errors
    /// If a store can't be read, or training and held-out stores differ in topology.
    pub fn open(config: &Config, geometry: &model::Config) -> Result<Self> {
        let mut metadata = Metadata::new(&config.name, 1.0, config.frame_dt);
        let preparation = metadata.preparation(geometry);
        let mano = match (&config.mano_left, &config.mano_right) {
            (Some(left), Some(right)) => Some(Arc::new(FieldMap::load(left, right)?)),
            _ => None,
        };
        let mut training = Dataset::open_on(mano.clone(), &config.data, preparation.clone(), config.in_memory)?;
        let validation = match config.validation.is_empty() {
            true => None,
            false => {
                let held_out = [TrainingSource::of(config.validation.iter().cloned())];
                let held_out = Dataset::open_on(mano.clone(), &held_out, preparation, config.in_memory)?;
                training.topology().must_match(held_out.topology())?;
                let truth = held_out.labels()?;
                Some((held_out, truth))
            }
        };
        if config.loss.keypoints > 0.0 {
            training.find_keypoints()?;
        }
        metadata.framing = training.framing()?;
        metadata.topology = training.topology();
        metadata.force_kind = training.force_kind()?;
        if let Some((held_out, _)) = &validation {
            metadata.force_kind.must_match(held_out.force_kind()?)?;
            if held_out.framing()? != metadata.framing {
                let (expected, got) = (metadata.framing.name(), held_out.framing()?.name());
                return Err(Error::value("input of the held-out stores", expected, got));
            }
        }
        let statistics = training.statistics()?;
        match statistics.force_scale {
            Some(force_scale) => metadata.force_scale = force_scale,
            None => metadata.has_force = false,
        }
        Ok(Self { training, validation, metadata, statistics, mano })
    }

    /// Returns the settings that turn clips of the training stores into batches.
    pub fn collate(&self, config: &Config, geometry: &model::Config) -> Collate {
        Collate {
            horizon: geometry.horizon,
            predict: geometry.predict,
            frame_dt: config.frame_dt,
            force_scale: self.metadata.force_scale,
            augment: config.augment,
            seed: config.seed,
        }
    }

    /// Returns the sizes of a run that has taken `step` steps.
    pub fn started(&self, config: &Config, network: &Network, step: usize) -> Started {
        Started {
            frames: self.training.n_frames(),
            validation_frames: self.validation.as_ref().map_or(0, |(held_out, _)| held_out.n_frames()),
            parameters: network.varmap.all_vars().iter().map(|var| var.elem_count()).sum(),
            force_scale: self.metadata.force_scale,
            step,
            steps: config.steps,
            ranks: 1,
        }
    }
}

/// The network to train.
pub struct Network {
    /// Trainable variables by name.
    pub varmap: VarMap,
    /// The network on these variables.
    pub model: EgoTac,
    /// The encoder, if it keeps its initial weights: the factor on its learning rate is 0.
    pub fixed_encoder: Option<FixedEncoder>,
    /// Heads of the auxiliary keypoint task, if its loss has a weight.
    pub keypoint_heads: Option<keypoints::Heads>,
}

impl Network {
    /// Builds the network with its initial weights: random, of the checkpoint `init`, or with the encoder of another one.
    ///
    /// # Errors
    /// If a checkpoint can't be read, or does not fit the geometry or the topology of the data.
    pub fn build(config: &Config, geometry: &model::Config, data: &Data, device: &Device) -> Result<Self> {
        let varmap = VarMap::new();
        let model = EgoTac::new(geometry, model::init::var_builder(&varmap, config.seed, device))?;
        let Data { metadata, statistics, .. } = data;
        match &config.init {
            Some(path) => {
                if let Some(before) = model::checkpoint::load_variables(path, &varmap)? {
                    match (&data.mano, before.topology == metadata.topology) {
                        (Some(mano), false) => initial_weights::carry_heads(&varmap, mano, metadata.topology)?,
                        _ => {
                            before.topology.must_match(metadata.topology).map_err(|error| Error::file(path, error))?;
                        }
                    }
                    // Keeps the predicted newtons although the unit of the network's output changes.
                    initial_weights::rescale_force(&varmap, before.force_scale / metadata.force_scale)?;
                }
            }
            None => {
                let positive_weight = config.loss.positive_weight as f32;
                initial_weights::positions(&varmap, geometry)?;
                initial_weights::heads(&varmap, statistics, metadata.force_scale, positive_weight)?;
                if let Some(path) = &config.encoder {
                    model::checkpoint::load_encoder(path, &varmap)?;
                }
            }
        }
        let keypoint_heads = match config.loss.keypoints > 0.0 {
            true => {
                let vb = model::init::var_builder(&varmap, config.seed, device).pp("keypoints");
                Some(keypoints::Heads::new(geometry, vb)?)
            }
            false => None,
        };
        let fixed_encoder = match config.encoder_factor() > 0.0 {
            true => None,
            false => {
                let network =
                    EgoTac::new(geometry, model::init::var_builder(&varmap, config.seed, device))?.freeze()?;
                Some(FixedEncoder::new(network, config.keeps_tokens()))
            }
        };
        Ok(Self { varmap, model, fixed_encoder, keypoint_heads })
    }
}
