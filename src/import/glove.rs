//! Readings of gloves on the vertices of hands: newtons of a calibrated glove, shares of its range of any other.

use std::path::Path;
use std::sync::Arc;

use super::input::lazy::Lazy;
use super::sensors::{Sensor, at_vertices};
use crate::error::{Error, Result};
use crate::hand::HandModel;
use crate::sensor::{self, Layout, TaxelMap};
use crate::tactile::{CONTACT_FORCE_N, ForceKind, TactileField};

/// Share of an uncalibrated glove's range above which a vertex counts as touched, unless `--contact-reading` says otherwise.
/// Taxels at rest drift by a few per cent.
pub const CONTACT_SHARE: f32 = 0.1;

/// Taxel map of a recording's gloves.
#[derive(Debug)]
pub struct GloveMap {
    map: Arc<TaxelMap>,
    /// Map on other hands than those of `map`.
    rebuilt: Lazy<TaxelMap>,
    /// Share of the range above which a reading means contact, of a glove without a calibration.
    contact_share: f32,
}

impl GloveMap {
    /// Opens a taxel map of so many channels, a shipped one's name or a YAML file. `contact_share`: share of the range above which
    /// a reading means contact, of a glove without a calibration; `None` = [`CONTACT_SHARE`].
    ///
    /// # Errors
    /// If it can't be read, or has another number of channels.
    pub fn open(name: &str, channels: usize, contact_share: Option<f32>) -> Result<Arc<Self>> {
        let map = sensor::open(name)?;
        if map.layout.channels != channels {
            let got = format!("{} with {}", map.layout.name, map.layout.channels);
            return Err(Error::value("--sensor", format!("a map of {channels} channels"), got));
        }
        let contact_share = contact_share.unwrap_or(CONTACT_SHARE);
        Ok(Arc::new(Self { map: Arc::new(map), rebuilt: Lazy::default(), contact_share }))
    }

    /// Layout of the taxels.
    pub fn layout(&self) -> &Layout {
        &self.map.layout
    }

    /// Describes the rule of contact of a glove without a calibration.
    pub fn rule(&self) -> String {
        format!("reading above {} of the range of an uncalibrated glove", self.contact_share)
    }

    /// Returns force and contact at the (1556) vertices of `hands` from the newtons of the taxels, left first; `None` and vertices
    /// without a taxel are NaN. Contact is a reading above 0.05 N at the vertex.
    ///
    /// # Errors
    /// If a hand has another number of taxels, or the map can't be built on these hands.
    pub fn touch(
        &self,
        newtons: [Option<&[f32]>; 2],
        kind: ForceKind,
        hands: [&HandModel; 2],
        recording: &Path,
    ) -> Result<TactileField> {
        let map = self.on(hands, recording)?;
        let reading = map.reading(newtons)?;
        let contact = contact(&reading, CONTACT_FORCE_N);
        let force = match kind {
            ForceKind::Reading => reading,
            ForceKind::Spread => map.spread(newtons)?,
        };
        Ok(TactileField { topology: map.topology, force, contact })
    }

    /// Returns relative readings, 0 to 1, and contact at the (1556) vertices of `hands` from the readings of sensors; NaN as in
    /// [`GloveMap::touch`].
    ///
    /// # Errors
    /// As [`GloveMap::touch`].
    pub fn relative(
        &self,
        sensors: &[Sensor],
        readings: &[Option<Vec<f32>>],
        hands: [&HandModel; 2],
        recording: &Path,
    ) -> Result<[Vec<f32>; 2]> {
        let map = self.on(hands, recording)?;
        let relative = |(sensor, reading): (&Sensor, &Option<Vec<f32>>)| reading.as_ref().map(|r| sensor.relative(r));
        let relative: Vec<_> = sensors.iter().zip(readings).map(relative).collect();
        let values = at_vertices(sensors, &relative, |taxels| map.reading(taxels))?;
        let contact = contact(&values, self.contact_share);
        Ok([values, contact])
    }

    /// Returns the map on the vertices of `hands`.
    fn on(&self, hands: [&HandModel; 2], recording: &Path) -> Result<Arc<TaxelMap>> {
        match self.map.topology == hands[0].topology {
            true => Ok(Arc::clone(&self.map)),
            false => self.rebuilt.get(recording, || TaxelMap::build(&self.map.layout, &hands.map(Clone::clone))),
        }
    }
}

/// Returns contact of values above `least`; NaN stays.
fn contact(values: &[f32], least: f32) -> Vec<f32> {
    values.iter().map(|value| if value.is_nan() { f32::NAN } else { f32::from(*value > least) }).collect()
}
