//! `egotac sim list` and `egotac sim show`: names and pictures of scenes.

use std::path::Path;

use ::image::{GenericImage, Rgb, RgbImage};
use anyhow::{Context, ensure};

use super::shared::{options, with_hands};
use super::{List, Show};
use crate::file;
use crate::hand::Side;
use crate::sim::scene::Split;
use crate::sim::{Rollout, SHIPPED, Scene, SimFrame};

pub fn list(args: &List) -> anyhow::Result<()> {
    let names = match &args.split {
        Some(split) => Split::named(split)?.scene_names(split),
        None => SHIPPED.iter().map(|(name, _)| (*name).into()).collect(),
    };
    let width = names.iter().map(String::len).max().unwrap_or(0);
    for name in &names {
        println!("{name:width$}  {}", Scene::load(name)?.spec.description);
    }
    Ok(())
}

pub fn show(args: &Show) -> anyhow::Result<()> {
    let mut rollout = Rollout::new(
        &with_hands(Scene::load(&args.scene)?, &args.rollout)?,
        args.seed,
        &options(&args.rollout, args.size)?,
    )?;
    let instants = instants(args, &rollout)?;
    let columns = (instants.len() as f64).sqrt().ceil() as u32;
    let rows = (instants.len() as u32).div_ceil(columns);
    let pixels = u64::from(columns * args.size) * u64::from(rows * args.size);
    file::limits::IMAGE.check(&args.out, "--sheet with this --size", pixels)?;
    let mut sheet = RgbImage::new(columns * args.size, rows * args.size);
    let mut at = 0;
    for (i, instant) in instants.iter().enumerate() {
        while at < *instant {
            ensure!(rollout.skip_frame(), "the simulation ended early, at {:.2} s", rollout.world().time());
            at += 1;
        }
        let frame = rollout.next_frame()?.context("the simulation ended early")?;
        at += 1;
        let mut picture = frame.frame.camera_ego_rgb.clone();
        if args.touch {
            paint_touch(&mut picture, &frame, &rollout);
        }
        let (x, y) = (i as u32 % columns * args.size, i as u32 / columns * args.size);
        sheet.copy_from(&picture, x, y)?;
        let total: f64 = frame.hands.iter().flatten().map(|hand| hand.total).sum();
        println!(
            "t = {:.2} s: {:.2} N on the hands, {} vertices in contact",
            frame.frame.timestamp,
            total,
            touched(&frame)
        );
        if args.contacts {
            print_contacts(&rollout);
        }
    }
    write_png(&sheet, &args.out)
}

/// Selects the frames to show: by time, evenly spread, or the middle one.
fn instants(args: &Show, rollout: &Rollout) -> anyhow::Result<Vec<usize>> {
    let frames = rollout.frame_count();
    Ok(match (args.time.map(|time| time.0), args.sheet) {
        (Some(time), _) => {
            let last = (frames - 1) as f64 * rollout.interval();
            ensure!((0.0..=last + 1e-9).contains(&time), "--time: expected 0 to {last:.2} s, got {time}");
            vec![(time / rollout.interval()).round() as usize]
        }
        (None, Some(count)) => {
            ensure!((1..=100).contains(&count), "--sheet: expected 1 to 100 pictures, got {count}");
            (0..count).map(|i| (i * 2 + 1) * (frames - 1) / (2 * count)).collect()
        }
        (None, None) => vec![frames / 2],
    })
}

/// Prints bodies, normal force and penetration depth of each contact.
fn print_contacts(rollout: &Rollout) {
    let world = rollout.world();
    for contact in world.contacts() {
        let [a, b] = contact.bodies.map(|body| world.body_name(body));
        let depth = -1e3 * contact.distance;
        println!("  {a:16} {b:16} {:7.3} N, depth {depth:6.2} mm", contact.normal_force);
    }
}

/// Counts the vertices in contact.
fn touched(frame: &SimFrame) -> usize {
    frame.frame.field.contact.iter().filter(|c| **c > 0.5).count()
}

/// Paints a disc on each vertex in contact, from yellow to red with increasing force.
fn paint_touch(picture: &mut RgbImage, frame: &SimFrame, rollout: &Rollout) {
    for side in Side::BOTH {
        let Some(params) = rollout.hand_params(side) else { continue };
        let vertices = rollout.rigs()[side as usize].model.forward(&params).vertices;
        for (vertex, force) in vertices.iter().zip(&frame.frame.field.force[side.range()]) {
            let local = frame.camera.camera_from_world(vertex.as_dvec3());
            let Some([x, y]) = rollout.intrinsics().project(local).filter(|_| *force > crate::tactile::CONTACT_FORCE_N)
            else {
                continue;
            };
            let green = (230.0 * (1.0 - force / 0.6).clamp(0.0, 1.0)) as u8;
            let radius = f64::from(picture.width()) / 180.0;
            let reach = radius.ceil() as i64;
            for (dx, dy) in (-reach..=reach).flat_map(|dx| (-reach..=reach).map(move |dy| (dx, dy))) {
                let (px, py) = (x as i64 + dx, y as i64 + dy);
                let inside = px >= 0 && py >= 0 && px < i64::from(picture.width()) && py < i64::from(picture.height());
                if inside && ((dx * dx + dy * dy) as f64) <= radius * radius {
                    picture.put_pixel(px as u32, py as u32, Rgb([255, green, 0]));
                }
            }
        }
    }
}

fn write_png(picture: &RgbImage, out: &Path) -> anyhow::Result<()> {
    file::write_png(out, picture)?;
    println!("wrote {}", out.display());
    Ok(())
}
