//! Ambient occlusion from distances: creases, and where one surface lies close to another, get less light from around.
//!
//! Volumetric obscurance: the share of a small ball around a visible point that lies behind visible surfaces. In a flat
//! surface it is one half, whatever its tilt, since what lies behind on one side of the point lacks on the other. Only what
//! exceeds one half takes light.

/// Radius of the ball, m: about a finger's width.
const RADIUS: f64 = 0.02;
/// Largest radius of the ball in the picture, pixels; nearer surfaces have a smaller ball.
const MAX_PIXELS: f64 = 24.0;
/// Pairs of opposite samples.
const PAIRS: usize = 8;
/// Share of the light that a point at the bottom of a narrow crease lacks.
const STRENGTH: f64 = 0.75;
/// Distance in units of the ball's radius at which a nearer surface no longer belongs to the neighbourhood.
const FAR: f64 = 3.0;

/// Darkens a picture of (width, height) pixels by ambient occlusion.
///
/// `picture`: light per pixel and channel, row by row; `distances`, m: from the camera plane; `focal`: focal length, pixels.
pub(crate) fn shade(picture: &mut [f64], (width, height): (u32, u32), distances: &[f32], focal: f64) {
    let (width, height) = (width as usize, height as usize);
    if distances.len() != width * height {
        return;
    }
    let light = smooth(&light(distances, width, height, focal), width, height);
    for (pixel, light) in picture.chunks_exact_mut(3).zip(light) {
        pixel.iter_mut().for_each(|value| *value *= light);
    }
}

/// Returns the share of the surrounding light that each pixel gets, 0 to 1.
fn light(distances: &[f32], width: usize, height: usize, focal: f64) -> Vec<f64> {
    let mut light = Vec::with_capacity(width * height);
    for (index, distance) in distances.iter().enumerate() {
        let distance = f64::from(*distance);
        let (x, y) = ((index % width) as f64, (index / width) as f64);
        let pixels = (RADIUS * focal / distance).min(MAX_PIXELS);
        if !pixels.is_finite() || pixels < 1.0 {
            light.push(1.0);
            continue;
        }
        let radius = pixels * distance / focal;
        // A turn of the sample pattern per pixel, in a block of 4 x 4 pixels, which smoothing then averages.
        let turn = f64::from(((index % width) % 4 + 4 * ((index / width) % 4)) as u32) / 16.0;
        let at = |dx: f64, dy: f64| {
            let (i, j) = ((x + dx).round(), (y + dy).round());
            let inside = i >= 0.0 && j >= 0.0 && i < width as f64 && j < height as f64;
            inside.then(|| f64::from(distances[j as usize * width + i as usize]))
        };
        let mut sum = 0.0;
        for pair in 0..PAIRS {
            let part = (pair as f64 + 0.5) / PAIRS as f64;
            let angle = std::f64::consts::PI * (part + turn / PAIRS as f64) * 3.0;
            // Uniform over the disc.
            let away = (0.9 * part).sqrt();
            let half = radius * (1.0 - away * away).sqrt();
            let (dx, dy) = (pixels * away * angle.cos(), pixels * away * angle.sin());
            let behind = |other: Option<f64>| match other {
                // Beyond the picture, or of another object far before this one: not known.
                Some(other) if other > distance - FAR * radius => {
                    ((distance + half - other) / (2.0 * half)).clamp(0.0, 1.0)
                }
                _ => 0.5,
            };
            sum += (behind(at(dx, dy)) + behind(at(-dx, -dy)) - 1.0).max(0.0);
        }
        light.push(1.0 - STRENGTH * sum / PAIRS as f64);
    }
    light
}

/// Averages blocks of 4 x 4 pixels around each pixel, so that the pattern of the samples does not show.
fn smooth(values: &[f64], width: usize, height: usize) -> Vec<f64> {
    let average = |values: &[f64], count: usize, stride: usize, at: usize, place: usize| {
        let (low, high) = (place.saturating_sub(2), (place + 2).min(count));
        (low..high).map(|k| values[at + k * stride - place * stride]).sum::<f64>() / (high - low) as f64
    };
    let rows: Vec<f64> = (0..values.len()).map(|at| average(values, width, 1, at, at % width)).collect();
    (0..rows.len()).map(|at| average(&rows, height, width, at, at / width)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 96;
    const FOCAL: f64 = 100.0;

    /// Light in the middle of a picture whose distance, m, is a function of the place from the middle, m.
    fn middle(distance: impl Fn(f64, f64) -> f64) -> f64 {
        let place = |k: usize| (k as f64 - 48.0) * 0.5 / FOCAL;
        let distances: Vec<f32> =
            (0..SIDE * SIDE).map(|at| distance(place(at % SIDE), place(at / SIDE)) as f32).collect();
        smooth(&light(&distances, SIDE, SIDE, FOCAL), SIDE, SIDE)[48 * SIDE + 48]
    }

    #[test]
    fn flat_surfaces_lose_no_light_at_any_tilt() {
        for tilt in [0.0, 0.3, -1.0, 2.0] {
            let light = middle(|x, y| 0.5 + tilt * x - 0.4 * tilt * y);
            assert!(light > 0.985, "tilt {tilt}: {light}");
        }
    }

    #[test]
    fn edges_that_stick_out_lose_no_light_and_creases_lose_more_the_narrower_they_are() {
        assert!(middle(|x, _| 0.5 + 1.0 * x.abs()) > 0.985);
        let crease = |steepness: f64| middle(|x, _| 0.5 - steepness * x.abs());
        let [wide, right_angle, narrow] = [0.4, 1.0, 2.5].map(crease);
        assert!(
            wide < 0.97 && right_angle < wide - 0.05 && narrow < right_angle - 0.05,
            "{wide} {right_angle} {narrow}"
        );
        assert!(narrow > 1.0 - STRENGTH);
    }

    #[test]
    fn a_surface_far_before_another_takes_no_light_from_it_and_one_close_by_does() {
        let step = |near: f64| middle(|x, _| if x > 0.004 { 0.5 - near } else { 0.5 });
        assert!(step(0.2) > 0.99, "{}", step(0.2));
        assert!(step(0.01) < 0.95, "{}", step(0.01));
    }

    #[test]
    fn pictures_without_fitting_distances_stay_as_they_are() {
        let grey = [90.0; 3 * 64];
        for distances in [vec![], vec![f32::INFINITY; 64], vec![f32::NAN; 64], vec![0.0; 64]] {
            let mut picture = grey;
            shade(&mut picture, (8, 8), &distances, FOCAL);
            assert_eq!(picture, grey);
        }
    }
}
