//! Tables of comma-separated values, with names in the first line.

use std::path::{Path, PathBuf};

use crate::error::{Error, Result};
use crate::file::{input, limits};

/// A table.
#[derive(Debug)]
pub struct Csv {
    path: PathBuf,
    names: Vec<String>,
    rows: Vec<Vec<String>>,
}

/// A row of a table.
#[derive(Debug, Clone, Copy)]
pub struct Row<'a> {
    table: &'a Csv,
    index: usize,
}

impl Csv {
    /// Reads a table.
    ///
    /// # Errors
    /// If the file can't be read, a quoted field does not end, or a row has another number of fields than the first line.
    pub fn read(path: &Path) -> Result<Self> {
        Self::parse(path, &input::read_text(path, limits::TEXT)?)
    }

    fn parse(path: &Path, text: &str) -> Result<Self> {
        let mut lines = split(text).map_err(|message| Error::file(path, message))?.into_iter();
        let names = lines.next().ok_or_else(|| Error::file(path, "expected names in the first line, got nothing"))?;
        let rows: Vec<Vec<String>> = lines.collect();
        if let Some(index) = rows.iter().position(|row| row.len() != names.len()) {
            let got = rows[index].len();
            return Err(Error::file(path, format!("row {}: expected {} fields, got {got}", index + 1, names.len())));
        }
        Ok(Self { path: path.to_path_buf(), names, rows })
    }

    /// Returns the rows.
    pub fn rows(&self) -> impl Iterator<Item = Row<'_>> {
        (0..self.rows.len()).map(|index| Row { table: self, index })
    }
}

impl<'a> Row<'a> {
    /// Returns the field of a column.
    ///
    /// # Errors
    /// If there is no such column.
    pub fn get(&self, name: &str) -> Result<&'a str> {
        let table = self.table;
        let column = table.names.iter().position(|known| known == name).ok_or_else(|| Error::Missing {
            name: name.into(),
            place: table.path.display().to_string(),
            present: table.names.join(", "),
        })?;
        Ok(&table.rows[self.index][column])
    }

    /// Creates the error of a field that is not `expected`.
    pub fn expected(&self, name: &str, expected: &str) -> Error {
        let got = self.get(name).unwrap_or_default();
        Error::file(&self.table.path, format!("row {}: {name}: expected {expected}, got {got:?}", self.index + 1))
    }
}

/// Splits a text into rows of fields; quotes enclose fields with commas, and two of them stand for one.
fn split(text: &str) -> std::result::Result<Vec<Vec<String>>, String> {
    let (mut rows, mut row, mut field, mut quoted) = (Vec::new(), Vec::new(), String::new(), false);
    let mut chars = text.chars().peekable();
    while let Some(char) = chars.next() {
        match char {
            '"' if quoted && chars.peek() == Some(&'"') => {
                chars.next();
                field.push('"');
            }
            '"' => quoted = !quoted,
            ',' if !quoted => row.push(std::mem::take(&mut field)),
            '\n' if !quoted => {
                row.push(std::mem::take(&mut field));
                rows.push(std::mem::take(&mut row));
            }
            '\r' if !quoted => {}
            other => field.push(other),
        }
    }
    if quoted {
        return Err(format!("row {}: a quoted field does not end", rows.len()));
    }
    if !field.is_empty() || !row.is_empty() {
        row.push(field);
        rows.push(row);
    }
    rows.retain(|row| row.len() > 1 || row.iter().any(|field| !field.is_empty()));
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quoted_fields_keep_commas_quotes_and_line_breaks() {
        let path = Path::new("a.csv");
        let table = Csv::parse(path, "id,nouns,text\r\n1,\"['a', 'b']\",\"say \"\"hi\"\"\nnow\"\n2,,x\n\n").unwrap();
        let rows: Vec<_> = table.rows().collect();
        assert_eq!(rows.len(), 2);
        assert_eq!((rows[0].get("nouns").unwrap(), rows[0].get("text").unwrap()), ("['a', 'b']", "say \"hi\"\nnow"));
        assert_eq!((rows[1].get("id").unwrap(), rows[1].get("nouns").unwrap()), ("2", ""));
        let error = rows[0].get("verb").unwrap_err().to_string();
        assert_eq!(error, "verb is missing from a.csv; there: id, nouns, text");
        for (text, expected) in [("a,b\n1\n", "row 1: expected 2 fields, got 1"), ("a\n\"x", "does not end")] {
            let error = Csv::parse(path, text).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }
}
