//! EgoPressure: a data set with measured force.

use std::path::Path;
use std::sync::Arc;

use arrow_array::builder::{
    BinaryBuilder, BooleanBuilder, Float32Builder, Int64Builder, ListBuilder, StringBuilder, StructBuilder,
};
use arrow_array::{ArrayRef, RecordBatch};
use arrow_schema::{DataType, Field};
use egotac::hand::Side;
use glam::{DAffine3, DMat3, DVec3, Vec3};
use parquet::arrow::ArrowWriter;
use parquet::file::properties::WriterProperties;
use serde_json::json;

use super::files::{jpeg, write};
use super::take::{FRAMES, Take, TakeFrame, moved};

/// Frames are numbered from 1 on; the first one here.
pub const FIRST: i64 = 31;

/// Rows and columns of the touchpad, and its edges along y and x, m.
pub const CELLS: [usize; 2] = [105, 185];

pub const PAD: [f64; 2] = [0.1375, 0.240];

/// Returns `pad_from_world`: the face of the box that the right palm presses is the touchpad's plane, z points into the box.
pub fn pad_from_world(take: &Take, frame: &TakeFrame) -> DAffine3 {
    let hand = frame.hand(Side::Right);
    let box_from_world = frame.object.inverse();
    let palm = box_from_world.transform_point3(hand.wrist);
    let sign = palm.y.signum();
    let into = DVec3::NEG_Y * sign;
    let x = DVec3::X;
    let axes = DMat3::from_cols(x, into.cross(x), into);
    let box_from_pad = DAffine3::from_mat3_translation(axes, DVec3::new(0.0, sign * take.half.y, 0.0));
    box_from_pad.inverse() * box_from_world
}

/// Returns the counts of the cells: the force of each vertex lies on the cell below it, if one is.
pub fn counts(take: &Take, frame: &TakeFrame) -> (Vec<f32>, f64, DVec3) {
    let mut counts = vec![0.0f32; CELLS[0] * CELLS[1]];
    let (mut total, mut moment) = (0.0, DVec3::ZERO);
    let hand = frame.hand(Side::Right);
    for (vertex, force) in hand.vertices.iter().zip(&hand.forces) {
        let at = pad_from_world(take, frame).transform_point3(vertex.as_dvec3());
        let cell = |value: f64, edge: f64, n: usize| ((value / edge + 0.5) * n as f64).floor();
        let (column, row) = (cell(at.x, PAD[1], CELLS[1]), cell(at.y, PAD[0], CELLS[0]));
        if *force < 1e-4 || !(0.0..CELLS[1] as f64).contains(&column) || !(0.0..CELLS[0] as f64).contains(&row) {
            continue;
        }
        counts[row as usize * CELLS[1] + column as usize] += force * 1736.0;
        total += f64::from(*force);
        moment += at.with_z(0.0) * f64::from(*force);
    }
    (counts, total, moment / total)
}

/// Writes a Parquet file of a few rows per group, as small row groups are.
pub fn parquet(path: &Path, columns: Vec<(&str, ArrayRef)>) {
    let batch =
        RecordBatch::try_from_iter_with_nullable(columns.into_iter().map(|(name, column)| (name, column, true)))
            .unwrap();
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    let properties = WriterProperties::builder().set_max_row_group_row_count(Some(4)).build();
    let mut writer =
        ArrowWriter::try_new(std::fs::File::create(path).unwrap(), batch.schema(), Some(properties)).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
}

/// Returns a column of lists; `None` = missing.
pub fn lists(rows: impl IntoIterator<Item = Option<Vec<f32>>>) -> ArrayRef {
    let mut builder = ListBuilder::new(Float32Builder::new());
    for row in rows {
        match row {
            Some(values) => builder.append_value(values.into_iter().map(Some)),
            None => builder.append_null(),
        }
    }
    Arc::new(builder.finish())
}

pub fn frames(numbers: impl Iterator<Item = i64>) -> ArrayRef {
    let mut builder = Int64Builder::new();
    numbers.for_each(|number| builder.append_value(number));
    Arc::new(builder.finish())
}

/// Writes EgoPressure: the right hand above a touchpad; the last frame is not annotated.
pub fn write_egopressure(root: &Path, take: &Take) {
    let name = "p_001/p_001_press_palm_high_x5_right";
    let folder = root.join("data").join(name);
    let config = json!({
        "camera_calibrations": { "0": { "fx": 1120.5, "fy": 1121.5, "cx": 960.0, "cy": 540.0, "k1": 0.1 } },
        "participant": { "id": "p_001" },
    });
    write(&root.join(format!("configs/{name}.json")), config.to_string());
    let numbers = || frames((0..FRAMES as i64).map(|index| FIRST + index));
    let fields = vec![Field::new("bytes", DataType::Binary, true), Field::new("path", DataType::Utf8, true)];
    let mut images = StructBuilder::from_fields(fields, FRAMES);
    for frame in &take.frames {
        images.field_builder::<BinaryBuilder>(0).unwrap().append_value(jpeg(&frame.image));
        images.field_builder::<StringBuilder>(1).unwrap().append_value("frame.jpg");
        images.append(true);
    }
    parquet(&folder.join("cam-d.color.parquet"), vec![("frame", numbers()), ("image", Arc::new(images.finish()))]);
    parquet(
        &folder.join("pressure.parquet"),
        vec![("frame", numbers()), ("force", lists(take.frames.iter().map(|frame| Some(counts(take, frame).0))))],
    );
    let annotated = |index: usize| index + 1 < FRAMES;
    let of_frames = |values: &dyn Fn(&TakeFrame) -> Vec<f32>| {
        lists(take.frames.iter().enumerate().map(|(index, frame)| annotated(index).then(|| values(frame))))
    };
    let posed = |frame: &TakeFrame| moved(frame.hand(Side::Right), pad_from_world(take, frame));
    let vertices = |frame: &TakeFrame| {
        let to_pad = pad_from_world(take, frame);
        let moved =
            frame.hand(Side::Right).vertices.iter().map(|vertex| to_pad.transform_point3(vertex.as_dvec3()).as_vec3());
        moved.flat_map(|vertex| vertex.to_array()).collect()
    };
    let pose = |frame: &TakeFrame| {
        let params = posed(frame);
        std::iter::once(params.global_orient).chain(params.hand_pose).flat_map(|joint: Vec3| joint.to_array()).collect()
    };
    let camera = |frame: &TakeFrame| (pad_from_world(take, frame) * frame.camera).inverse();
    let (mut has, mut side) = (BooleanBuilder::new(), StringBuilder::new());
    (0..FRAMES).for_each(|index| {
        has.append_value(annotated(index));
        side.append_value("right");
    });
    parquet(
        &folder.join("annotation.parquet"),
        vec![
            ("frame", numbers()),
            ("has_annotation", Arc::new(has.finish())),
            ("hand_side", Arc::new(side.finish())),
            ("vertices", of_frames(&vertices)),
            ("betas", of_frames(&|frame| posed(frame).betas.to_vec())),
            ("full_pose", of_frames(&pose)),
            ("transl", of_frames(&|frame| posed(frame).transl.to_array().to_vec())),
            (
                "ego_R",
                lists(
                    take.frames
                        .iter()
                        .map(|frame| Some(camera(frame).matrix3.transpose().as_mat3().to_cols_array().to_vec())),
                ),
            ),
            (
                "ego_T",
                lists(take.frames.iter().map(|frame| Some(camera(frame).translation.as_vec3().to_array().to_vec()))),
            ),
        ],
    );
}
