//! Index of a tar archive, for random access to its members.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::file::input;
use crate::file::limits::{self, Limit};

/// Size of a header, and the unit that contents are padded to, bytes.
const BLOCK: usize = 512;
/// Largest size of a name or of extended attributes, bytes.
const MAX_ATTRIBUTES: u64 = 1 << 20;

/// An archive whose members were found, and not read yet.
#[derive(Debug)]
pub struct TarFile {
    path: PathBuf,
    file: File,
    members: BTreeMap<String, Member>,
    /// Fault that ends the archive before its end, if any.
    fault: Option<String>,
}

/// Place of a member's content, bytes.
#[derive(Debug, Clone, Copy)]
struct Member {
    start: u64,
    size: u64,
}

impl TarFile {
    /// Reads the headers of the archive at `path`. Of an archive that is cut off or damaged, the members before the damage
    /// are found; [`TarFile::fault`] tells the damage.
    ///
    /// # Errors
    /// If the file can't be read, or is not a tar archive.
    pub fn open(path: &Path) -> Result<Self> {
        let file = input::open(path)?;
        let length = file.metadata().map_err(Error::io(path))?.len();
        let mut tar = Self { path: path.to_path_buf(), file, members: BTreeMap::new(), fault: None };
        if let Err(fault) = tar.index(length)? {
            match tar.members.is_empty() {
                true => return Err(Error::file(path, format!("not a tar archive: {fault}"))),
                false => tar.fault = Some(fault),
            }
        }
        Ok(tar)
    }

    /// Returns the damage that ends the archive early.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// Returns the names of the members, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.members.keys().map(String::as_str)
    }

    /// Reads the content of a member; `None` if there is none of this name.
    ///
    /// # Errors
    /// If it is larger than `limit`, or can't be read.
    pub fn read(&self, name: &str, limit: Limit) -> Result<Option<Vec<u8>>> {
        let Some(member) = self.members.get(name) else { return Ok(None) };
        limit.check(&self.path, name, member.size)?;
        let mut content = vec![0; member.size as usize];
        self.file.read_exact_at(&mut content, member.start).map_err(Error::io(&self.path))?;
        Ok(Some(content))
    }

    /// Finds the members; the inner error is the fault of the archive.
    fn index(&mut self, length: u64) -> Result<std::result::Result<(), String>> {
        let copy = self.file.try_clone().map_err(Error::io(&self.path))?;
        let mut reader = BufReader::new(copy);
        let (mut at, mut next_name, mut next_size) = (0u64, None::<String>, None::<u64>);
        loop {
            if at == length {
                return Ok(Ok(()));
            }
            let mut header = [0; BLOCK];
            if length - at < BLOCK as u64 {
                return Ok(Err(format!("it ends within the header at byte {at}")));
            }
            reader.seek(SeekFrom::Start(at)).map_err(Error::io(&self.path))?;
            reader.read_exact(&mut header).map_err(Error::io(&self.path))?;
            if header.iter().all(|byte| *byte == 0) {
                return Ok(Ok(()));
            }
            let Some((name, size)) = parse(&header) else {
                return Ok(Err(format!("the header at byte {at} is damaged")));
            };
            let size = next_size.take().unwrap_or(size);
            let start = at + BLOCK as u64;
            let end = start.checked_add(size).filter(|end| *end <= length);
            let Some(end) = end else {
                return Ok(Err(format!("it ends within {}", next_name.unwrap_or(name))));
            };
            let kind = header[156];
            if matches!(kind, b'L' | b'x') {
                if size > MAX_ATTRIBUTES {
                    return Ok(Err(format!("the name at byte {at} has {size} bytes")));
                }
                let mut content = vec![0; size as usize];
                reader.read_exact(&mut content).map_err(Error::io(&self.path))?;
                if kind == b'L' {
                    next_name = Some(until_zero(&content));
                } else {
                    for (key, value) in extended(&content) {
                        match key.as_str() {
                            "path" => next_name = Some(value),
                            "size" => next_size = value.parse().ok(),
                            _ => {}
                        }
                    }
                }
            } else {
                let name = next_name.take().unwrap_or(name);
                if matches!(kind, b'0' | b'7' | 0) {
                    limits::FRAMES.check(&self.path, "members", self.members.len() as u64 / 8)?;
                    self.members.insert(name.trim_start_matches("./").to_string(), Member { start, size });
                }
            }
            at = end.next_multiple_of(BLOCK as u64).min(length);
        }
    }
}

/// Reads name and size from a header; `None` if its checksum is wrong.
fn parse(header: &[u8; BLOCK]) -> Option<(String, u64)> {
    let sum: u64 =
        header.iter().enumerate().map(|(at, byte)| if (148..156).contains(&at) { 32 } else { u64::from(*byte) }).sum();
    if number(&header[148..156])? != sum {
        return None;
    }
    let name = until_zero(&header[..100]);
    let prefix = if header[257..].starts_with(b"ustar\0") { until_zero(&header[345..500]) } else { String::new() };
    let name = if prefix.is_empty() { name } else { format!("{prefix}/{name}") };
    Some((name, number(&header[124..136])?))
}

/// Reads an octal number, or a binary one behind the byte 0x80.
fn number(field: &[u8]) -> Option<u64> {
    if let [0x80, rest @ ..] = field {
        return rest.iter().try_fold(0u64, |word, byte| word.checked_mul(256)?.checked_add(u64::from(*byte)));
    }
    let text = std::str::from_utf8(field).ok()?.trim_matches(['\0', ' ']);
    u64::from_str_radix(text, 8).ok()
}

fn until_zero(bytes: &[u8]) -> String {
    let end = bytes.iter().position(|byte| *byte == 0).unwrap_or(bytes.len());
    String::from_utf8_lossy(&bytes[..end]).into_owned()
}

/// Reads the records "LENGTH KEY=VALUE\n" of an extended header.
fn extended(bytes: &[u8]) -> Vec<(String, String)> {
    let (mut rest, mut found) = (bytes, Vec::new());
    while let Some(space) = rest.iter().position(|byte| *byte == b' ') {
        let length = std::str::from_utf8(&rest[..space]).ok().and_then(|text| text.parse::<usize>().ok());
        let Some(record) = length.filter(|length| *length > space).and_then(|length| rest.get(space + 1..length))
        else {
            break;
        };
        let record = String::from_utf8_lossy(record);
        found.extend(record.trim_end_matches('\n').split_once('=').map(|(key, value)| (key.into(), value.into())));
        rest = &rest[length.unwrap_or(rest.len())..];
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header(name: &str, size: usize, kind: u8) -> Vec<u8> {
        let mut header = vec![0; BLOCK];
        header[..name.len()].copy_from_slice(name.as_bytes());
        header[124..135].copy_from_slice(format!("{size:011o}").as_bytes());
        header[156] = kind;
        header[257..265].copy_from_slice(b"ustar\x0000");
        header[148..156].fill(b' ');
        let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
        header[148..155].copy_from_slice(format!("{sum:06o}\0").as_bytes());
        header
    }

    fn member(name: &str, content: &[u8], kind: u8) -> Vec<u8> {
        let mut bytes = header(name, content.len(), kind);
        bytes.extend(content);
        bytes.resize(bytes.len().next_multiple_of(BLOCK), 0);
        bytes
    }

    fn open(bytes: &[u8]) -> Result<TarFile> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        TarFile::open(file.path())
    }

    #[test]
    fn members_have_their_names_and_contents() {
        let long = "f".repeat(150);
        let mut bytes = member("a.json", b"{}", b'0');
        bytes.extend(member("././@LongLink", format!("{long}\0").as_bytes(), b'L'));
        bytes.extend(member("short", b"long name", b'0'));
        bytes.extend(member("pax", b"15 path=./b.jpg\n", b'x'));
        bytes.extend(member("other", &[7; 600], 0));
        bytes.extend(header("folder/", 0, b'5'));
        bytes.extend([0; 2 * BLOCK]);
        let tar = open(&bytes).unwrap();
        assert_eq!(tar.names().collect::<Vec<_>>(), ["a.json", "b.jpg", &long]);
        assert_eq!(tar.read("b.jpg", limits::FILE).unwrap().unwrap(), [7; 600]);
        assert_eq!(tar.read(&long, limits::FILE).unwrap().unwrap(), b"long name");
        assert!(tar.read("c", limits::FILE).unwrap().is_none() && tar.fault().is_none());
    }

    #[test]
    fn an_archive_cut_anywhere_keeps_its_whole_members() {
        let whole: Vec<u8> = ["a", "b", "c"].iter().flat_map(|name| member(name, &[1; 500], b'0')).collect();
        for cut in 1..whole.len() {
            let complete = (0..3).filter(|index| index * 1024 + BLOCK + 500 <= cut).count();
            match open(&whole[..cut]) {
                Ok(tar) => assert_eq!(tar.names().count(), complete, "{cut}"),
                Err(error) => assert!(complete == 0 && error.to_string().contains("not a tar archive"), "{cut}"),
            }
        }
        let mut damaged = whole.clone();
        damaged[1024 + 3] ^= 1;
        let tar = open(&damaged).unwrap();
        assert_eq!((tar.names().count(), tar.fault()), (1, Some("the header at byte 1024 is damaged")));
    }
}
