//! The stack machine of Python's pickle format, protocols 0 to 5 (Python's `pickletools` documents the opcodes).

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::HashMap;

use super::literal::{integer, number, python2_string, raw_unicode, text};
use super::{Id, Outcome, Pickle, Value};

/// Largest number of values of a pickle; a MANO file has some hundreds.
const MAX_VALUES: usize = 1 << 20;

/// Packages whose names may occur: [`super::arrays`] interprets them or ignores them as parts of objects in a MANO
/// file.
const KNOWN_PACKAGES: [&str; 3] = ["numpy", "scipy.sparse", "chumpy"];
/// Further names that may occur.
const KNOWN_NAMES: [&str; 11] = [
    "copy_reg._reconstructor",
    "copyreg._reconstructor",
    "__builtin__.object",
    "builtins.object",
    "__builtin__.set",
    "builtins.set",
    "__builtin__.bytearray",
    "builtins.bytearray",
    "_codecs.encode",
    "collections.OrderedDict",
    "collections.defaultdict",
];

struct Machine<'a> {
    rest: &'a [u8],
    values: Vec<Value<'a>>,
    stack: Vec<Id>,
    /// Stack heights at the marks.
    marks: Vec<usize>,
    memo: HashMap<u64, Id>,
}

/// Runs a complete pickle.
pub(super) fn run(bytes: &[u8]) -> Outcome<Pickle<'_>> {
    let mut machine =
        Machine { rest: bytes, values: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo: HashMap::new() };
    loop {
        let at = bytes.len() - machine.rest.len();
        let [opcode] = machine.fixed()?;
        if opcode == b'.' {
            break;
        }
        machine.step(opcode).map_err(|message| format!("{message} (pickle opcode at byte {at})"))?;
    }
    let root = machine.pop()?;
    Ok(Pickle { values: machine.values, root, n_read: Cell::new(0) })
}

impl<'a> Machine<'a> {
    /// Executes one opcode.
    fn step(&mut self, opcode: u8) -> Outcome<()> {
        let known = self.stack_opcode(opcode)?
            || self.number_opcode(opcode)?
            || self.text_opcode(opcode)?
            || self.container_opcode(opcode)?
            || self.memo_opcode(opcode)?
            || self.object_opcode(opcode)?;
        if known {
            return Ok(());
        }
        Err(format!("opcode {:?} (0x{opcode:02x}) is not supported", char::from(opcode)))
    }

    /// Executes an opcode of the stack or the framing; false if `opcode` is another one. So do the functions below.
    fn stack_opcode(&mut self, opcode: u8) -> Outcome<bool> {
        match opcode {
            // Protocol version and frame length: neither changes the meaning of later opcodes.
            0x80 => drop(self.fixed::<1>()?),
            0x95 => drop(self.fixed::<8>()?),
            b'(' => self.marks.push(self.stack.len()),
            b'0' if self.marks.last() == Some(&self.stack.len()) => drop(self.marks.pop()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.pop_to_mark()?),
            b'2' => {
                let top = self.pop()?;
                self.stack.extend([top, top]);
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn number_opcode(&mut self, opcode: u8) -> Outcome<bool> {
        let value = match opcode {
            b'N' => Value::None,
            0x88 => Value::Bool(true),
            0x89 => Value::Bool(false),
            b'J' => Value::Int(i32::from_le_bytes(self.fixed()?).into()),
            b'K' => Value::Int(u8::from_le_bytes(self.fixed()?).into()),
            b'M' => Value::Int(u16::from_le_bytes(self.fixed()?).into()),
            b'I' | b'L' => integer(self.line()?)?,
            0x8a => {
                let length = self.length::<1>()?;
                self.long(length)?
            }
            0x8b => {
                let length = self.length::<4>()?;
                self.long(length)?
            }
            b'F' => {
                let line = text(self.line()?)?;
                Value::Float(line.parse().map_err(|_| format!("{line:?} is not a number"))?)
            }
            b'G' => Value::Float(f64::from_be_bytes(self.fixed()?)),
            _ => return Ok(false),
        };
        self.push(value)?;
        Ok(true)
    }

    fn text_opcode(&mut self, opcode: u8) -> Outcome<bool> {
        let length = match opcode {
            b'S' => {
                let bytes = python2_string(self.line()?)?;
                self.push(Value::Bytes(Cow::Owned(bytes)))?;
                return Ok(true);
            }
            b'V' => {
                let text = raw_unicode(self.line()?)?;
                self.push(Value::Text(text))?;
                return Ok(true);
            }
            b'U' | b'C' | 0x8c => self.length::<1>()?,
            b'T' | b'B' | b'X' => self.length::<4>()?,
            0x8e | 0x96 | 0x8d => self.length::<8>()?,
            _ => return Ok(false),
        };
        let bytes = self.take(length)?;
        let is_text = matches!(opcode, 0x8c | b'X' | 0x8d);
        self.push(match is_text {
            // Rust text cannot hold lone surrogates; no key or array of a hand model has them.
            true => Value::Text(String::from_utf8_lossy(bytes).into_owned()),
            false => Value::Bytes(Cow::Borrowed(bytes)),
        })?;
        Ok(true)
    }

    fn container_opcode(&mut self, opcode: u8) -> Outcome<bool> {
        match opcode {
            b']' | 0x8f => self.push(Value::List(Vec::new()))?,
            b'}' => self.push(Value::Dict(Vec::new()))?,
            b')' => self.push(Value::Tuple(Vec::new()))?,
            b'l' | 0x91 => {
                let items = self.pop_to_mark()?;
                self.push(Value::List(items))?;
            }
            b't' => {
                let items = self.pop_to_mark()?;
                self.push(Value::Tuple(items))?;
            }
            // Tuples of one to three items.
            0x85..=0x87 => {
                let mut items = (0x84..opcode).map(|_| self.pop()).collect::<Outcome<Vec<Id>>>()?;
                items.reverse();
                self.push(Value::Tuple(items))?;
            }
            b'd' => {
                let items = self.pop_to_mark()?;
                self.push(Value::Dict(pairs(&items)?))?;
            }
            b'a' => {
                let item = self.pop()?;
                self.append(vec![item])?;
            }
            b'e' | 0x90 => {
                let items = self.pop_to_mark()?;
                self.append(items)?;
            }
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                self.insert(&[key, value])?;
            }
            b'u' => {
                let items = self.pop_to_mark()?;
                self.insert(&items)?;
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn memo_opcode(&mut self, opcode: u8) -> Outcome<bool> {
        let slot = match opcode {
            b'p' | b'g' => number(self.line()?)?,
            b'q' | b'h' => self.length::<1>()?,
            b'r' | b'j' => self.length::<4>()?,
            0x94 => self.memo.len() as u64,
            _ => return Ok(false),
        };
        match opcode {
            b'g' | b'h' | b'j' => {
                let id = self.memo.get(&slot).ok_or_else(|| format!("memo {slot} is read before it is written"))?;
                self.stack.push(*id);
            }
            _ => {
                let top = self.pop()?;
                self.stack.push(top);
                self.memo.insert(slot, top);
            }
        }
        Ok(true)
    }

    /// Records names and calls; see [`Value::Call`].
    fn object_opcode(&mut self, opcode: u8) -> Outcome<bool> {
        match opcode {
            b'c' => {
                let (module, name) = (text(self.line()?)?, text(self.line()?)?);
                self.global(module, name)?;
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                match (&self.values[module], &self.values[name]) {
                    (Value::Text(module), Value::Text(name)) => self.global(&module.clone(), &name.clone())?,
                    _ => return Err("a name that is not text".into()),
                }
            }
            b'R' | 0x81 => {
                let (args, function) = (self.pop()?, self.pop()?);
                self.push(Value::Call { function, args, state: None })?;
            }
            0x92 => {
                let (_keywords, args, function) = (self.pop()?, self.pop()?, self.pop()?);
                self.push(Value::Call { function, args, state: None })?;
            }
            b'o' => {
                let mut items = self.pop_to_mark()?;
                if items.is_empty() {
                    return Err("an object without a class".into());
                }
                let function = items.remove(0);
                self.call(function, items)?;
            }
            b'i' => {
                let (module, name) = (text(self.line()?)?, text(self.line()?)?);
                let items = self.pop_to_mark()?;
                self.global(module, name)?;
                let function = self.pop()?;
                self.call(function, items)?;
            }
            b'b' => {
                let new_state = self.pop()?;
                match self.top()? {
                    Value::Call { state, .. } => *state = Some(new_state),
                    other => return Err(format!("a state for {}", kind(other))),
                }
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn push(&mut self, value: Value<'a>) -> Outcome<()> {
        if self.values.len() >= MAX_VALUES {
            return Err(format!("more than {MAX_VALUES} values"));
        }
        self.stack.push(self.values.len());
        self.values.push(value);
        Ok(())
    }

    /// Pops the topmost value above the last mark.
    fn pop(&mut self) -> Outcome<Id> {
        let floor = self.marks.last().copied().unwrap_or(0);
        let top = self.stack.pop().filter(|_| self.stack.len() >= floor);
        top.ok_or_else(|| "a value is missing from the stack".to_string())
    }

    fn pop_to_mark(&mut self) -> Outcome<Vec<Id>> {
        let mark = self.marks.pop().ok_or("a mark is missing from the stack")?;
        Ok(self.stack.split_off(mark.min(self.stack.len())))
    }

    fn top(&mut self) -> Outcome<&mut Value<'a>> {
        let top = self.pop()?;
        self.stack.push(top);
        Ok(&mut self.values[top])
    }

    fn append(&mut self, items: Vec<Id>) -> Outcome<()> {
        match self.top()? {
            Value::List(list) => list.extend(items),
            // An object made by a call, such as a set: no array is read from it, so the items are dropped.
            Value::Call { .. } => {}
            other => return Err(format!("items for {}", kind(other))),
        }
        Ok(())
    }

    fn insert(&mut self, items: &[Id]) -> Outcome<()> {
        let new = pairs(items)?;
        match self.top()? {
            Value::Dict(entries) => entries.extend(new),
            Value::Call { .. } => {}
            other => return Err(format!("entries for {}", kind(other))),
        }
        Ok(())
    }

    fn global(&mut self, module: &str, name: &str) -> Outcome<()> {
        let path = format!("{module}.{name}");
        let within = |package: &&str| module.strip_prefix(*package).is_some_and(|r| r.is_empty() || r.starts_with('.'));
        let known = KNOWN_PACKAGES.iter().any(within) || KNOWN_NAMES.contains(&path.as_str());
        if !known {
            return Err(format!("the pickle names `{path}`, which is not part of a hand model"));
        }
        self.push(Value::Global(path))
    }

    fn call(&mut self, function: Id, args: Vec<Id>) -> Outcome<()> {
        self.push(Value::Tuple(args))?;
        let args = self.pop()?;
        self.push(Value::Call { function, args, state: None })
    }

    /// Reads a signed integer of `length` bytes.
    fn long(&mut self, length: u64) -> Outcome<Value<'a>> {
        let bytes = self.take(length)?;
        if bytes.len() > 8 {
            return Err(format!("an integer of {length} bytes"));
        }
        let negative = bytes.last().is_some_and(|last| last & 0x80 != 0);
        let mut word = if negative { [0xff; 8] } else { [0; 8] };
        word[..bytes.len()].copy_from_slice(bytes);
        Ok(Value::Int(i64::from_le_bytes(word)))
    }

    /// Reads an unsigned number of `N` bytes, at most 8.
    fn length<const N: usize>(&mut self) -> Outcome<u64> {
        let mut word = [0; 8];
        word[..N].copy_from_slice(&self.fixed::<N>()?);
        Ok(u64::from_le_bytes(word))
    }

    fn take(&mut self, length: u64) -> Outcome<&'a [u8]> {
        let length = usize::try_from(length).ok().filter(|&length| length <= self.rest.len());
        let (taken, rest) = self.rest.split_at(length.ok_or("the file ends in the middle of a value")?);
        self.rest = rest;
        Ok(taken)
    }

    fn fixed<const N: usize>(&mut self) -> Outcome<[u8; N]> {
        let (taken, rest) = self.rest.split_first_chunk().ok_or("the file ends before the pickle does")?;
        self.rest = rest;
        Ok(*taken)
    }

    /// Returns the bytes up to the next line end.
    fn line(&mut self) -> Outcome<&'a [u8]> {
        let end = self.rest.iter().position(|&byte| byte == b'\n').ok_or("the file ends in the middle of a line")?;
        let line = &self.rest[..end];
        self.rest = &self.rest[end + 1..];
        Ok(line.strip_suffix(b"\r").unwrap_or(line))
    }
}

/// Describes the type of a value.
pub(super) fn kind(value: &Value) -> &'static str {
    match value {
        Value::None => "None",
        Value::Bool(_) => "a boolean",
        Value::Int(_) => "an integer",
        Value::Float(_) => "a number",
        Value::Bytes(_) => "a string of bytes",
        Value::Text(_) => "a text",
        Value::List(_) => "a list",
        Value::Tuple(_) => "a tuple",
        Value::Dict(_) => "a dictionary",
        Value::Global(_) => "a name",
        Value::Call { .. } => "an object",
    }
}

fn pairs(items: &[Id]) -> Outcome<Vec<(Id, Id)>> {
    let (pairs, rest) = items.as_chunks::<2>();
    if !rest.is_empty() {
        return Err("a key without a value".into());
    }
    Ok(pairs.iter().map(|&[key, value]| (key, value)).collect())
}
