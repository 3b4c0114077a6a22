//! Activations between two layers, in the form in which the next one reads them.

use crate::aligned::{Aligned, grow};
use crate::amx::STEP;
use crate::quantise::{halve_row, quantise_row};
use crate::rows::Rows;
use crate::team;

/// Rows that one task converts: enough work to be worth handing over, few enough that 257 tokens make several tasks.
const ROWS_PER_TASK: usize = 32;
/// Unused values at the end of each row of f32. Rows whose distance is a multiple of a memory page would all map to the same
/// few sets of the cache.
const PADDING: usize = 16;

/// Form in which a layer reads its input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Form {
    /// f32.
    #[default]
    Floats,
    /// bf16.
    Halves,
    /// Unsigned bytes, with a scale and a zero point per row: value = scale x (byte - zero point).
    Bytes,
}

/// Rows of activations in one [`Form`]. Buffers grow to the largest input so far and are kept.
///
/// Zero is exact in bytes, and the rounding is the same on every processor.
#[derive(Debug, Clone, Default)]
pub struct Activations {
    form: Form,
    width: usize,
    stride: usize,
    count: usize,
    floats: Aligned<f32>,
    halves: Aligned<u16>,
    bytes: Aligned<u8>,
    /// Scale and zero point of each row of bytes.
    scales: Vec<(f32, i32)>,
}

/// Rows as a product reads them.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Input<'a> {
    /// f32.
    Floats(Rows<'a>),
    /// bf16: values, and values from row to row.
    Halves(&'a [u16], usize),
    /// Bytes: values, values from row to row, scale and zero point of each row.
    Bytes(&'a [u8], usize, &'a [(f32, i32)]),
}

/// First value of a result whose tasks write disjoint parts.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Target {
    /// f32.
    Floats(*mut f32),
    /// bf16.
    Halves(*mut u16),
}

impl Target {
    /// Place of a value; to be used inside of the slice that the pointer was taken from.
    pub fn at(self, index: usize) -> Self {
        match self {
            Self::Floats(start) => Self::Floats(start.wrapping_add(index)),
            Self::Halves(start) => Self::Halves(start.wrapping_add(index)),
        }
    }
}

// SAFETY: the pointer itself is never changed. Its users, `Packed` and `Attention`, give every task its own part of the result,
// so threads never share a value, and keep the result borrowed until all tasks are done.
unsafe impl Sync for Target {}

/// Origin of rows.
enum RowSource<'a, W> {
    Rows(Rows<'a>),
    /// `write(row, values)` computes a row.
    Computed(W),
}

impl<W: Fn(usize, &mut [f32])> RowSource<'_, W> {
    /// Returns a row of `width` values, which is computed in `room`.
    fn row<'b>(&'b self, row: usize, width: usize, room: &'b mut Vec<f32>) -> &'b [f32] {
        match self {
            Self::Rows(rows) => &rows.data[row * rows.stride..][..width],
            Self::Computed(write) => {
                room.resize(width, 0.0);
                write(row, room);
                room
            }
        }
    }
}

impl Activations {
    /// Converts rows of `width` values.
    pub fn set(&mut self, x: Rows, width: usize, form: Form) {
        self.resize(form, x.count, width);
        self.convert(&RowSource::<fn(usize, &mut [f32])>::Rows(x));
    }

    /// Sets `count` rows of `width` values that `write(row, values)` computes.
    pub fn fill(&mut self, form: Form, count: usize, width: usize, write: impl Fn(usize, &mut [f32]) + Sync) {
        self.resize(form, count, width);
        if form == Form::Floats {
            let stride = self.stride;
            team::chunks(&mut self.floats[..count * stride], ROWS_PER_TASK * stride, |block, rows| {
                for (i, row) in rows.chunks_exact_mut(stride).enumerate() {
                    write(block * ROWS_PER_TASK + i, &mut row[..width]);
                }
            });
        } else {
            self.convert(&RowSource::Computed(write));
        }
    }

    /// Sets `count` rows of `width` values that `write(target, stride)` writes: in bf16 if they are wanted so and `halves` is true,
    /// otherwise in f32, which is converted.
    pub(crate) fn receive(
        &mut self,
        form: Form,
        count: usize,
        width: usize,
        halves: bool,
        write: impl FnOnce(Target, usize),
    ) {
        if form == Form::Halves && halves {
            self.resize(form, count, width);
            return write(Target::Halves(self.halves.as_mut_ptr()), self.stride);
        }
        self.resize(Form::Floats, count, width);
        write(Target::Floats(self.floats.as_mut_ptr()), self.stride);
        if form != Form::Floats {
            let (stride, floats) = (self.stride, std::mem::take(&mut self.floats));
            self.set(Rows { data: &floats, stride, count }, width, form);
            self.floats = floats;
        }
    }

    /// The rows.
    pub(crate) fn rows(&self) -> Input<'_> {
        let (stride, count) = (self.stride, self.count);
        match self.form {
            Form::Floats => Input::Floats(Rows { data: &self.floats[..count * stride], stride, count }),
            Form::Halves => Input::Halves(&self.halves[..count * stride], stride),
            Form::Bytes => Input::Bytes(&self.bytes[..count * stride], stride, &self.scales[..count]),
        }
    }

    /// Number of rows.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Values in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Makes room for rows, whose values are then undefined.
    fn resize(&mut self, form: Form, count: usize, width: usize) {
        let stride = match form {
            Form::Floats => width + PADDING,
            Form::Halves => width.next_multiple_of(STEP / size_of::<u16>()),
            Form::Bytes => width.next_multiple_of(STEP),
        };
        (self.form, self.count, self.width, self.stride) = (form, count, width, stride);
        match form {
            Form::Floats => grow(&mut self.floats, count * stride),
            Form::Halves => {
                grow(&mut self.halves, count * stride);
                // A product that writes rows leaves their padding alone.
                if stride > width {
                    self.halves[..count * stride].chunks_exact_mut(stride).for_each(|row| row[width..].fill(0));
                }
            }
            Form::Bytes => {
                grow(&mut self.bytes, count * stride);
                self.scales.resize(self.scales.len().max(count), (0.0, 0));
            }
        }
    }

    /// Converts all rows from f32 to the form that [`Self::resize`] chose.
    fn convert(&mut self, source: &RowSource<impl Fn(usize, &mut [f32]) + Sync>) {
        let (count, width, stride) = (self.count, self.width, self.stride);
        let size = ROWS_PER_TASK * stride;
        match self.form {
            Form::Floats => team::chunks(&mut self.floats[..count * stride], size, |block, rows| {
                let mut room = Vec::new();
                for (i, row) in rows.chunks_exact_mut(stride).enumerate() {
                    row[..width].copy_from_slice(source.row(block * ROWS_PER_TASK + i, width, &mut room));
                }
            }),
            Form::Halves => team::chunks(&mut self.halves[..count * stride], size, |block, rows| {
                let mut room = Vec::new();
                for (i, row) in rows.chunks_exact_mut(stride).enumerate() {
                    halve_row(source.row(block * ROWS_PER_TASK + i, width, &mut room), &mut row[..width]);
                }
            }),
            Form::Bytes => {
                let bytes = (&mut self.bytes[..count * stride], size);
                team::chunks2(bytes, (&mut self.scales[..count], ROWS_PER_TASK), |block, rows, scales| {
                    let mut room = Vec::new();
                    for (i, (row, scale)) in rows.chunks_exact_mut(stride).zip(scales).enumerate() {
                        let values = source.row(block * ROWS_PER_TASK + i, width, &mut room);
                        *scale = quantise_row(values, &mut row[..width]);
                        row[width..].fill(0);
                    }
                });
            }
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Rows in f32 as a form holds them.
    pub(crate) fn restored(activations: &Activations) -> Vec<Vec<f32>> {
        let width = activations.width();
        match activations.rows() {
            Input::Floats(rows) => rows.data.chunks_exact(rows.stride).map(|row| row[..width].to_vec()).collect(),
            Input::Halves(data, stride) => {
                let value = |half: &u16| f32::from_bits(u32::from(*half) << 16);
                data.chunks_exact(stride).map(|row| row[..width].iter().map(value).collect()).collect()
            }
            Input::Bytes(data, stride, scales) => data
                .chunks_exact(stride)
                .zip(scales)
                .map(|(row, (scale, zero))| {
                    row[..width].iter().map(|byte| scale * (i32::from(*byte) - zero) as f32).collect()
                })
                .collect(),
        }
    }

    #[test]
    fn all_ways_to_set_rows_give_the_same_and_pad_with_zeros() {
        let (count, width, stride) = if cfg!(miri) { (3, 5, 7) } else { (70, 37, 40) };
        let data: Vec<f32> = (0..count * stride).map(|i| (i * 7919 % 1013) as f32 / 500.0 - 1.0).collect();
        let x = Rows { data: &data, stride, count };
        let compute = |row: usize, out: &mut [f32]| out.copy_from_slice(&data[row * stride..][..width]);
        for form in [Form::Floats, Form::Halves, Form::Bytes] {
            let [mut set, mut filled, mut received] = std::array::from_fn(|_| Activations::default());
            // Larger rows before must leave nothing behind.
            let before = vec![9.0; count * 2 * stride];
            for activations in [&mut set, &mut filled, &mut received] {
                activations.set(Rows::new(&before, 2 * stride), 2 * stride, form);
            }
            set.set(x, width, form);
            filled.fill(form, count, width, compute);
            received.receive(form, count, width, false, |target, stride| {
                let Target::Floats(start) = target else { panic!("expected f32") };
                for row in 0..count {
                    // SAFETY: `receive` gives room for `count` rows of `width` values, `stride` apart, which nothing else uses.
                    compute(row, unsafe { std::slice::from_raw_parts_mut(start.add(row * stride), width) });
                }
            });
            let want = restored(&set);
            for (row, want) in want.iter().enumerate() {
                let step = if form == Form::Floats { 0.0 } else { 0.01 };
                let exact = &data[row * stride..][..width];
                assert!(want.iter().zip(exact).all(|(got, want)| (got - want).abs() <= step), "{form:?}");
            }
            assert_eq!(restored(&filled), want, "{form:?}");
            assert_eq!(restored(&received), want, "{form:?}");
            for activations in [&set, &filled, &received] {
                match activations.rows() {
                    Input::Floats(_) => {}
                    Input::Halves(data, stride) => {
                        assert!(data.chunks_exact(stride).all(|row| row[width..].iter().all(|half| *half == 0)));
                    }
                    Input::Bytes(data, stride, _) => {
                        assert!(data.chunks_exact(stride).all(|row| row[width..].iter().all(|byte| *byte == 0)));
                    }
                }
            }
        }
    }
}
