//! Choice of ffmpeg's demultiplexer by the first bytes of a file, so that no file is read as a list of other files.

use std::ffi::OsString;
use std::io::Read;
use std::path::Path;

use crate::error::{Error, Result};
use crate::file::input;
use crate::file::limits;

/// Number of bytes that tell the format; the packets of a transport stream have 188.
const HEAD: u64 = 189;
/// First byte of each packet of a transport stream.
const SYNC: u8 = 0x47;

/// Returns the arguments with which ffmpeg and ffprobe read the video file at `path`, ending in its URL. By
/// themselves these programs would read a playlist of any name, and the files that it lists.
///
/// # Errors
/// If it is not a regular file, or does not begin like a video.
pub(super) fn arguments(path: &Path) -> Result<Vec<OsString>> {
    let mut head = Vec::new();
    input::open(path)?.take(HEAD).read_to_end(&mut head).map_err(Error::io(path))?;
    let Some(format) = format(&head) else {
        let message = "expected a video (MP4, MOV, MKV, WebM, AVI, MPEG), got a file that begins like none of them";
        return Err(Error::file(path, message));
    };
    let most = limits::IMAGE.value().to_string();
    let fixed = ["-protocol_whitelist", "file", "-format_whitelist", format, "-max_pixels", &most, "-f", format, "-i"];
    // As a URL, so that the program does not interpret the name.
    let mut url = OsString::from("file:");
    url.push(path);
    Ok(fixed.into_iter().map(OsString::from).chain([url]).collect())
}

/// Returns the name of the demultiplexer for a file that begins with `head`.
fn format(head: &[u8]) -> Option<&'static str> {
    const ATOMS: [&[u8]; 7] = [b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot"];
    match head {
        [_, _, _, _, atom @ ..] if ATOMS.contains(&atom.get(..4).unwrap_or_default()) => Some("mov"),
        [0x1a, 0x45, 0xdf, 0xa3, ..] => Some("matroska"),
        [b'R', b'I', b'F', b'F', _, _, _, _, b'A', b'V', b'I', ..] => Some("avi"),
        [0, 0, 1, 0xba, ..] => Some("mpeg"),
        [0, 0, 1, 0xb3, ..] => Some("mpegvideo"),
        [SYNC, ..] if head.get(188) == Some(&SYNC) => Some("mpegts"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_bytes_name_the_demultiplexer() {
        let cases: [(&[u8], Option<&str>); 5] = [
            (b"\0\0\0\x20ftypisom", Some("mov")),
            (b"\x1a\x45\xdf\xa3\x01", Some("matroska")),
            (b"RIFF\0\0\0\0AVI LIST", Some("avi")),
            (b"#EXTM3U\n#EXTINF:1,\n/etc/passwd\n", None),
            (b"ffconcat version 1.0\nfile /etc/passwd\n", None),
        ];
        for (head, name) in cases {
            assert_eq!(format(head), name);
        }
    }
}
