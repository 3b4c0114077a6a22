use egotac::bench::retarget::{follow, trajectory::{Noise, Trajectory}};
use egotac::retarget::Robot;
fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let n: usize = args[0].parse().unwrap();
    let t = Trajectory::generate(n, 1).unwrap();
    let t2 = t.with(Noise::White(0.002), 2);
    let t5 = t.with(Noise::White(0.005), 3);
    let ts = t.with(Noise::Spikes, 4);
    for name in &args[1..] {
        let go = |t: &Trajectory, touch| follow::follow(Robot::load(name, None).unwrap(), t, touch).unwrap();
        let c = go(&t, true);
        for (what, f) in [("clean", c.clone()), ("2mm", go(&t2, true)), ("5mm", go(&t5, true)), ("spikes", go(&ts, true))] {
            let dev = { let mut s=0.0; let mut k=0.0; for (a,b) in f.qpos.iter().zip(&c.qpos) { for (x,y) in a.iter().zip(b) { s+=(x-y)*(x-y); k+=1.0; } } f64::sqrt(s/k) };
            println!("{name:20} {what:6} {:5.0}/{:5.0} us tip {:.2} mm lim {:.1e} speed {:.2} deep {:.2} mm ({:.4}) pinch {:.3} open {:.3} false {:.3} net {:.3} angle {:.1} jerk {:.0} dev {:.3}", f.median_us, f.p99_us, f.tip_error_mm, f.limit_violation, f.speed_share, f.deepest_mm, f.colliding, f.pinch_closed, f.pinch_opened, f.false_contacts, f.net_force_error, f.force_angle_deg, f.jerk, dev);
        }
        if std::env::var("PINCH").is_ok() {
            use egotac::retarget::*; let mut r = Retargeter::new(Robot::load(name, None).unwrap()).unwrap();
            for f in 0..n { let mut i = Input::new(t.keypoints[f], f as f64/30.0); i.touch = Some(Touch{ tip_contact: t.tip_contact[f], tip_force: Some(t.tip_force[f]), slots: None }); r.push(&i).unwrap();
                if f%120==60 { let out = r.output().clone(); println!("frame {f} status {:?} cost {:.2e} it {} contact {:?} asked {:.2} clipped {}", out.status, out.objective, out.iterations, t.tip_contact[f], out.feel.asked, out.feel.clipped);
                    for l in &out.feel.links { if l.normal_force>0.0 { println!("    {} {:.2} {:.2}", l.name, l.normal_force, l.force); } }
                    println!("    in {:?}", t.tip_force[f].map(|x| format!("{x:.2}")));
                    let (robot, goal) = r.look(); for k in 0..robot.fingers.len() { println!("    finger {k} gap {:?} tip error {:.4}", goal.exact_gap(robot,k), goal.tip_error(robot,k)); }
                    if std::env::var("PIC").is_ok() { let axes = robot.wrist.world_axes(&robot.world); robot.world.forward(); let mid = robot.world.body_pose(robot.root).0 + axes.z_axis*0.1; let mut ren = egotac::mujoco::Renderer::around(&robot.world, mid, axes.x_axis*0.7+axes.y_axis*0.7, 0.4, 480, 480).unwrap(); ren.render(&mut robot.world).unwrap().save(format!("/work/scratch/rt/pin_{name}_{f}.png")).unwrap(); }
                }
            }
        }
        if std::env::var("JUMPS").is_ok() { let names: Vec<String> = Robot::load(name, None).unwrap().joint_names().iter().map(|s| s.to_string()).collect(); for (i,w) in c.qpos.windows(2).enumerate() { for k in 0..names.len() { let d=w[1][k]-w[0][k]; if d.abs()>0.15 { println!("  frame {} {} {:.3} -> {:.3} contact {:?}", i+1, names[k], w[0][k], w[1][k], t.tip_contact[i+1]); } } } }
        let mut r = Robot::load(name, None).unwrap(); r.spec.filter.time_constant=0.0;
        let raw = follow::follow(r, &t, true).unwrap();
        println!("   raw jerk {:.0} lag {:.1} ms", raw.jerk, 1e3*follow::lag(&raw.qpos, &c.qpos));
    }
}
