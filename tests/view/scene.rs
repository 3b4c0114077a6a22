//! Files for Foxglove.

use egotac::message::{CompressedImage, MarkerArray, Message, TactileFrame, TactileRegions, TactileTruth};
use egotac::render::force_color;
use egotac::view::{ClipOptions, open_clips};
use egotac::{Side, dataset::Labelled};

use crate::common::store::write_bright_store;
use crate::common::{egotac, refused};

#[test]
fn a_scene_holds_the_labels_and_truth_of_each_image_and_hands_in_their_colours() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    write_bright_store(at("in.zarr").as_ref(), 4);
    let arguments = ["label", &at("in.zarr"), "--out", &at("out.zarr"), "--unknown", "guess", "--foxglove"];
    let output = egotac(&[&arguments[..], &[&at("touch.mcap")]].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let labelled = Labelled::read(at("out.zarr").as_ref()).unwrap();
    let truth = labelled.truth.unwrap();
    let clips = open_clips(at("out.zarr").as_ref(), &ClipOptions::default()).unwrap();
    let scale = clips[0].about().scale;

    let (mut frames, mut truths, mut regions, mut pictures, mut markers) = (vec![], vec![], vec![], vec![], vec![]);
    let bytes = std::fs::read(at("touch.mcap")).unwrap();
    for message in mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
        let (payload, schema) = (&message.data[..], message.channel.schema.as_ref().unwrap());
        match (message.channel.topic.as_str(), schema.name.as_str()) {
            ("/predictor/tactile", TactileFrame::TYPE) => {
                frames.push((message.log_time, TactileFrame::from_cdr(payload).unwrap()));
            }
            ("/truth/tactile", TactileTruth::TYPE) => truths.push(TactileTruth::from_cdr(payload).unwrap()),
            ("/predictor/regions", TactileRegions::TYPE) => regions.push(TactileRegions::from_cdr(payload).unwrap()),
            ("/predictor/overlay/compressed", CompressedImage::TYPE) => {
                pictures.push(CompressedImage::from_cdr(payload).unwrap());
            }
            ("/predictor/markers", MarkerArray::TYPE) => markers.push(MarkerArray::from_cdr(payload).unwrap()),
            other => panic!("{other:?}"),
        }
    }
    assert_eq!([frames.len(), truths.len(), regions.len(), pictures.len(), markers.len()], [4; 5]);
    for (index, (log_time, frame)) in frames.iter().enumerate() {
        let label = labelled.labels.field(index).unwrap();
        assert_eq!(frame.to_field().unwrap().force, label.force);
        assert_eq!(truths[index].frame.to_field().unwrap().force, truth.field(index).unwrap().force);
        assert_eq!(*log_time, index as u64 * 40_000_000);
        assert_eq!(frame.header.stamp.nanos() as u64, *log_time);
        // Regions cover the hand: their sum is the total force, as plots show it.
        let sum: f32 = regions[index].force[..17].iter().sum();
        assert!((sum - frame.hands[0].total_force).abs() < 1e-3 * sum.max(1.0), "{sum} {}", frame.hands[0].total_force);
        let picture = image::load_from_memory(&pictures[index].data).unwrap().to_rgb8();
        assert_eq!(picture.height(), 480);
        for (marker, side) in markers[index].markers.iter().zip(Side::BOTH) {
            let hand = egotac::hand::HandModel::builtin(side);
            assert_eq!((marker.ns.as_str(), marker.kind, marker.points.len()), (side.name(), 11, 3 * hand.faces.len()));
            for (corner, vertex) in hand.faces.iter().flatten().enumerate() {
                let force = label.force[side.range()][*vertex as usize];
                let shown = marker.colors[corner];
                let wanted = force_color(force, scale).0.map(|byte| f32::from(byte) / 255.0);
                assert_eq!([shown.r, shown.g, shown.b], wanted, "{force}");
            }
        }
    }
    let [sooner, later] = [&markers[0].markers[1], &markers[0].markers[0]].map(|marker| marker.points[0].x);
    assert!(sooner > 0.0 && later < 0.0, "the right hand is on the right");

    refused(&[&arguments[..], &[&at("touch.bag")]].concat(), "expected a name that ends in .mcap");

    // `make check-rerun` tests a program with the feature.
    #[cfg(not(feature = "rerun"))]
    refused(
        &["label", &at("in.zarr"), "--out", &at("other.zarr"), "--rerun", &at("touch.rrd")],
        "with the feature `rerun`",
    );
}
