//! Calibration of a glove's readings.

use crate::error::{Error, Result};

/// Meaning of a glove's readings; each list has one number per channel, or one for all.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Calibration {
    /// Reading without touch.
    pub(crate) rest: Vec<f32>,
    /// Newtons per unit above `rest`; empty = no calibration.
    pub(crate) newtons_per_unit: Vec<f32>,
    /// Reading at the end of the range, of a glove without a calibration.
    pub(crate) full: Vec<f32>,
}

/// Taxels of a reading.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Taxels {
    /// Newtons, at least 0.
    Newtons(Vec<f32>),
    /// Shares of the range, 0 to 1.
    Shares(Vec<f32>),
}

impl Calibration {
    /// Applies the calibration; NaN stays.
    ///
    /// # Errors
    /// If a list has another length, or the range has none.
    pub(crate) fn taxels(&self, values: &[f32]) -> Result<Taxels> {
        let rest = each("rest", &self.rest, 0.0, values.len())?;
        if !self.newtons_per_unit.is_empty() {
            let gain = each("newtons_per_unit", &self.newtons_per_unit, 1.0, values.len())?;
            let newtons = |(index, value): (usize, &f32)| at_least_zero(gain(index) * (value - rest(index)));
            return Ok(Taxels::Newtons(values.iter().enumerate().map(newtons).collect()));
        }
        let full = each("full", &self.full, 1.0, values.len())?;
        if let Some(index) = (0..values.len()).find(|index| full(*index) == rest(*index)) {
            return Err(Error::value(format!("full[{index}]"), "another reading than that without touch", full(index)));
        }
        let share = |(index, value): (usize, &f32)| {
            let share = (value - rest(index)) / (full(index) - rest(index));
            if share.is_nan() { share } else { share.clamp(0.0, 1.0) }
        };
        Ok(Taxels::Shares(values.iter().enumerate().map(share).collect()))
    }
}

/// Returns the number of a list for each channel.
fn each<'a>(name: &str, list: &'a [f32], missing: f32, channels: usize) -> Result<impl Fn(usize) -> f32 + 'a> {
    if let Some(at) = list.iter().position(|number| !number.is_finite()) {
        return Err(Error::value(format!("{name}[{at}]"), "a finite number", list[at]));
    }
    if list.len() > 1 && list.len() != channels {
        return Err(Error::shape(name, format!("[{channels}], [1] or []"), [list.len()]));
    }
    Ok(move |index: usize| match list {
        [] => missing,
        [one] => *one,
        all => all[index],
    })
}

/// Returns a force without the noise below zero; NaN stays.
fn at_least_zero(newtons: f32) -> f32 {
    if newtons < 0.0 { 0.0 } else { newtons }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newtons_follow_from_rest_and_gain_and_shares_from_the_range() {
        let none = || Calibration { rest: vec![], newtons_per_unit: vec![], full: vec![] };
        let falling = Calibration { rest: vec![3000.0, 3100.0], newtons_per_unit: vec![-0.01], ..none() };
        assert_eq!(falling.taxels(&[2900.0, 3200.0]).unwrap(), Taxels::Newtons(vec![1.0, 0.0]));
        let range = Calibration { rest: vec![3072.0], full: vec![0.0], ..none() };
        assert_eq!(range.taxels(&[3072.0, 1536.0, 4000.0]).unwrap(), Taxels::Shares(vec![0.0, 0.5, 0.0]));
        let Taxels::Newtons(unknown) = falling.taxels(&[f32::NAN, 3000.0]).unwrap() else { panic!("newtons") };
        assert!(unknown[0].is_nan() && unknown[1] == 1.0);
        for (bad, name) in [
            (Calibration { rest: vec![1.0; 3], ..none() }, "rest"),
            (Calibration { full: vec![0.0], ..none() }, "full[0]"),
            (Calibration { newtons_per_unit: vec![f32::NAN], ..none() }, "newtons_per_unit[0]"),
        ] {
            assert!(bad.taxels(&[1.0, 2.0]).unwrap_err().to_string().contains(name));
        }
    }
}
