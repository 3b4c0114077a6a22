//! Splines, accelerations and noise of poses.

use egotac::physics::motion::MotionFault;
use egotac::physics::spline::Smoother;
use egotac::physics::{Demand, Mass, Motion, Pose, PoseNoise};
use glam::{DMat3, DQuat, DVec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

fn times(n: usize, rate: f64) -> Vec<f64> {
    (0..n).map(|k| k as f64 / rate).collect()
}

fn noisy(poses: &[Option<Pose>], position: f64, rotation: f64, seed: u64) -> Vec<Option<Pose>> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut vector = || DVec3::from_array(std::array::from_fn(|_| StandardNormal.sample(&mut rng)));
    let mut moved = |pose: &Pose| Pose {
        position: pose.position + position * vector(),
        orientation: DQuat::from_scaled_axis(rotation * vector()) * pose.orientation,
    };
    poses.iter().map(|pose| pose.as_ref().map(&mut moved)).collect()
}

#[test]
fn parabolas_pass_a_spline_of_any_bandwidth_unchanged() {
    // Irregular times.
    let times: Vec<f64> = (0..80).map(|k| f64::from(k) / 30.0 + 0.004 * f64::from(k).sin()).collect();
    let values: Vec<f64> = times.iter().map(|t| 0.3 - 2.0 * t + 4.905 * t * t).collect();
    for bandwidth in [1.0, 3.0, 9.0] {
        let smoother = Smoother::new(&times, &[1.0; 80], 1.0 / 30.0, bandwidth).unwrap();
        let coefficients = smoother.fit(&values);
        for time in [times[0], 0.7, 1.31, times[79]] {
            let [value, velocity, acceleration] = smoother.at(&coefficients, time);
            assert!((value - (0.3 - 2.0 * time + 4.905 * time * time)).abs() < 1e-6, "{value} at {time}");
            assert!((velocity - (9.81 * time - 2.0)).abs() < 1e-5, "{velocity} at {time}");
            assert!((acceleration - 9.81).abs() < 1e-4, "{acceleration} at {time}, {bandwidth} Hz");
        }
    }
}

#[test]
fn a_sinusoid_at_the_bandwidth_is_halved() {
    let (times, bandwidth) = (times(400, 60.0), 4.0);
    let smoother = Smoother::new(&times, &[1.0; 400], 1.0 / 60.0, bandwidth).unwrap();
    let values: Vec<f64> = times.iter().map(|t| (2.0 * std::f64::consts::PI * bandwidth * t).sin()).collect();
    let coefficients = smoother.fit(&values);
    let peak = (150..250).map(|k| smoother.at(&coefficients, times[k])[0].abs()).fold(0.0, f64::max);
    assert!((peak - 0.5).abs() < 0.03, "{peak}");
}

#[test]
fn noise_gain_is_the_spread_over_many_noises() {
    let times = times(60, 30.0);
    let smoother = Smoother::new(&times, &[1.0; 60], 1.0 / 30.0, 3.0).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for at in [0, 3, 30] {
        let gain = smoother.noise_gain(times[at]);
        let mut squares = [0.0; 3];
        for _ in 0..2000 {
            let values: Vec<f64> = (0..60).map(|_| StandardNormal.sample(&mut rng)).collect();
            let state = smoother.at(&smoother.fit(&values), times[at]);
            squares.iter_mut().zip(state).for_each(|(sum, x)| *sum += x * x / 2000.0);
        }
        for (gain, square) in gain.iter().zip(squares) {
            assert!((square.sqrt() / gain - 1.0).abs() < 0.06, "{gain} against {} at {at}", square.sqrt());
        }
    }
}

#[test]
fn the_noise_of_poses_is_found_under_motion() {
    let pose = |t: f64| Pose {
        position: DVec3::new(0.1 * (2.0 * t).sin(), 0.2 * t, 0.05 * (5.0 * t).cos()),
        orientation: DQuat::from_scaled_axis(DVec3::new(t, 0.3 * (3.0 * t).sin(), 0.1)),
    };
    let poses: Vec<Option<Pose>> = times(300, 30.0).into_iter().map(|t| Some(pose(t))).collect();
    for (position, rotation) in [(0.001, 0.01), (0.005, 0.05)] {
        let found = PoseNoise::estimate(&noisy(&poses, position, rotation, 2));
        assert!((found.position / position - 1.0).abs() < 0.15, "{found:?}");
        assert!((found.rotation / rotation - 1.0).abs() < 0.15, "{found:?}");
    }
    assert_eq!(PoseNoise::estimate(&poses[..4]), PoseNoise::default());
}

#[test]
fn a_free_top_needs_no_moment() {
    // Euler's equations of a body with three different moments of inertia, integrated finely.
    let inertia = DVec3::new(1e-4, 2e-4, 2.5e-4);
    let (mut spin, mut turn) = (DVec3::new(2.0, 0.5, 1.5), DQuat::IDENTITY);
    let (mut poses, rate, fine) = (Vec::new(), 60.0, 400);
    let times = times(240, rate);
    for _ in &times {
        poses.push(Some(Pose { position: DVec3::ZERO, orientation: turn }));
        for _ in 0..fine {
            let dt = 1.0 / (rate * f64::from(fine));
            let slope = |w: DVec3| -w.cross(inertia * w) / inertia;
            let middle = spin + 0.5 * dt * slope(spin);
            spin += dt * slope(middle);
            turn = (turn * DQuat::from_scaled_axis(middle * dt)).normalize();
        }
    }
    let motion = Motion::new(&times, &poses, DVec3::ZERO, None);
    let mass = Mass { kilograms: 0.2, relative_sd: 0.0, centre: DVec3::ZERO, inertia: DMat3::from_diagonal(inertia) };
    for state in motion.frames[30..210].iter().flatten() {
        let Demand { wrench, .. } = Demand::of(&mass, state, DVec3::ZERO);
        let moment = wrench.fixed_rows::<3>(3).norm();
        let gyroscopic = state.angular_velocity.cross(inertia * state.angular_velocity).length();
        assert!(moment < 2e-6 && gyroscopic > 0.0, "{moment} N m");
        assert!(wrench.fixed_rows::<3>(0).norm() < 1e-6);
    }
}

#[test]
fn intervals_of_accelerations_cover_the_truth_under_noise() {
    let path = |t: f64| DVec3::new(0.05 * (6.0 * t).sin(), 0.0, 0.1 * (3.0 * t).cos());
    let truth = |t: f64| DVec3::new(-1.8 * (6.0 * t).sin(), 0.0, -0.9 * (3.0 * t).cos());
    let times = times(300, 30.0);
    let poses = times.iter().map(|t| Some(Pose { position: path(*t), orientation: DQuat::IDENTITY }));
    let poses: Vec<Option<Pose>> = poses.collect();
    for (noise, seed) in [(0.001, 3), (0.003, 4), (0.005, 5)] {
        let motion = Motion::new(&times, &noisy(&poses, noise, 0.001, seed), DVec3::ZERO, None);
        let (mut inside, mut all) = (0, 0);
        for (time, state) in times.iter().zip(&motion.frames).filter_map(|(t, s)| Some((*t, s.as_ref()?))) {
            let off = state.acceleration - truth(time);
            for axis in 0..3 {
                inside += usize::from(off[axis].abs() <= 1.645 * state.acceleration_sd[axis]);
                all += 1;
            }
        }
        let share = inside as f64 / all as f64;
        assert!(share > 0.8, "{share} at {noise} m, bandwidth {}", motion.bandwidth);
    }
}

#[test]
fn gaps_and_jumps_are_named_and_do_not_bend_the_motion_beside_them() {
    let times = times(120, 30.0);
    let path = |t: f64| Pose { position: DVec3::X * (0.2 * t), orientation: DQuat::IDENTITY };
    let mut poses: Vec<Option<Pose>> = times.iter().map(|t| Some(path(*t))).collect();
    poses[40] = Some(Pose { position: DVec3::new(0.0, 0.5, 0.0), ..path(times[40]) });
    poses[60] = None;
    // From here on the tracker believes the body to be elsewhere.
    for pose in poses[90..].iter_mut().flatten() {
        pose.position += DVec3::Z * 0.4;
    }
    let motion = Motion::new(&times, &poses, DVec3::ZERO, None);
    assert_eq!(motion.faults[40], Some(MotionFault::Jump));
    assert_eq!(motion.faults[60], Some(MotionFault::Gap));
    assert!(motion.faults[89] == Some(MotionFault::Jump) && motion.faults[90] == Some(MotionFault::Jump));
    assert_eq!(motion.faults.iter().flatten().count(), 4);
    for (frame, state) in motion.frames.iter().enumerate().filter(|(frame, _)| motion.faults[*frame].is_none()) {
        let acceleration = state.unwrap().acceleration.length();
        assert!(acceleration < 1e-3, "{acceleration} m/s² at {frame}");
    }
}
