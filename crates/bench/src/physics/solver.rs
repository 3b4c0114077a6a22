//! The solver of forces from motion beside a general solver of cone programs, a peer.

use std::time::Instant;

use egotac::error::{Error, Result};
use egotac::file;
use egotac::physics::cone::Cone;
use egotac::physics::solve::{Forces, Point, solve};
use glam::DVec3;
use nalgebra::{Matrix6, Vector6};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::peer;

/// Numbers of contact points: a fingertip's, a pinch's, a hand's with a table.
const POINTS: [usize; 3] = [4, 12, 40];
/// Problems of each size.
const PROBLEMS: usize = 200;

/// Both solvers on the same problems.
#[derive(Debug, Clone, Serialize)]
pub struct SolverRow {
    /// Contact points of a problem.
    pub points: usize,
    /// Problems.
    pub problems: usize,
    /// Time of a problem with egotac's solver, µs, mean.
    pub own_us: f64,
    /// Time of a problem with the peer, µs, mean, as the peer itself counts it.
    pub peer_us: f64,
    /// Largest distance between both forces at a point, N.
    pub force_difference: f64,
    /// Problems that either solver gave up.
    pub unsolved: usize,
    /// Version of the peer.
    pub version: String,
}

/// Answer of the peer.
#[derive(Deserialize)]
struct Answer {
    version: String,
    /// Of each problem the force at each point, N, in its contact frame; `None` = not solved.
    forces: Vec<Option<Vec<[f64; 3]>>>,
    seconds: Vec<f64>,
}

/// One problem: contact points, wrench, covariance.
struct Problem {
    points: Vec<Point>,
    wrench: Vector6<f64>,
    covariance: Matrix6<f64>,
}

/// Compares egotac's solver with the peer that `command` starts, on random problems.
///
/// # Errors
/// If the peer fails.
pub fn compare(command: &str) -> Result<Vec<SolverRow>> {
    POINTS.into_iter().map(|points| compare_on(command, points)).collect()
}

fn compare_on(command: &str, points: usize) -> Result<SolverRow> {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let problems: Vec<Problem> = (0..PROBLEMS).map(|_| Problem::random(points, &mut rng)).collect();
    let folder = tempfile::tempdir().map_err(Error::io("temporary folder"))?;
    let path = folder.path().join("problems.json");
    let described: Vec<Value> = problems.iter().map(Problem::describe).collect();
    file::write(&path, Value::from(described).to_string().as_bytes())?;
    let answer: Answer = peer::ask(command, &["--input".into(), path.into_os_string()], 1)?;
    if answer.forces.len() != problems.len() || answer.seconds.len() != problems.len() {
        let expected = format!("forces and seconds of {} problems", problems.len());
        return Err(Error::value(format!("peer {command:?}"), expected, answer.forces.len()));
    }
    let started = Instant::now();
    let own: Vec<Forces> = problems.iter().map(|p| solve(&p.points, &p.wrench, &p.covariance)).collect();
    let own_us = 1e6 * started.elapsed().as_secs_f64() / PROBLEMS as f64;
    let peer_us = 1e6 * answer.seconds.iter().sum::<f64>() / PROBLEMS as f64;
    let mut row = SolverRow {
        points,
        problems: PROBLEMS,
        own_us,
        peer_us,
        force_difference: 0.0,
        unsolved: 0,
        version: answer.version,
    };
    for (own, theirs) in own.iter().zip(&answer.forces) {
        match theirs.as_ref().filter(|_| own.converged) {
            None => row.unsolved += 1,
            Some(theirs) => {
                let differences = own.forces.iter().zip(theirs).map(|(a, b)| a.distance(DVec3::from_array(*b)));
                row.force_difference = differences.fold(row.force_difference, f64::max);
            }
        }
    }
    Ok(row)
}

impl Problem {
    /// Draws points on a body of 10 cm, and a wrench of some newtons with its covariance.
    fn random(points: usize, rng: &mut ChaCha8Rng) -> Self {
        fn vector(size: f64, rng: &mut ChaCha8Rng) -> DVec3 {
            DVec3::from_array(std::array::from_fn(|_| rng.random_range(-size..size)))
        }
        let point = |_| {
            let inward = vector(1.0, rng).normalize();
            let (t1, t2) = inward.any_orthonormal_pair();
            let cone = Cone { friction: rng.random_range(0.3..1.2), limit: rng.random_range(5.0..80.0) };
            Point::new(vector(0.05, rng), [inward, t1, t2], vector(3.0, rng), rng.random_range(0.3..10.0), cone)
        };
        let points = (0..points).map(point).collect();
        let wrench = Vector6::from_fn(|row, _| rng.random_range(-1.0..1.0) * if row < 3 { 5.0 } else { 0.1 });
        let sds = Vector6::from_fn(|row, _| rng.random_range(0.01..0.3) * if row < 3 { 1.0 } else { 0.03 });
        Self { points, wrench, covariance: Matrix6::from_diagonal(&sds.component_mul(&sds)) }
    }

    /// Returns the problem as the peer reads it.
    fn describe(&self) -> Value {
        let rows = |rows: usize, columns: usize, at: &dyn Fn(usize, usize) -> f64| -> Vec<Vec<f64>> {
            (0..rows).map(|row| (0..columns).map(|column| at(row, column)).collect()).collect()
        };
        let points: Vec<Value> = self
            .points
            .iter()
            .map(|point| {
                json!({
                    "map": rows(6, 3, &|row, column| point.map[(row, column)]),
                    "expected": point.expected.to_array(),
                    "precision": point.precision,
                    "friction": point.cone.friction,
                    "limit": point.cone.limit,
                })
            })
            .collect();
        json!({
            "points": points,
            "wrench": self.wrench.as_slice(),
            "covariance": rows(6, 6, &|row, column| self.covariance[(row, column)]),
        })
    }
}
