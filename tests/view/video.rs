//! Videos of labelled recordings.

use egotac::dataset::video::{VideoFrames, probe};

use crate::common::store::write_bright_store;
use crate::common::{egotac, refused};

#[test]
fn a_video_of_labels_shows_each_image_with_both_hands_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    write_bright_store(at("in.zarr").as_ref(), 6);
    let arguments = ["label", &at("in.zarr"), "--out", &at("out.zarr"), "--unknown", "guess", "--video", &at("v.mp4")];
    let output = egotac(&arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let video = probe(at("v.mp4").as_ref()).unwrap();
    assert!((video.fps.unwrap() - 25.0).abs() < 0.1);
    let frames: Vec<_> = VideoFrames::open(at("v.mp4").as_ref(), None).unwrap().map(Result::unwrap).collect();
    assert_eq!(frames.len(), 6);
    for (index, (_, picture)) in frames.iter().enumerate() {
        // The image, 480 x 480, is red as its force; then come the hands on white.
        let level = (index * 37 % 11) as f32 / 10.0;
        let red = f32::from(picture.get_pixel(240, 200).0[0]);
        assert!((red - 200.0 * level).abs() < 12.0, "{index}: {red} {level}");
        let skin = |x0: u32| {
            let pixels = (x0..x0 + 264).flat_map(|x| (40..230).map(move |y| picture.get_pixel(x, y).0));
            pixels.filter(|[r, g, b]| *r < 245 && *r > *b && *g > 60).count()
        };
        let (left, right) = (skin(480), skin(480 + 264));
        assert!(left > 5000 && right > 5000, "{index}: {left} {right}");
        // Truth stands below.
        let below = (480..1000).flat_map(|x| (250..415).map(move |y| picture.get_pixel(x, y).0));
        assert!(below.filter(|[r, _, b]| *r < 245 && *r > *b).count() > 8000);
    }
    // Labels that were made before get the same video.
    let before = std::fs::read(at("v.mp4")).unwrap();
    assert!(egotac(&arguments).status.success());
    assert!(std::fs::read(at("v.mp4")).unwrap() == before);
    refused(
        &["label", &at("in.zarr"), "--out", &at("other.zarr"), "--video", &at("v.txt")],
        "expected a name that ends in",
    );
    assert!(!folder.path().join("other.zarr").exists());
}
