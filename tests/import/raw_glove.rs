//! Raw recordings of EgoTac-SC become stores: streams with clocks of their own, resampled to the images' stamps.

use std::sync::LazyLock;

use egotac::dataset::zarr::{CAMERA_POSE, read_truth};
use egotac::hand::Side;
use egotac::sensor::{self, GloveSpec, SimulatedGlove};
use egotac::tactile::ForceKind;
use glam::{DAffine3, DMat3, DVec3};
use std::sync::Arc;

use crate::check::{check_images, check_poses, check_stamps, open};
use crate::run::{import, imported};
use crate::writers::files::write;
use crate::writers::raw_glove::{force, head, image_ms, write_raw};
use crate::writers::take::{FRAMES, Take};

static TAKE: LazyLock<Take> = LazyLock::new(Take::of_mean_shape);
/// Newtons below which the filter may cut a taxel off at some time, and above which it never does.
const CUT: [f32; 2] = [0.15, 0.23];

/// Returns what simulated gloves read while the forces of the take's first frame act, tripled so that the filter keeps most.
fn touch() -> [Vec<f32>; 2] {
    let map = Arc::new(sensor::open("aether_132").unwrap());
    let forces: Vec<f32> =
        Side::BOTH.iter().flat_map(|side| &TAKE.frames[0].hand(*side).forces).map(|force| 3.0 * force).collect();
    let mut glove = SimulatedGlove::new(map, GloveSpec::ideal("aether_132"), 0).unwrap();
    // No taxel lies where the filter cuts it off in a part of the images.
    let clear = |newtons: f32| if (CUT[0]..CUT[1]).contains(&newtons) { CUT[1] } else { newtons };
    glove.read(0.0, &forces).unwrap().map(|taxels| taxels.into_iter().map(clear).collect())
}

/// Returns the newtons that the filter leaves of a hand's taxels at an image.
fn filtered(touch: &[f32], index: usize) -> Vec<f32> {
    touch.iter().map(|newtons| if *newtons < CUT[1] { 0.0 } else { force(*newtons, image_ms(index)) as f32 }).collect()
}

#[test]
fn streams_of_other_clocks_give_the_force_and_the_pose_at_the_images_stamps() {
    let folder = tempfile::tempdir().unwrap();
    let (root, out) = (folder.path().join("raw"), folder.path().join("store.zarr"));
    let (touch, gap) = (touch(), [3, 7]);
    write_raw(&root, "0007", &TAKE, &touch, Some(gap));
    let store = imported("egotac-sc-raw", &root, &out, &[]);
    check_images(&store, &TAKE);
    check_stamps(&store, (0..FRAMES).map(|index| image_ms(index) / 1e3));
    let camera_axes = DAffine3::from_mat3(DMat3::from_diagonal(DVec3::new(-1.0, -1.0, 1.0)));
    check_poses(&store, CAMERA_POSE, |index| head(image_ms(index)) * camera_axes);
    assert_eq!(store.force_kind().unwrap(), Some(ForceKind::Reading));
    assert_eq!(store.raw_attributes()["camera"]["zedParams"]["cameraSerialNumber"], 42);
    let truth = read_truth(&store).unwrap();
    let map = sensor::open("aether_132").unwrap();
    let mut touched = 0;
    for index in 0..FRAMES {
        for side in Side::BOTH {
            let at = 1556 * index + side.range().start;
            let [force, contact] = [truth.force_at(index), truth.contact_at(index)].map(|field| &field[side.range()]);
            let known = &truth.mask_force[at..at + 778];
            // The left glove was silent from image 3 until after image 7, 0.13 s: the samples on both sides say nothing of these images.
            if side == Side::Left && (gap[0]..=gap[1]).contains(&index) {
                assert!(known.iter().all(|known| *known == 0), "image {index}");
                continue;
            }
            let wanted = map.hands[side as usize].reading(&filtered(&touch[side as usize], index));
            for (vertex, want) in wanted.iter().enumerate() {
                assert_eq!(known[vertex] == 1, !want.is_nan());
                if want.is_nan() {
                    continue;
                }
                let got = force[vertex];
                assert!(
                    (got - want).abs() < 2e-4 * (1.0 + want),
                    "image {index}, vertex {vertex}: {got} N for {want} N"
                );
                assert!((want - 0.05).abs() < 1e-3 || (contact[vertex] == 1.0) == (*want > 0.05));
                touched += usize::from(*want > 0.05);
            }
        }
    }
    assert!(touched > 150, "{touched} touched vertices");
    // Spread forces sum to the taxels.
    let spread = imported("egotac-sc-raw", &root, &folder.path().join("spread.zarr"), &["--force-kind", "spread"]);
    let truth = read_truth(&spread).unwrap();
    let wanted: f32 = filtered(&touch[1], 0).iter().sum();
    let got: f32 = truth.force_at(0)[Side::Right.range()].iter().filter(|force| !force.is_nan()).sum();
    assert!(wanted > 1.0 && (got - wanted).abs() < 1e-3 * wanted, "{got} N of {wanted} N");
}

#[test]
fn recordings_without_images_channels_or_growing_stamps_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let (root, out) = (folder.path().join("raw"), folder.path().join("stores"));
    let touch = touch();
    for id in ["1", "2", "3", "4"] {
        write_raw(&root, id, &TAKE, &touch, None);
    }
    // Only the camera's own file is there.
    std::fs::remove_dir_all(root.join("1/Image_1")).unwrap();
    write(&root.join("1/Image_1.svo2"), "svo");
    std::fs::rename(root.join(format!("2/Image_2/{}.png", image_ms(0))), root.join("2/Image_2/first.png")).unwrap();
    let edit = |id: &str, change: &dyn Fn(&mut Vec<u8>)| {
        let path = root.join(format!("{id}/Data_{id}.hdf5"));
        let mut bytes = std::fs::read(&path).unwrap();
        change(&mut bytes);
        write(&path, bytes);
    };
    // A channel with another name is missing.
    edit("3", &|bytes| {
        let at = bytes.windows(9).position(|window| window == b"data_100\0").unwrap();
        bytes[at..at + 8].copy_from_slice(b"data_X00");
    });
    // Two samples of the left glove have one stamp.
    edit("4", &|bytes| {
        let stamps = crate::writers::raw_glove::stamps(10.0, 3.7, None);
        let at = bytes.windows(8).position(|window| window == stamps[5].to_le_bytes()).unwrap();
        bytes[at..at + 8].copy_from_slice(&stamps[4].to_le_bytes());
    });
    let output = import("egotac-sc-raw", &root, &out, &[]);
    assert_eq!(output.status.code(), Some(3));
    let text = String::from_utf8_lossy(&[output.stdout, output.stderr].concat()).into_owned();
    for expected in [
        "Image_1: expected one image per frame, named by its time stamp in milliseconds (the ZED SDK",
        "first.png: expected an image named by its time stamp in milliseconds",
        "Data_3.hdf5: state/LeftPort/data_100: expected this array, got none",
        "state/LeftPort: 1 samples whose stamps do not grow are left out",
    ] {
        assert!(text.contains(expected), "{expected} is not in: {text}");
    }
    assert_eq!(open(&out.join("4.zarr")).len(), FRAMES);
}
