//! CDR as in ROS 2: XCDR1, little endian, after a four-byte encapsulation header.
//!
//! Primitives align to their own size, counted from the end of the header. A string is its length with the final NUL, then
//! its bytes. A sequence is its length, then its items. A fixed array is its items alone.

use std::fmt::Write as _;

use crate::error::{Error, Result};

/// Encapsulation: plain CDR, little endian, no options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

/// Largest padding after a payload, bytes: transports round payloads up to a multiple of four.
const MAX_PADDING: usize = 3;

/// Appends values to a CDR payload.
#[derive(Debug, Default)]
pub struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    /// Returns the payload of one value, with its header.
    pub fn payload(value: &impl Wire) -> Vec<u8> {
        let mut writer = Writer { bytes: HEADER.to_vec() };
        value.write(&mut writer);
        writer.bytes
    }

    fn put<const N: usize>(&mut self, value: [u8; N]) {
        let end = (self.bytes.len() - HEADER.len()).next_multiple_of(N) + HEADER.len();
        self.bytes.resize(end, 0);
        self.bytes.extend_from_slice(&value);
    }

    /// Appends a length, which has 32 bits on the wire. Our messages can't get longer than that within memory.
    fn put_length(&mut self, length: usize) {
        self.put(u32::try_from(length).unwrap_or(u32::MAX).to_le_bytes());
    }
}

/// Reads values from a CDR payload; errors name the present field.
#[derive(Debug)]
pub struct Reader<'a> {
    message: &'static str,
    path: Vec<Step>,
    bytes: &'a [u8],
    at: usize,
}

#[derive(Debug)]
enum Step {
    Field(&'static str),
    Index(usize),
}

impl<'a> Reader<'a> {
    /// Reads a payload that holds one `T` and nothing else.
    ///
    /// # Errors
    /// If the header is not that of XCDR1 little endian, the payload is too short or too long, or a field holds an invalid
    /// value. The error names the field, starting with `message`.
    pub fn payload<T: Wire>(message: &'static str, payload: &'a [u8]) -> Result<T> {
        Self::whole(message, payload, T::read)
    }

    /// Reads a payload that `read` takes to its end.
    ///
    /// # Errors
    /// As [`Self::payload`].
    pub fn whole<T>(message: &'static str, payload: &'a [u8], read: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        let mut reader = Self::begin(message, payload)?;
        let value = read(&mut reader)?;
        if reader.left() > MAX_PADDING {
            let got = format!("{} bytes after it", reader.left());
            return Err(Error::value(
                message,
                format!("at most {MAX_PADDING} bytes of padding after the last field"),
                got,
            ));
        }
        Ok(value)
    }

    /// Reads the `T` at the start of a payload, for instance the header of an image.
    ///
    /// # Errors
    /// As [`Self::payload`], but anything may follow.
    pub fn leading<T: Wire>(message: &'static str, payload: &'a [u8]) -> Result<T> {
        T::read(&mut Self::begin(message, payload)?)
    }

    fn begin(message: &'static str, payload: &'a [u8]) -> Result<Self> {
        let Some((header, bytes)) = payload.split_first_chunk::<4>() else {
            return Err(Error::value(message, "a CDR payload of at least 4 bytes", format!("{} bytes", payload.len())));
        };
        // The last two bytes are options that readers of plain CDR ignore.
        if header[..2] != HEADER[..2] {
            let got = format!("{:#04x} {:#04x}", header[0], header[1]);
            return Err(Error::value(message, "the encapsulation 0x00 0x01 (XCDR1, little endian)", got));
        }
        Ok(Reader { message, path: Vec::new(), bytes, at: 0 })
    }

    /// Reads the field `name`.
    ///
    /// # Errors
    /// If `T` can't be read; the error names the field.
    pub fn field<T: Wire>(&mut self, name: &'static str) -> Result<T> {
        self.path.push(Step::Field(name));
        let value = T::read(self)?;
        self.path.pop();
        Ok(value)
    }

    /// Reads the field `name`, a sequence of bytes, which stay where they are.
    ///
    /// # Errors
    /// If the payload is too short; the error names the field.
    pub fn bytes(&mut self, name: &'static str) -> Result<&'a [u8]> {
        self.path.push(Step::Field(name));
        let length = self.length(1)?;
        let bytes = self.take(length)?;
        self.path.pop();
        Ok(bytes)
    }

    /// Reads the field `name`, a sequence of at most `max` items.
    ///
    /// # Errors
    /// If `T` can't be read or the sequence is longer; the error names the field.
    pub fn bounded<T: Wire>(&mut self, name: &'static str, max: usize) -> Result<Vec<T>> {
        self.path.push(Step::Field(name));
        let length = self.length(T::MIN_BYTES)?;
        if length > max {
            return Err(self.error(format!("at most {max} items"), length));
        }
        let values = T::read_many(length, self)?;
        self.path.pop();
        Ok(values)
    }

    /// Creates an error that names the present field.
    pub fn error(&self, expected: impl ToString, got: impl ToString) -> Error {
        let mut name = self.message.to_owned();
        for step in &self.path {
            // Writing to a String cannot fail.
            let _ = match step {
                Step::Field(field) => write!(name, ".{field}"),
                Step::Index(index) => write!(name, "[{index}]"),
            };
        }
        Error::value(name, expected, got)
    }

    fn left(&self) -> usize {
        self.bytes.len() - self.at
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        if count > self.left() {
            return Err(self.error(format!("{count} bytes"), format!("{} before the end", self.left())));
        }
        let taken = &self.bytes[self.at..self.at + count];
        self.at += count;
        Ok(taken)
    }

    fn get<const N: usize>(&mut self) -> Result<[u8; N]> {
        let padding = self.at.next_multiple_of(N) - self.at;
        let taken = self.take(padding + N)?;
        let mut value = [0; N];
        value.copy_from_slice(&taken[padding..]);
        Ok(value)
    }

    /// Reads the length of a sequence. Checks that its items fit into the rest of the payload, so that a corrupt length
    /// causes no large allocation.
    fn length(&mut self, min_bytes: usize) -> Result<usize> {
        let length = u32::from_le_bytes(self.get()?) as usize;
        if length > self.left() / min_bytes {
            let got = format!("{} bytes before the end", self.left());
            return Err(self.error(format!("{length} items of at least {min_bytes} bytes"), got));
        }
        Ok(length)
    }
}

/// A type of message fields.
pub trait Wire: Sized {
    /// Smallest size of a value, at least 1, bytes.
    const MIN_BYTES: usize = 1;

    /// Returns the name of the type in `.msg` files.
    fn ros_type() -> String;

    /// Appends the value.
    fn write(&self, out: &mut Writer);

    /// Reads a value.
    ///
    /// # Errors
    /// If the payload is too short or holds an invalid value.
    fn read(input: &mut Reader) -> Result<Self>;

    /// Appends several values.
    fn write_all(values: &[Self], out: &mut Writer) {
        for value in values {
            value.write(out);
        }
    }

    /// Reads `count` values.
    ///
    /// # Errors
    /// As [`Self::read`], with the index of the value.
    fn read_many(count: usize, input: &mut Reader) -> Result<Vec<Self>> {
        let mut values = Vec::with_capacity(count);
        for index in 0..count {
            input.path.push(Step::Index(index));
            values.push(Self::read(input)?);
            input.path.pop();
        }
        Ok(values)
    }

    /// Adds the message types within this type, each once, to a schema's list of (name, definition).
    fn collect_definitions(_: &mut Vec<(&'static str, String)>) {}
}

macro_rules! number {
    ($($type:ty = $ros:literal),*) => {$(
        impl Wire for $type {
            const MIN_BYTES: usize = size_of::<$type>();
            fn ros_type() -> String {
                $ros.into()
            }
            fn write(&self, out: &mut Writer) {
                out.put(self.to_le_bytes());
            }
            fn read(input: &mut Reader) -> Result<Self> {
                Ok(Self::from_le_bytes(input.get()?))
            }
        }
    )*};
}
number!(
    i8 = "int8",
    i16 = "int16",
    u16 = "uint16",
    i32 = "int32",
    u32 = "uint32",
    i64 = "int64",
    u64 = "uint64",
    f32 = "float32",
    f64 = "float64"
);

// Bytes are copied in one piece, since images and point clouds consist of them.
impl Wire for u8 {
    fn ros_type() -> String {
        "uint8".into()
    }
    fn write(&self, out: &mut Writer) {
        out.bytes.push(*self);
    }
    fn read(input: &mut Reader) -> Result<Self> {
        Ok(input.take(1)?[0])
    }
    fn write_all(values: &[Self], out: &mut Writer) {
        out.bytes.extend_from_slice(values);
    }
    fn read_many(count: usize, input: &mut Reader) -> Result<Vec<Self>> {
        Ok(input.take(count)?.to_vec())
    }
}

impl Wire for bool {
    fn ros_type() -> String {
        "bool".into()
    }
    fn write(&self, out: &mut Writer) {
        out.bytes.push(u8::from(*self));
    }
    fn read(input: &mut Reader) -> Result<Self> {
        match input.take(1)?[0] {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(input.error("0 or 1", other)),
        }
    }
}

impl Wire for String {
    const MIN_BYTES: usize = 4;
    fn ros_type() -> String {
        "string".into()
    }
    fn write(&self, out: &mut Writer) {
        // NUL ends a string on the wire: what follows one could not be read back anyway.
        let text = self.split('\0').next().unwrap_or_default();
        out.put_length(text.len() + 1);
        out.bytes.extend_from_slice(text.as_bytes());
        out.bytes.push(0);
    }
    fn read(input: &mut Reader) -> Result<Self> {
        let length = input.length(1)?;
        match input.take(length)? {
            // Some writers send an empty string without its NUL.
            [] => Ok(String::new()),
            [text @ .., 0] => match std::str::from_utf8(text) {
                Ok(text) => Ok(text.to_owned()),
                Err(error) => Err(input.error("UTF-8", error)),
            },
            [.., last] => Err(input.error("a NUL at the end of the string", format!("{last:#04x}"))),
        }
    }
}

impl<T: Wire> Wire for Vec<T> {
    const MIN_BYTES: usize = 4;
    fn ros_type() -> String {
        format!("{}[]", T::ros_type())
    }
    fn write(&self, out: &mut Writer) {
        out.put_length(self.len());
        T::write_all(self, out);
    }
    fn read(input: &mut Reader) -> Result<Self> {
        let length = input.length(T::MIN_BYTES)?;
        T::read_many(length, input)
    }
    fn collect_definitions(list: &mut Vec<(&'static str, String)>) {
        T::collect_definitions(list);
    }
}

impl<T: Wire, const N: usize> Wire for [T; N] {
    fn ros_type() -> String {
        format!("{}[{N}]", T::ros_type())
    }
    fn write(&self, out: &mut Writer) {
        T::write_all(self, out);
    }
    fn read(input: &mut Reader) -> Result<Self> {
        let values = T::read_many(N, input)?;
        values.try_into().map_err(|values: Vec<T>| input.error(format!("{N} items"), values.len()))
    }
    fn collect_definitions(list: &mut Vec<(&'static str, String)>) {
        T::collect_definitions(list);
    }
}
