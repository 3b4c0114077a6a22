//! Comparison of an imported store with the take that its data set was written from.

use std::path::Path;

use egotac::dataset::zarr::{
    CAMERA_POSE, LEFT_HAND_POSE, MANO_CONTACT_VALID, MANO_FORCE_VALID, OBJECT_POSE, RIGHT_HAND_POSE, ZarrReader,
};
use egotac::hand::{HandModel, HandParams, N_VERTICES, Side};
use glam::{DAffine3, DQuat, DVec3};

use crate::writers::take::Take;

/// Opens an imported store.
pub fn open(store: &Path) -> ZarrReader {
    ZarrReader::open(store).unwrap_or_else(|error| panic!("{error}"))
}

/// Returns the F1 score of the store's contact against the simulator's, over the vertices of these hands.
pub fn f1(store: &ZarrReader, take: &Take, sides: &[Side]) -> f64 {
    let contact = store.read_contact(0..store.len()).unwrap();
    let (mut hits, mut wrong) = (0.0, 0.0);
    for (index, frame) in take.frames.iter().enumerate() {
        for side in sides {
            let got = &contact[index * 2 * N_VERTICES..][side.range()];
            for (got, want) in got.iter().zip(frame.touched(take, *side)) {
                match (*got == 1.0, want) {
                    (true, true) => hits += 1.0,
                    (false, false) => {}
                    _ => wrong += 1.0,
                }
            }
        }
    }
    assert!(hits > 100.0, "the take must touch: {hits} vertices");
    2.0 * hits / (2.0 * hits + wrong)
}

/// Checks stamps, s: equal to the last bit.
pub fn check_stamps(store: &ZarrReader, expected: impl Iterator<Item = f64>) {
    let got = store.read("data/timestamps", 0..store.len()).unwrap().into_f64();
    assert_eq!(got, expected.collect::<Vec<_>>());
}

/// Checks that the images are those of the take, byte for byte.
pub fn check_images(store: &ZarrReader, take: &Take) {
    for (index, frame) in take.frames.iter().enumerate() {
        assert!(store.image(index).unwrap() == frame.image, "image {index}");
    }
}

/// Checks that the stored hands have the take's vertices, moved by `to_from`; `most` is the largest distance, m.
pub fn check_hands(
    store: &ZarrReader,
    take: &Take,
    models: &[HandModel; 2],
    to_from: impl Fn(usize) -> DAffine3,
    most: f64,
) {
    for (side, name) in Side::BOTH.into_iter().zip([LEFT_HAND_POSE, RIGHT_HAND_POSE]) {
        let values = store.read_f32(name, 0..store.len()).unwrap();
        for (index, frame) in take.frames.iter().enumerate() {
            let params: &[f32; 61] = values[61 * index..][..61].try_into().unwrap();
            let got = models[side as usize].forward(&HandParams::from_array(params)).vertices;
            for (got, want) in got.iter().zip(&frame.hand(side).vertices) {
                let distance = got.as_dvec3().distance(to_from(index).transform_point3(want.as_dvec3()));
                assert!(distance <= most, "{} hand, frame {index}: {distance} m", side.name());
            }
        }
    }
}

/// Checks the stored poses of the camera or of object 0.
pub fn check_poses(store: &ZarrReader, name: &str, expected: impl Fn(usize) -> DAffine3) {
    let width = if name == CAMERA_POSE { 7 } else { store.read_f32(OBJECT_POSE, 0..1).unwrap().len() };
    let values = store.read_f32(name, 0..store.len()).unwrap();
    for (index, row) in values.chunks_exact(width).enumerate() {
        let row: Vec<f64> = row.iter().map(|value| f64::from(*value)).collect();
        let rotation = DQuat::from_xyzw(row[4], row[5], row[6], row[3]);
        let got = DAffine3::from_rotation_translation(rotation, DVec3::from_slice(&row));
        assert!(got.abs_diff_eq(expected(index), 1e-5), "{name}, frame {index}: {got} for {}", expected(index));
    }
}

/// Returns the number of supervised entries: force and contact.
pub fn supervised(store: &ZarrReader) -> [usize; 2] {
    [MANO_FORCE_VALID, MANO_CONTACT_VALID].map(|name| {
        let mask = store.read_u8(name, 0..store.len()).unwrap();
        mask.into_iter().filter(|mask| *mask == 1).count()
    })
}
