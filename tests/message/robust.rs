//! Reading any bytes gives a message or an error that names the field.

use egotac::hand::{HandModel, HandParams, N_VERTICES, Side};
use egotac::message::*;
use egotac::{TactileField, Topology, Validity};
use glam::{Quat, Vec3};
use proptest::prelude::*;

fn time() -> impl Strategy<Value = Time> {
    (any::<i32>(), 0..1_000_000_000u32).prop_map(|(sec, nanosec)| Time { sec, nanosec })
}

fn header() -> impl Strategy<Value = Header> {
    (time(), "[^\0]{0,12}").prop_map(|(stamp, frame_id)| Header { stamp, frame_id })
}

fn hand(side: u8) -> impl Strategy<Value = HandTactile> {
    (0.0..1f32, prop::collection::vec((0.0..50f32, 0.0..=1f32), N_VERTICES)).prop_map(move |(score, values)| {
        let force: [f32; N_VERTICES] = std::array::from_fn(|i| values[i].0);
        let total_force = force.iter().sum();
        HandTactile { side, score, force, contact: std::array::from_fn(|i| values[i].1), total_force }
    })
}

fn frame() -> impl Strategy<Value = TactileFrame> {
    let hands = prop_oneof![
        Just(vec![]).boxed(),
        hand(1).prop_map(|right| vec![right]).boxed(),
        (hand(0), hand(1)).prop_map(|(left, right)| vec![left, right]).boxed(),
    ];
    (header(), hands, any::<u64>(), 0.0..10f64, "[^\0]{0,40}", any::<bool>(), 0.0..1f32, "[^\0]{0,40}").prop_map(
        |(header, hands, sequence, inference_secs, model_id, warming_up, familiarity, reason)| TactileFrame {
            header,
            hands,
            sequence,
            inference_secs,
            model_id,
            topology: "egotac-hand-1".into(),
            warming_up,
            familiarity,
            reason,
        },
    )
}

fn image() -> impl Strategy<Value = Image> {
    (header(), any::<[u32; 3]>(), "[a-z0-9]{0,9}", any::<u8>(), prop::collection::vec(any::<u8>(), 0..300)).prop_map(
        |(header, [height, width, step], encoding, is_bigendian, data)| Image {
            header,
            height,
            width,
            encoding,
            is_bigendian,
            step,
            data,
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn written_messages_read_back(frame in frame(), image in image()) {
        prop_assert_eq!(TactileFrame::from_cdr(&frame.to_cdr()).unwrap(), frame);
        prop_assert_eq!(Image::from_cdr(&image.to_cdr()).unwrap(), image);
    }

    #[test]
    fn a_truncated_payload_is_refused_with_the_field(frame in frame(), share in 0.0..1f64) {
        let payload = frame.to_cdr();
        let cut = (payload.len() as f64 * share) as usize;
        let error = TactileFrame::from_cdr(&payload[..cut]).unwrap_err().to_string();
        prop_assert!(error.starts_with("egotac_msgs/msg/TactileFrame"), "{}", error);
    }

    #[test]
    fn garbage_never_panics(mut bytes in prop::collection::vec(any::<u8>(), 0..4000)) {
        let read_all = |bytes: &[u8]| {
            let _ = TactileFrame::from_cdr(bytes);
            let _ = TactileTruth::from_cdr(bytes);
            let _ = HandModelInfo::from_cdr(bytes);
            let _ = HandPose::from_cdr(bytes);
            let _ = HandPoses::from_cdr(bytes).and_then(HandPoses::into_poses);
            let _ = TactileRegions::from_cdr(bytes);
            let _ = MarkerArray::from_cdr(bytes);
            let _ = TFMessage::from_cdr(bytes);
            let _ = TactileMetrics::from_cdr(bytes);
            let _ = RobotTouch::from_cdr(bytes);
            let _ = PoseArray::from_cdr(bytes);
            let _ = PoseStamped::from_cdr(bytes);
            let _ = JointState::from_cdr(bytes);
            let _ = JointTrajectory::from_cdr(bytes);
            let _ = Bool::from_cdr(bytes);
            let _ = Float64MultiArray::from_cdr(bytes);
            let _ = Image::from_cdr(bytes);
            let _ = CompressedImage::from_cdr(bytes);
            let _ = CameraInfo::from_cdr(bytes);
            let _ = PointCloud2::from_cdr(bytes);
            let _ = DiagnosticArray::from_cdr(bytes);
        };
        read_all(&bytes);
        if let Some(header) = bytes.first_chunk_mut::<4>() {
            *header = [0, 1, 0, 0];
            read_all(&bytes);
        }
    }

    #[test]
    fn a_flipped_byte_never_panics(frame in frame(), at in any::<prop::sample::Index>(), value in any::<u8>()) {
        let mut payload = frame.to_cdr();
        let at = at.index(payload.len());
        payload[at] = value;
        if let Ok(frame) = TactileFrame::from_cdr(&payload) {
            let _ = frame.to_field();
        }
    }

    #[test]
    fn a_field_reads_back_from_its_message(force in prop::collection::vec(0.0..20f32, 2 * N_VERTICES)) {
        let field = TactileField::from_force(Topology::EgotacHand1, force).unwrap();
        let frame = TactileFrame::from_field(Header::default(), &field).unwrap();
        prop_assert_eq!((frame.hands[0].side, frame.hands[1].side), (HandTactile::LEFT, HandTactile::RIGHT));
        prop_assert_eq!(frame.hands[1].force[0], field.force[N_VERTICES]);
        let back = TactileFrame::from_cdr(&frame.to_cdr()).unwrap().to_field().unwrap();
        prop_assert_eq!(back, field);
    }
}

fn two_hands() -> TactileFrame {
    TactileFrame::from_field(Header::default(), &TactileField::zeros(Topology::Mano)).unwrap()
}

#[test]
fn an_error_names_field_and_item() {
    let mut frame = two_hands();
    frame.header.frame_id = "cam".into();
    let payload = frame.to_cdr();
    // The first hand starts after 4 bytes of encapsulation, 8 of stamp, 4 + 4 of frame_id and 4 of count.
    let cut = TactileFrame::from_cdr(&payload[..24 + 6244]).unwrap_err().to_string();
    assert!(cut.starts_with("egotac_msgs/msg/TactileFrame.hands[1]."), "{cut}");
}

#[test]
fn a_third_hand_is_refused() {
    let mut frame = two_hands();
    frame.hands.push(frame.hands[0].clone());
    let error = TactileFrame::from_cdr(&frame.to_cdr()).unwrap_err().to_string();
    assert_eq!(error, "egotac_msgs/msg/TactileFrame.hands: expected at most 2 items, got 3");
}

#[test]
fn a_corrupt_length_is_refused_before_allocation() {
    let image = Image::from_rgb(Header::default(), &image::RgbImage::new(2, 2));
    let mut payload = image.to_cdr();
    let at = payload.len() - 12 - 4;
    payload[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
    let error = Image::from_cdr(&payload).unwrap_err().to_string();
    assert!(error.starts_with("sensor_msgs/msg/Image.data: expected 4294967295 items"), "{error}");
}

#[test]
fn bytes_after_the_message_beyond_padding_are_refused() {
    let mut payload = Clock { clock: Time::default() }.to_cdr();
    payload.extend([0; 3]);
    assert!(Clock::from_cdr(&payload).is_ok());
    payload.push(0);
    assert!(Clock::from_cdr(&payload).unwrap_err().to_string().contains("padding"));
}

#[test]
fn another_encapsulation_is_refused() {
    let mut payload = Clock { clock: Time::default() }.to_cdr();
    payload[1] = 0;
    let error = Clock::from_cdr(&payload).unwrap_err().to_string();
    assert!(error.contains("little endian"), "{error}");
}

#[test]
fn invalid_force_and_contact_are_refused() {
    let refused = |change: &dyn Fn(&mut TactileFrame), expected: &str| {
        let mut frame = two_hands();
        change(&mut frame);
        let error = frame.to_field().unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
    };
    refused(&|frame| frame.topology = "smplx".into(), "topology \"smplx\" is unknown");
    refused(&|frame| frame.hands[1].side = 0, "hands[1].side: expected each hand once");
    refused(&|frame| frame.hands[0].side = 2, "hands[0].side: expected 0 (left) or 1 (right), got 2");
    refused(&|frame| frame.hands[1].force[9] = -0.1, "hands[1].force[9]: expected");
    refused(&|frame| frame.hands[0].contact[3] = 1.5, "hands[0].contact[3]: expected");
}

#[test]
fn a_missing_hand_is_zero_and_an_unknown_force_stays_unknown() {
    let mut frame = two_hands();
    frame.hands.remove(0);
    frame.hands[0].force = [f32::NAN; N_VERTICES];
    let field = frame.to_field().unwrap();
    assert_eq!(field.total_force(Side::Left), 0.0);
    assert!(field.force[Side::Right.range()].iter().all(|f| f.is_nan()));
}

#[test]
fn every_validity_reads_back_from_its_message() {
    for validity in Validity::ALL {
        let truth = TactileTruth::new(two_hands(), validity);
        let back = TactileTruth::from_cdr(&truth.to_cdr()).unwrap();
        assert_eq!(back.validity().unwrap(), validity);
        assert_eq!(back.reason, validity.reason());
    }
}

#[test]
fn a_pose_reads_back_from_its_message() {
    let model = HandModel::builtin(Side::Left);
    let mut params = HandParams {
        global_orient: Vec3::new(0.3, -1.2, 0.7),
        transl: Vec3::new(0.1, 0.2, -0.4),
        ..HandParams::default()
    };
    params.betas[0] = 1.5;
    params.hand_pose[14] = Vec3::new(0.0, 0.4, 0.1);
    let pose = HandPose::from_params(Header::default(), &model, &params);

    // The message's wrist is the wrist joint of the model's forward pass.
    let posed = model.forward(&params);
    let Point { x, y, z } = pose.wrist.position;
    assert!((Vec3::new(x as f32, y as f32, z as f32) - posed.joints[0]).length() < 1e-6);
    let Quaternion { x, y, z, w } = pose.wrist.orientation;
    let turned = Quat::from_xyzw(x as f32, y as f32, z as f32, w as f32) * Vec3::X;
    assert!((turned - posed.rotations[0] * Vec3::X).length() < 1e-5);

    let back = HandPose::from_cdr(&pose.to_cdr()).unwrap().to_params(&model).unwrap();
    assert!((back.transl - params.transl).length() < 1e-6);
    assert!((back.global_orient - params.global_orient).length() < 1e-5);
    assert_eq!((back.hand_pose, back.betas), (params.hand_pose, params.betas));

    let other = HandModel::builtin(Side::Right);
    assert!(pose.to_params(&other).unwrap_err().to_string().starts_with("side: expected 1 (right), got 0"));
}
