//! The solver: derivatives by finite differences, optima by multi-start, analytic cases, bounds.

use egotac::mujoco::{PhysicsOptions, World};
use egotac::retarget::Robot;
use egotac::retarget::problem::{GapSide, Problem, Vector};
use egotac::retarget::robot::spec::RobotSpec;
use egotac::retarget::solver::{Solver, Stop};
use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Two links of 0.3 m and 0.2 m in the plane x-z.
const ARM: &str = r#"<mujoco><compiler angle="radian"/><worldbody><body name="index_a"><joint name="a" axis="0 1 0" range="-3 3"/>
    <geom type="capsule" size=".01" fromto="0 0 0 0 0 .3"/><body name="index_b" pos="0 0 .3"><joint name="b" axis="0 1 0" range="0 3"/>
    <geom type="capsule" size=".01" fromto="0 0 0 0 0 .2"/><site name="index_tip" pos="0 0 .2"/></body></body></worldbody></mujoco>"#;

fn arm() -> Robot {
    let world = World::from_mjcf(ARM, &PhysicsOptions::default()).unwrap();
    let spec = RobotSpec::parse("robot: arm\nwrist: { frame: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }").unwrap();
    Robot::new(spec, world, "a test".into(), Vec::new()).unwrap()
}

fn reach(robot: &mut Robot, target: DVec3, start: [f64; 2]) -> ([f64; 2], f64) {
    let mut problem = Problem::new(&robot.world, &robot.parts, &robot.coupling);
    let tip = problem.add_point(robot.fingers[0].tip_body, robot.fingers[0].tip);
    problem.vectors.push(Vector { from: None, to: tip, target, weight: 1.0, huber: f64::INFINITY });
    let mut u = start;
    let stop = Stop { iterations: 100, tolerance: 1e-12 };
    let solved =
        Solver::new(2).solve(&mut problem, &mut robot.world, &robot.parts, &robot.coupling, stop, &mut u).unwrap();
    (u, solved.cost)
}

#[test]
fn two_links_reach_by_the_law_of_cosines() {
    let mut robot = arm();
    for (x, z) in [(0.3, 0.2), (0.1, 0.35), (-0.2, 0.25)] {
        let (u, cost) = reach(&mut robot, DVec3::new(x, 0.0, z), [0.1, 1.0]);
        let d2: f64 = x * x + z * z;
        let elbow = ((d2 - 0.09 - 0.04) / 0.12).acos();
        assert!(cost < 1e-12 && (u[1] - elbow).abs() < 1e-5, "{u:?}, elbow {elbow}, cost {cost}");
    }
}

#[test]
fn out_of_reach_the_arm_points_at_the_target_with_its_elbow_at_the_bound() {
    let mut robot = arm();
    let (u, cost) = reach(&mut robot, DVec3::new(0.6, 0.0, 0.6), [0.1, 1.0]);
    assert!((0.0..1e-6).contains(&u[1]), "{u:?}");
    assert!((u[0] - std::f64::consts::FRAC_PI_4).abs() < 1e-5, "{u:?}");
    let miss = 0.72f64.sqrt() - 0.5;
    assert!((cost - 0.5 * miss * miss).abs() < 1e-9);
}

#[test]
fn within_narrowed_bounds_the_best_pose_is_found() {
    let mut robot = arm();
    let target = DVec3::new(0.1, 0.0, 0.35);
    let mut problem = Problem::new(&robot.world, &robot.parts, &robot.coupling);
    let tip = problem.add_point(robot.fingers[0].tip_body, robot.fingers[0].tip);
    problem.vectors.push(Vector { from: None, to: tip, target, weight: 1.0, huber: f64::INFINITY });
    let Robot { world, parts, coupling, .. } = &mut robot;
    let stop = Stop { iterations: 100, tolerance: 1e-12 };
    let (centre, reach) = ([0.4, 0.5], [0.2, 0.1]);
    let mut solver = Solver::new(2);
    solver.narrow(&centre, &reach);
    let mut u = centre;
    let solved = solver.solve(&mut problem, world, parts, coupling, stop, &mut u).unwrap();
    assert!((0..2).all(|k| (u[k] - centre[k]).abs() <= reach[k] + 1e-12), "{u:?}");
    // No pose of a grid over the bounds is better.
    let steps = 200;
    for (i, j) in (0..=steps).flat_map(|i| (0..=steps).map(move |j| (i, j))) {
        let at = |k: usize, i: usize| centre[k] + reach[k] * (2.0 * i as f64 / steps as f64 - 1.0);
        let cost = problem.cost(world, parts, coupling, &[at(0, i), at(1, j)]).unwrap();
        assert!(solved.cost <= cost + 1e-12, "{} here, {cost} at {i}, {j}", solved.cost);
    }
    solver.widen();
    let free = solver.solve(&mut problem, world, parts, coupling, stop, &mut u).unwrap();
    assert!(free.cost < 1e-12 && (u[1] - centre[1]).abs() > reach[1]);
}

#[test]
fn two_points_coincide_within_twelve_steps() {
    const TWO: &str = r#"<mujoco><compiler angle="radian"/><worldbody>
        <body name="thumb_a"><joint name="ta" axis="0 1 0"/><geom type="capsule" size=".001" fromto="0 0 0 0 0 .1"/>
        <body name="thumb_b" pos="0 0 .1"><joint name="tb" axis="1 0 0"/><geom type="capsule" size=".001" fromto="0 0 0 0 0 .1"/>
        <site name="thumb_tip" pos="0 0 .1"/></body></body>
        <body name="index_a" pos=".08 0 0"><joint name="ia" axis="0 1 0"/><geom type="capsule" size=".001" fromto="0 0 0 0 0 .1"/>
        <body name="index_b" pos="0 0 .1"><joint name="ib" axis="0 1 0"/><geom type="capsule" size=".001" fromto="0 0 0 0 0 .1"/>
        <site name="index_tip" pos="0 0 .1"/></body></body></worldbody></mujoco>"#;
    let world = World::from_mjcf(TWO, &PhysicsOptions::default()).unwrap();
    let spec = RobotSpec::parse("robot: two\nwrist: { frame: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] }").unwrap();
    let mut robot = Robot::new(spec, world, "a test".into(), Vec::new()).unwrap();
    let mut problem = Problem::new(&robot.world, &robot.parts, &robot.coupling);
    let tips: Vec<usize> =
        robot.fingers.clone().iter().map(|finger| problem.add_point(finger.tip_body, finger.tip)).collect();
    let ball = |point| GapSide::Sphere { point, radius: 0.0 };
    let gap = problem.add_gap([ball(tips[0]), ball(tips[1])], false);
    problem.weigh(gap, 1.0);
    let Robot { world, parts, coupling, .. } = &mut robot;
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..50 {
        let mut u: Vec<f64> = (0..4).map(|_| rng.random_range(-0.3..0.3)).collect();
        let stop = Stop { iterations: 12, tolerance: 1e-9 };
        Solver::new(4).solve(&mut problem, world, parts, coupling, stop, &mut u).unwrap();
        problem.cost(world, parts, coupling, &u).unwrap();
        let apart = problem.position(tips[0]).distance(problem.position(tips[1]));
        assert!(apart < 1e-5, "{apart} m apart after 12 steps");
    }
}

#[test]
fn derivatives_are_those_of_finite_differences() {
    let mut robot = Robot::load("tendon_hand", None).unwrap();
    let mut problem = Problem::new(&robot.world, &robot.parts, &robot.coupling);
    let fingers = robot.fingers.clone();
    let tips: Vec<usize> = fingers.iter().map(|f| problem.add_point(f.tip_body, f.tip)).collect();
    for (k, tip) in tips.iter().enumerate() {
        // One far beyond the Huber length, others within.
        let target = DVec3::new(0.03, 0.01 * k as f64, if k == 1 { 0.5 } else { 0.15 });
        problem.vectors.push(Vector { from: None, to: *tip, target, weight: 1.5, huber: 0.1 });
        problem.vectors.push(Vector {
            from: Some(tips[0]),
            to: *tip,
            target: DVec3::X * 0.02,
            weight: 0.5,
            huber: 0.03,
        });
    }
    let ball = |point| GapSide::Sphere { point, radius: 0.008 };
    let gap = problem.add_gap([ball(tips[0]), ball(tips[2])], false);
    problem.weigh(gap, 3.0);
    let n = robot.coupling.len();
    problem.neutral_weight = vec![0.01; n];
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for _ in 0..5 {
        let u: Vec<f64> = (0..n).map(|k| rng.random_range(robot.coupling.low[k]..robot.coupling.high[k])).collect();
        let (mut gradient, mut hessian) = (DVector::zeros(n), DMatrix::zeros(n, n));
        let mut at = |u: &[f64], gradient: &mut DVector<f64>, hessian: &mut DMatrix<f64>| {
            let cost = problem.cost(&mut robot.world, &robot.parts, &robot.coupling, u).unwrap();
            problem.derivatives(&robot.world, u, gradient, hessian);
            cost
        };
        at(&u, &mut gradient, &mut hessian);
        let (mut more, mut less, mut spare) = (DVector::zeros(n), DVector::zeros(n), DMatrix::zeros(n, n));
        for k in 0..n {
            let shifted = |by: f64| {
                let mut u = u.clone();
                u[k] += by;
                u
            };
            let slope = (at(&shifted(1e-6), &mut more, &mut spare) - at(&shifted(-1e-6), &mut less, &mut spare)) / 2e-6;
            assert!((slope - gradient[k]).abs() < 1e-6 * (1.0 + slope.abs()), "{slope} {}", gradient[k]);
        }
    }
    // Without gaps, whose second derivatives are left out, the Hessian is exact.
    problem.weigh(gap, 0.0);
    let u: Vec<f64> = (0..n).map(|k| 0.6 * robot.coupling.low[k] + 0.4 * robot.coupling.high[k]).collect();
    let (mut gradient, mut hessian) = (DVector::zeros(n), DMatrix::zeros(n, n));
    problem.cost(&mut robot.world, &robot.parts, &robot.coupling, &u).unwrap();
    problem.derivatives(&robot.world, &u, &mut gradient, &mut hessian);
    let (mut more, mut less, mut spare) = (DVector::zeros(n), DVector::zeros(n), DMatrix::zeros(n, n));
    for col in 0..n {
        for (sign, out) in [(1.0, &mut more), (-1.0, &mut less)] {
            let mut u = u.clone();
            u[col] += sign * 1e-5;
            problem.cost(&mut robot.world, &robot.parts, &robot.coupling, &u).unwrap();
            problem.derivatives(&robot.world, &u, out, &mut spare);
        }
        for row in col..n {
            let curve = (more[row] - less[row]) / 2e-5;
            assert!((curve - hessian[(row, col)]).abs() < 1e-5, "({row}, {col}): {curve} {}", hessian[(row, col)]);
        }
    }
}

#[test]
fn reachable_targets_are_reached() {
    let mut robot = Robot::load("four_finger", None).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let n = robot.coupling.len();
    let mut problem = Problem::new(&robot.world, &robot.parts, &robot.coupling);
    let fingers = robot.fingers.clone();
    for finger in &fingers {
        let tip = problem.add_point(finger.tip_body, finger.tip);
        problem.vectors.push(Vector { from: None, to: tip, target: DVec3::ZERO, weight: 1.0, huber: f64::INFINITY });
    }
    let mut solver = Solver::new(n);
    let (mut exact, mut steps) = (0, 0);
    for _ in 0..1000 {
        let goal: Vec<f64> = (0..n).map(|k| rng.random_range(robot.coupling.low[k]..robot.coupling.high[k])).collect();
        problem.cost(&mut robot.world, &robot.parts, &robot.coupling, &goal).unwrap();
        let places: Vec<DVec3> = problem.vectors.iter().map(|vector| problem.position(vector.to)).collect();
        problem.vectors.iter_mut().zip(places).for_each(|(vector, place)| vector.target = place);
        let mut u: Vec<f64> = goal.iter().map(|x| x + rng.random_range(-0.5..0.5)).collect();
        let stop = Stop { iterations: 60, tolerance: 1e-9 };
        let solved = solver.solve(&mut problem, &mut robot.world, &robot.parts, &robot.coupling, stop, &mut u).unwrap();
        assert!((0..n).all(|k| (robot.coupling.low[k]..=robot.coupling.high[k]).contains(&u[k])));
        exact += usize::from(solved.cost < 0.5 * 1e-4f64.powi(2));
        steps += solved.iterations;
    }
    // Starts are up to half a radian off in every joint: some lie in another basin.
    assert!(exact >= 980, "{exact} of 1000 within 0.1 mm");
    // The cost tends to 0, and a tolerance relative to it as well: the solver must stop at the rounding of the cost.
    assert!(steps <= 15_000, "{steps} steps");
}
