//! The stack machine of Python's pickle format, protocols 0 to 5 (Python's `pickletools` documents the opcodes).

use std::borrow::Cow;
use std::cell::Cell;
use std::collections::HashMap;

use super::account::Account;
use super::cursor::Cursor;
use super::literal::{integer, number, python2_string, raw_unicode, text};
use super::names::Names;
use super::{Id, Outcome, Pickle, Value};

/// Memory of one value beside its text or items, bytes.
const VALUE: usize = size_of::<Value>();
/// Memory of a place on the stack, of a mark, or of an item of a list, bytes.
const PLACE: usize = size_of::<Id>();
/// Memory of an entry of the memo, bytes: key, value and the table's share.
const MEMO: usize = 32;
/// Classes whose objects are read as dictionaries.
const DICTIONARIES: [&str; 2] = ["collections.OrderedDict", "collections.defaultdict"];

struct Machine<'a> {
    input: Cursor<'a>,
    names: &'static Names,
    account: Account,
    values: Vec<Value<'a>>,
    stack: Vec<Id>,
    /// Stack heights at the marks.
    marks: Vec<usize>,
    memo: HashMap<u64, Id>,
}

/// Runs a complete pickle that contains no other names than `names`.
pub(super) fn run<'a>(bytes: &'a [u8], names: &'static Names) -> Outcome<Pickle<'a>> {
    let (input, account) = (Cursor(bytes), Account::new(bytes.len()));
    let (values, stack, marks, memo) = (Vec::new(), Vec::new(), Vec::new(), HashMap::new());
    let mut machine = Machine { input, names, account, values, stack, marks, memo };
    loop {
        let at = bytes.len() - machine.input.0.len();
        let [opcode] = machine.input.fixed()?;
        if opcode == b'.' {
            break;
        }
        machine.step(opcode).map_err(|message| format!("{message} (pickle opcode at byte {at})"))?;
    }
    let root = machine.pop()?;
    Ok(Pickle { end: bytes.len() - machine.input.0.len(), values: machine.values, root, work: Cell::new(0) })
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
            0x80 => drop(self.input.fixed::<1>()?),
            0x95 => drop(self.input.fixed::<8>()?),
            b'(' => {
                self.account.charge(PLACE)?;
                self.marks.push(self.stack.len());
            }
            b'0' if self.marks.last() == Some(&self.stack.len()) => drop(self.marks.pop()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.pop_to_mark()?),
            b'2' => {
                let top = self.pop()?;
                self.stack.push(top);
                self.put(top)?;
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
            b'J' => Value::Int(i32::from_le_bytes(self.input.fixed()?).into()),
            b'K' => Value::Int(u8::from_le_bytes(self.input.fixed()?).into()),
            b'M' => Value::Int(u16::from_le_bytes(self.input.fixed()?).into()),
            b'I' | b'L' => integer(self.input.line()?)?,
            0x8a => {
                let length = self.input.length::<1>()?;
                Value::Int(self.input.integer(length)?)
            }
            0x8b => {
                let length = self.input.length::<4>()?;
                Value::Int(self.input.integer(length)?)
            }
            b'F' => {
                let line = text(self.input.line()?)?;
                Value::Float(line.parse().map_err(|_| format!("{line:?} is not a number"))?)
            }
            b'G' => Value::Float(f64::from_be_bytes(self.input.fixed()?)),
            _ => return Ok(false),
        };
        self.push(value)?;
        Ok(true)
    }

    fn text_opcode(&mut self, opcode: u8) -> Outcome<bool> {
        let length = match opcode {
            b'S' => {
                let bytes = python2_string(self.input.line()?)?;
                self.account.charge(bytes.len())?;
                self.push(Value::Bytes(Cow::Owned(bytes)))?;
                return Ok(true);
            }
            b'V' => {
                let text = raw_unicode(self.input.line()?)?;
                self.account.charge(text.len())?;
                self.push(Value::Text(text))?;
                return Ok(true);
            }
            b'U' | b'C' | 0x8c => self.input.length::<1>()?,
            b'T' | b'B' | b'X' => self.input.length::<4>()?,
            0x8e | 0x96 | 0x8d => self.input.length::<8>()?,
            _ => return Ok(false),
        };
        let bytes = self.input.take(length)?;
        let is_text = matches!(opcode, 0x8c | b'X' | 0x8d);
        self.account.charge(if is_text { bytes.len() } else { 0 })?;
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
            b'p' | b'g' => number(self.input.line()?)?,
            b'q' | b'h' => self.input.length::<1>()?,
            b'r' | b'j' => self.input.length::<4>()?,
            0x94 => self.memo.len() as u64,
            _ => return Ok(false),
        };
        match opcode {
            b'g' | b'h' | b'j' => {
                let id = self.memo.get(&slot).ok_or_else(|| format!("memo {slot} is read before it is written"))?;
                self.put(*id)?;
            }
            _ => {
                let top = self.pop()?;
                self.stack.push(top);
                self.account.charge(MEMO)?;
                self.memo.insert(slot, top);
            }
        }
        Ok(true)
    }

    /// Records names and calls; see [`Value::Call`].
    fn object_opcode(&mut self, opcode: u8) -> Outcome<bool> {
        match opcode {
            b'c' => {
                let (module, name) = (text(self.input.line()?)?, text(self.input.line()?)?);
                self.global(module, name)?;
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                match (&self.values[module], &self.values[name]) {
                    (Value::Text(module), Value::Text(name)) => {
                        self.account.charge(2 * (module.len() + name.len()))?;
                        self.global(&module.clone(), &name.clone())?;
                    }
                    _ => return Err("a name that is not text".into()),
                }
            }
            b'R' | 0x81 => {
                let (args, function) = (self.pop()?, self.pop()?);
                let is_dictionary =
                    matches!(&self.values[function], Value::Global(name) if DICTIONARIES.contains(&name.as_str()));
                self.push(match is_dictionary {
                    true => Value::Dict(Vec::new()),
                    false => Value::Call { function, args, state: None },
                })?;
            }
            b'Q' => {
                let id = self.pop()?;
                self.push(Value::Persistent(id))?;
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
                let (module, name) = (text(self.input.line()?)?, text(self.input.line()?)?);
                let items = self.pop_to_mark()?;
                self.global(module, name)?;
                let function = self.pop()?;
                self.call(function, items)?;
            }
            b'b' => {
                let new_state = self.pop()?;
                match self.top()? {
                    Value::Call { state, .. } => *state = Some(new_state),
                    // Attributes of a dictionary, such as `_metadata` of a network's; no entry is among them.
                    Value::Dict(_) => {}
                    other => return Err(format!("a state for {}", kind(other))),
                }
            }
            _ => return Ok(false),
        }
        Ok(true)
    }

    fn push(&mut self, value: Value<'a>) -> Outcome<()> {
        self.account.charge(VALUE)?;
        self.put(self.values.len())?;
        self.values.push(value);
        Ok(())
    }

    /// Puts a value on the stack.
    fn put(&mut self, id: Id) -> Outcome<()> {
        self.account.charge(PLACE)?;
        self.stack.push(id);
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
        let mark = mark.min(self.stack.len());
        // The items are copied once more when they are appended to a list or become the pairs of a dictionary.
        self.account.charge(2 * PLACE * (self.stack.len() - mark))?;
        Ok(self.stack.split_off(mark))
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
        self.account.charge(module.len() + name.len() + 1)?;
        let path = format!("{module}.{name}");
        if !self.names.contain(module, name) {
            return Err(format!("the pickle names `{path}`, which is not part of {}", self.names.kind));
        }
        self.push(Value::Global(path))
    }

    fn call(&mut self, function: Id, args: Vec<Id>) -> Outcome<()> {
        self.push(Value::Tuple(args))?;
        let args = self.pop()?;
        self.push(Value::Call { function, args, state: None })
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
        Value::Persistent(_) => "a reference to a storage",
    }
}

fn pairs(items: &[Id]) -> Outcome<Vec<(Id, Id)>> {
    let (pairs, rest) = items.as_chunks::<2>();
    if !rest.is_empty() {
        return Err("a key without a value".into());
    }
    Ok(pairs.iter().map(|&[key, value]| (key, value)).collect())
}
