//! NaN and infinity at the public functions of the core: an error that names the field, or "unknown", never a number.

use egotac::error::Result;
use egotac::geometry::{ForceSpreader, LinkContact, SIGMA, SampledSurface, resample};
use egotac::hand::{HandModel, HandParams, N_VERTICES, Side, Topology};
use egotac::image::Preparation;
use egotac::message::{HandPose, Header, Message, TactileFrame};
use egotac::model::Metadata;
use egotac::score::metrics::{self, EvalOptions};
use egotac::tactile::{N_FIELD, TactileField, TactileSequence};
use glam::{DVec3, Vec3};

use super::{Family, HardCase, Outcome, accepted};

const fn case(name: &'static str, recipe: &'static str, run: fn() -> Result<Outcome>) -> HardCase {
    HardCase { family: Family::Entrance, name, recipe, remedy: "finite numbers", run }
}

pub(super) const CASES: &[HardCase] = &[
    case("field_from_forces", "`TactileField::from_force` with NaN, infinity, -1 N", field),
    case("message_to_field", "a `TactileFrame` message with infinite or negative force, contact above 1", message),
    case("message_to_pose", "a `HandPose` message with NaN, infinity, a zero or unnormalised quaternion", pose),
    case("contacts_to_label", "`ForceSpreader` with NaN or infinity in vertices, contacts or sigma", spread),
    case("surface_to_label", "`resample` and `SampledSurface` with NaN or infinity in vertices or spacing", surface),
    case(
        "image_statistics",
        "`Preparation::apply` with a mean of NaN, or a deviation of 0, NaN or infinity",
        statistics,
    ),
    case("scores", "`metrics::evaluate` with infinite forces: an undefined score, never NaN", scores),
    case(
        "network_metadata",
        "network `Metadata` with NaN or infinity as force scale, interval or image mean",
        metadata,
    ),
    #[cfg(feature = "sim")]
    case("physics_options", "`PhysicsOptions` with NaN or infinity in any number", physics),
    #[cfg(feature = "sim")]
    case("scene_file", "a scene file with .nan or .inf in any number", scene),
    #[cfg(feature = "sim")]
    case("mesh_file", "a mesh file with nan, inf or a number beyond any float in a vertex", mesh),
];

/// Values that no function may take for numbers.
const BAD: [f32; 2] = [f32::NAN, f32::INFINITY];

/// Returns the outcome of calls with non-finite values, which must all fail, and of one without, which must not.
fn outcome<T, U>(bad: impl IntoIterator<Item = Result<T>>, good: Result<U>) -> Result<Outcome> {
    Ok(Outcome::of_refusals("non-finite values accepted", accepted(bad), good))
}

fn field() -> Result<Outcome> {
    let with = |value: f32| {
        let mut force = vec![0.0; N_FIELD];
        force[9] = value;
        TactileField::from_force(Topology::EgotacHand1, force)
    };
    outcome(BAD.into_iter().chain([f32::NEG_INFINITY, -1.0]).map(with), with(1.0))
}

fn message() -> Result<Outcome> {
    let with = |force: f32, contact: f32| {
        let mut frame = TactileFrame::from_field(Header::default(), &TactileField::zeros(Topology::EgotacHand1))?;
        (frame.hands[1].force[5], frame.hands[1].contact[5]) = (force, contact);
        // Through bytes, as a node receives it.
        TactileFrame::from_cdr(&frame.to_cdr())?.to_field()
    };
    let bad = [(f32::INFINITY, 0.0), (-1.0, 0.0), (0.0, f32::INFINITY), (0.0, 1.5), (0.0, -0.1)];
    // In a message, NaN means unknown.
    outcome(bad.map(|(force, contact)| with(force, contact)), with(f32::NAN, f32::NAN))
}

fn pose() -> Result<Outcome> {
    let model = HandModel::builtin(Side::Right);
    let message = HandPose::from_params(Header::default(), &model, &HandParams::default());
    let with = |change: &dyn Fn(&mut HandPose)| {
        let mut message = message.clone();
        change(&mut message);
        HandPose::from_cdr(&message.to_cdr())?.to_params(&model)
    };
    let mut bad = Vec::new();
    for value in BAD {
        bad.push(with(&|m| m.wrist.position.y = value.into()));
        bad.push(with(&|m| m.wrist.orientation.x = value.into()));
        bad.push(with(&|m| m.hand_pose[44] = value));
        bad.push(with(&|m| m.betas[0] = value));
    }
    bad.push(with(&|m| m.wrist.orientation.w = 0.0));
    bad.push(with(&|m| m.wrist.orientation.w = 2.0));
    outcome(bad, with(&|_| ()))
}

fn spread() -> Result<Outcome> {
    let model = HandModel::builtin(Side::Left);
    let rest = model.forward(&HandParams::default()).vertices;
    let spreader = ForceSpreader::new(&model, SIGMA)?;
    let good = LinkContact { link: 1, position: DVec3::ZERO, normal: DVec3::X, force: 1.0 };
    let mut bad = Vec::new();
    for value in BAD.map(f64::from) {
        bad.push(spreader.spread(&rest, &[LinkContact { force: value, ..good }]));
        bad.push(spreader.spread(&rest, &[LinkContact { position: DVec3::splat(value), ..good }]));
        bad.push(spreader.spread(&rest, &[LinkContact { normal: DVec3::splat(value), ..good }]));
        bad.push(spreader.spread(&[Vec3::splat(value as f32); N_VERTICES], &[good]));
        bad.push(ForceSpreader::new(&model, value).and_then(|spreader| spreader.spread(&rest, &[good])));
    }
    outcome(bad, spreader.spread(&rest, &[good]))
}

fn surface() -> Result<Outcome> {
    let triangle = |x: f32| [Vec3::ZERO, Vec3::X * x, Vec3::Y];
    let mut bad = Vec::new();
    for value in BAD {
        bad.push(resample(&triangle(value), &[[0, 1, 2]], 0.1));
        bad.push(resample(&triangle(1.0), &[[0, 1, 2]], value));
        bad.push(SampledSurface::from_points(vec![Vec3::splat(value)], 0.1).map(|s| s.points().to_vec()));
    }
    outcome(bad, resample(&triangle(1.0), &[[0, 1, 2]], 0.1))
}

fn statistics() -> Result<Outcome> {
    let image = ::image::RgbImage::new(8, 8);
    let with = |mean: f32, std: f32| {
        Preparation {
            side: 8,
            resize: Default::default(),
            filter: Default::default(),
            mean: [mean; 3],
            std: [0.2, 0.2, std],
        }
        .apply(&image)
    };
    let bad =
        [with(f32::NAN, 0.2), with(f32::INFINITY, 0.2), with(0.5, 0.0), with(0.5, f32::NAN), with(0.5, f32::INFINITY)];
    outcome(bad, with(0.5, 0.2))
}

fn scores() -> Result<Outcome> {
    let truth = TactileSequence::from_force(None, (0..4 * N_FIELD).map(|i| (i % 7) as f32 * 0.1).collect());
    let undefined = |value: f32| -> Result<()> {
        let mut pred = truth.clone();
        pred.force[77] = value;
        let report = metrics::evaluate(&pred, &truth, &EvalOptions::default())?;
        let scores = [report.mae, report.active_mae, report.temporal_pearson, report.force_cosine];
        // The right answer is a missing score: a user would take any number for a real one.
        match scores.into_iter().flatten().find(|score| !score.is_finite()) {
            Some(score) => Err(egotac::Error::value("score", "a number or none", score)),
            None if report.mae.is_none() => Err(egotac::Error::value("mae", "known forces", "undefined")),
            None => Ok(()),
        }
    };
    let good = metrics::evaluate(&truth, &truth, &EvalOptions::default());
    outcome([undefined(f32::NAN), undefined(f32::INFINITY), undefined(f32::NEG_INFINITY)], good)
}

fn metadata() -> Result<Outcome> {
    let with = |change: &dyn Fn(&mut Metadata)| {
        let mut metadata = Metadata::new("spoilt", 1.0, 0.1);
        change(&mut metadata);
        metadata.check()
    };
    let mut bad = Vec::new();
    for value in BAD {
        bad.push(with(&|m| m.force_scale = value));
        bad.push(with(&|m| m.frame_dt = value.into()));
        bad.push(with(&|m| m.mean[1] = value));
        bad.push(with(&|m| m.std[2] = value));
    }
    outcome(bad, with(&|_| ()))
}

#[cfg(feature = "sim")]
fn physics() -> Result<Outcome> {
    use egotac::mujoco::PhysicsOptions;
    use egotac::mujoco::options::Unchecked;
    let mut bad = Vec::new();
    for value in BAD.map(f64::from) {
        let default = Unchecked::default;
        bad.push(PhysicsOptions::try_from(Unchecked { timestep: value, ..default() }));
        bad.push(PhysicsOptions::try_from(Unchecked { impratio: value, ..default() }));
        bad.push(PhysicsOptions::try_from(Unchecked { tolerance: value, ..default() }));
        bad.push(PhysicsOptions::try_from(Unchecked { gravity: [0.0, value, 0.0], ..default() }));
    }
    outcome(bad, PhysicsOptions::try_from(Unchecked::default()))
}

/// Replaces every number of a shipped scene in turn.
#[cfg(feature = "sim")]
fn scene() -> Result<Outcome> {
    use egotac::sim::{SHIPPED, Scene};
    let text = SHIPPED[0].1;
    let parse = |text: &str| Scene::parse("spoilt", std::path::Path::new("spoilt.yaml"), text);
    let number = |word: &str| word.parse::<f64>().is_ok();
    let mut bad = Vec::new();
    let mut at = 0;
    while at < text.len() {
        let end =
            text[at..].find(|c: char| !(c.is_ascii_digit() || c == '.' || c == '-')).map_or(text.len(), |n| at + n);
        let before = text[..at].chars().next_back().unwrap_or(' ');
        if end > at && number(&text[at..end]) && !before.is_alphanumeric() && before != '_' {
            bad.extend([".nan", ".inf"].map(|word| parse(&format!("{}{word}{}", &text[..at], &text[end..]))));
        }
        at = end.max(at + 1);
    }
    if bad.len() < 50 {
        return Err(egotac::Error::value("numbers in the scene", "dozens", bad.len()));
    }
    outcome(bad, parse(text))
}

/// Replaces a coordinate of a tetrahedron in a mesh file.
#[cfg(feature = "sim")]
fn mesh() -> Result<Outcome> {
    use egotac::error::Error;
    use egotac::sim::{SHIPPED, Scene};
    let folder = tempfile::tempdir().map_err(Error::io(std::env::temp_dir()))?;
    let file = folder.path().join("spoilt.obj");
    let shape = SHIPPED[0].1.lines().find(|line| line.trim_start().starts_with("shape:")).unwrap_or_default();
    let text = SHIPPED[0].1.replacen(shape, "    shape: { mesh: { file: spoilt.obj, scale: 0.05 } }", 1);
    let scene = Scene::parse("spoilt", &folder.path().join("spoilt.yaml"), &text)?;
    let with = |word: &str| {
        let corners = format!("v {word} 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n");
        std::fs::write(&file, corners + "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n").map_err(Error::io(&file))?;
        egotac::sim::mesh_faults(&scene)
    };
    let bad: Vec<_> = ["nan", "-inf", "1e999"].map(with).into();
    outcome(bad, with("0"))
}
