//! Data sets with measured force become stores: EgoPressure.

use egotac::hand::Side;
use glam::DVec3;
use serde_json::json;

use crate::check::{check_poses, check_stamps, open, supervised};
use crate::common::egotac;
use crate::writers::files::ManoFiles;
use crate::writers::sensors::{FIRST, counts, pad_from_world, write_egopressure};
use crate::writers::take::{FRAMES, Take};

#[test]
fn egopressure_gives_the_touchpads_newtons_to_the_vertices_above_it() {
    let (folder, take) = (tempfile::tempdir().unwrap(), Take::simulated());
    let (root, out) = (folder.path().join("egopressure"), folder.path().join("store.zarr"));
    write_egopressure(&root, &take);
    let mano = ManoFiles::write(folder.path(), &take, false);
    let [source, store, left, right] = [&root, &out, &mano.left, &mano.right].map(|path| path.to_str().unwrap());
    let arguments =
        ["data", "import", "egopressure", source, "--out", store, "--mano-left", left, "--mano-right", right];
    let output = egotac(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let store = open(&out);
    check_stamps(&store, (0..FRAMES).map(|index| (FIRST - 1 + index as i64) as f64 / 30.0));
    check_poses(&store, "data/camera_pose", |index| {
        let frame = &take.frames[index];
        pad_from_world(&take, frame) * frame.camera
    });
    let force = store.read_f32("data/mano_force", 0..FRAMES).unwrap();
    let contact = store.read_contact(0..FRAMES).unwrap();
    let lost = store.read_f32("data/force_lost", 0..FRAMES).unwrap();
    let (mut hits, mut wrong) = (0, 0);
    for (index, frame) in take.frames.iter().enumerate().take(FRAMES - 1) {
        let (_, total, centre) = counts(&take, frame);
        let got = &force[1556 * index..][Side::Right.range()];
        let known = || got.iter().zip(&frame.hand(Side::Right).vertices).filter(|(force, _)| !force.is_nan());
        let sum: f64 = known().map(|(force, _)| f64::from(*force)).sum();
        assert!(
            total > 1.0 && (sum + f64::from(lost[2 * index + 1]) - total).abs() < 1e-3 * total,
            "{sum} N of {total} N"
        );
        assert!(lost[2 * index + 1] < 0.05 * total as f32, "{} N lost", lost[2 * index + 1]);
        let to_pad = pad_from_world(&take, frame);
        let moment: DVec3 = known()
            .map(|(force, vertex)| to_pad.transform_point3(vertex.as_dvec3()).with_z(0.0) * f64::from(*force))
            .sum();
        let away = (moment / sum).distance(centre);
        assert!(away < 0.003, "centre of pressure {away} m away");
        for (vertex, want) in Side::Right.range().zip(&frame.hand(Side::Right).forces) {
            let (got, want) = (contact[1556 * index + vertex] == 1.0, *want > 0.05);
            hits += usize::from(got && want);
            wrong += usize::from(got != want);
        }
    }
    // The simulator's labels are spread over vertices once, those of the cells twice.
    let score = 2.0 * hits as f64 / (2 * hits + wrong) as f64;
    assert!(hits > 50 && score > 0.85, "F1 {score} of {hits} vertices");
    let [with_force, with_contact] = supervised(&store);
    assert_eq!(with_force, with_contact);
    assert!(with_force > (FRAMES - 1) * 400 && with_force <= (FRAMES - 1) * 778, "{with_force}");
    let about = &store.raw_attributes()["import"];
    assert_eq!((&about["force_kind"], &about["contact_rule"]), (&json!("spread"), &json!("force above 0.05 N")));
    assert_eq!(store.raw_attributes()["camera"]["fx"], 1120.5);
}
