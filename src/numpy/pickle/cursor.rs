//! Reads the operands of a pickle's opcodes.

use super::Outcome;

/// The bytes of a pickle that are still to be read.
pub(super) struct Cursor<'a>(pub &'a [u8]);

impl<'a> Cursor<'a> {
    /// Reads an unsigned number of `N` bytes, at most 8.
    pub fn length<const N: usize>(&mut self) -> Outcome<u64> {
        let mut word = [0; 8];
        word[..N].copy_from_slice(&self.fixed::<N>()?);
        Ok(u64::from_le_bytes(word))
    }

    /// Reads `length` bytes.
    pub fn take(&mut self, length: u64) -> Outcome<&'a [u8]> {
        let length = usize::try_from(length).ok().filter(|&length| length <= self.0.len());
        let (taken, rest) = self.0.split_at(length.ok_or("the file ends in the middle of a value")?);
        self.0 = rest;
        Ok(taken)
    }

    /// Reads `N` bytes.
    pub fn fixed<const N: usize>(&mut self) -> Outcome<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk().ok_or("the file ends before the pickle does")?;
        self.0 = rest;
        Ok(*taken)
    }

    /// Reads the bytes up to the next line end.
    pub fn line(&mut self) -> Outcome<&'a [u8]> {
        let end = self.0.iter().position(|&byte| byte == b'\n').ok_or("the file ends in the middle of a line")?;
        let line = &self.0[..end];
        self.0 = &self.0[end + 1..];
        Ok(line.strip_suffix(b"\r").unwrap_or(line))
    }

    /// Reads a signed integer of `length` bytes, at most 8.
    pub fn integer(&mut self, length: u64) -> Outcome<i64> {
        let bytes = self.take(length)?;
        if bytes.len() > 8 {
            return Err(format!("an integer of {length} bytes"));
        }
        let negative = bytes.last().is_some_and(|last| last & 0x80 != 0);
        let mut word = if negative { [0xff; 8] } else { [0; 8] };
        word[..bytes.len()].copy_from_slice(bytes);
        Ok(i64::from_le_bytes(word))
    }
}
