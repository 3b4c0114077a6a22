//! Parsing of single records. The library allocates what a length says; here the lengths are compared with the record first.

use mcap::records::{Record, op};

/// Parses the content of a record; None if it is damaged.
pub(super) fn parse(opcode: u8, body: &[u8]) -> Option<Record<'_>> {
    has_room(opcode, body).then(|| mcap::parse_record(opcode, body).ok()).flatten()
}

/// True if the record holds as many bytes as its lengths say.
fn has_room(opcode: u8, body: &[u8]) -> bool {
    // Size of the numbers before the first length, bytes; number of stretches with a length; true = the last is a map.
    let (start, stretches, is_map) = match opcode {
        op::HEADER => (0, 2, false),
        op::SCHEMA => (2, 3, false),
        op::CHANNEL => (4, 3, true),
        op::MESSAGE_INDEX => (2, 1, false),
        op::ATTACHMENT_INDEX => (40, 2, false),
        op::STATISTICS => (42, 1, false),
        op::METADATA => (0, 2, true),
        op::METADATA_INDEX => (16, 1, false),
        op::CHUNK_INDEX => return chunk_index_has_room(body),
        _ => return true,
    };
    let Some(mut rest) = body.get(start..) else { return false };
    let mut last = &[][..];
    for _ in 0..stretches {
        let Some((stretch, behind)) = stretch(rest) else { return false };
        (last, rest) = (stretch, behind);
    }
    while is_map && !last.is_empty() {
        let Some((_, behind)) = stretch(last) else { return false };
        last = behind;
    }
    true
}

fn chunk_index_has_room(body: &[u8]) -> bool {
    // Four numbers, a map, the length of the index, the compression's name.
    let behind = body.get(32..).and_then(stretch);
    behind.and_then(|(_, rest)| rest.get(8..)).and_then(stretch).is_some()
}

/// Splits off a stretch of bytes behind its length; None if the length exceeds what follows.
fn stretch(bytes: &[u8]) -> Option<(&[u8], &[u8])> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.split_at_checked(usize::try_from(u32::from_le_bytes(*length)).ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(text: &str) -> Vec<u8> {
        [&(text.len() as u32).to_le_bytes(), text.as_bytes()].concat()
    }

    #[test]
    fn a_length_beyond_the_record_is_refused_and_an_intact_record_is_parsed() {
        let map = [text("key"), text("value")].concat();
        let map = [&(map.len() as u32).to_le_bytes()[..], &map].concat();
        let ids = [1, 0, 2, 0];
        for (opcode, parts) in [
            (op::HEADER, vec![text("ros2"), text("me")]),
            (op::SCHEMA, vec![ids[..2].to_vec(), text("type"), text("ros2msg"), text("uint8 a")]),
            (op::CHANNEL, vec![ids.to_vec(), text("/topic"), text("cdr"), map.clone()]),
            (op::METADATA, vec![text("name"), map]),
            (op::METADATA_INDEX, vec![vec![0; 16], text("name")]),
        ] {
            let whole = parts.concat();
            assert!(parse(opcode, &whole).is_some(), "{opcode}");
            // Any cut, and any length that becomes huge.
            for end in 0..whole.len() {
                assert!(parse(opcode, &whole[..end]).is_none(), "{opcode} cut at {end}");
            }
            let mut at = 0;
            for part in parts {
                let mut damaged = whole.clone();
                if part.len() > 4 && part.len() != 16 {
                    damaged[at + 3] = 0xa0;
                    assert!(parse(opcode, &damaged).is_none(), "{opcode} at {at}");
                }
                at += part.len();
            }
        }
    }
}
