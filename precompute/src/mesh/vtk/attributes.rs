//! Attributes of legacy files: `FIELD` arrays before and after the cells, and the data of points and cells.

use super::{Cursor, DAMAGED};
use crate::error::InputError;
use crate::mesh::cell_data::CellArray;
use crate::mesh::lines::excerpt;

/// What the attributes belong to, and its number.
#[derive(Clone, Copy)]
enum Owner {
    Points(usize),
    Cells(usize),
}

impl Cursor<'_> {
    /// The arrays of the cells, up to the end of the file.
    pub(super) fn cell_arrays(&mut self, cells: usize) -> Result<Vec<CellArray>, InputError> {
        let (mut arrays, mut owner) = (Vec::new(), None);
        while let Ok(header) = self.line("an attribute") {
            let words: Vec<&str> = header.split_whitespace().collect();
            let keyword = words[0].to_uppercase();
            match (keyword.as_str(), &words[1..], owner) {
                ("POINT_DATA", [n], _) => owner = Some(Owner::Points(self.count(n)?)),
                ("CELL_DATA", [n], _) => {
                    let n = self.count(n)?;
                    if n != cells {
                        return Err(self.error(format!("CELL_DATA of {n} cells, of {cells}"), DAMAGED));
                    }
                    owner = Some(Owner::Cells(n));
                }
                ("METADATA", ..) => self.skip_metadata(),
                ("FIELD", [_, n], Some(Owner::Cells(_))) => self.fields(n, |array| arrays.push(array))?,
                ("FIELD", [_, n], _) => self.fields(n, |_| {})?,
                (_, rest, Some(of)) => {
                    let array = self.attribute(&header, &keyword, rest, of)?;
                    arrays.extend(array.filter(|_| matches!(of, Owner::Cells(_))));
                }
                _ => return Err(self.unknown(&header)),
            }
        }
        // Of a field with too few numbers of cells the array would end too soon.
        match arrays.iter().find(|array| array.numbers.len() != cells.saturating_mul(array.components)) {
            None => Ok(arrays),
            Some(array) => {
                let what = format!("the array \"{}\" has no number for every cell", array.name);
                Err(self.error(what, DAMAGED))
            }
        }
    }

    /// An attribute that is no field; `None` if it has no numbers of points or cells.
    fn attribute(
        &mut self,
        header: &str,
        keyword: &str,
        words: &[&str],
        owner: Owner,
    ) -> Result<Option<CellArray>, InputError> {
        let (Owner::Points(n) | Owner::Cells(n)) = owner;
        let byte = if self.binary { "unsigned_char" } else { "float" };
        let (name, components, scalar) = match (keyword, words) {
            ("SCALARS", [name, scalar]) => (name, 1, *scalar),
            ("SCALARS", [name, scalar, components]) => (name, self.count(components)?, *scalar),
            ("VECTORS" | "NORMALS", [name, scalar]) => (name, 3, *scalar),
            ("TENSORS", [name, scalar]) => (name, 9, *scalar),
            ("TENSORS6", [name, scalar]) => (name, 6, *scalar),
            ("GLOBAL_IDS" | "PEDIGREE_IDS" | "EDGE_FLAGS", [name, scalar]) => (name, 1, *scalar),
            ("TEXTURE_COORDINATES", [name, components, scalar]) => (name, self.count(components)?, *scalar),
            ("COLOR_SCALARS", [name, components]) => (name, self.count(components)?, byte),
            ("LOOKUP_TABLE", [_, entries]) => {
                let entries = self.count(entries)?;
                return self.numbers(entries.saturating_mul(4), byte, "a colour").map(|_| None);
            }
            _ => return Err(self.unknown(header)),
        };
        if keyword == "SCALARS" {
            // Some writers leave out the name of the table of colours.
            let start = *self;
            let next = self.line("LOOKUP_TABLE")?;
            if !next.to_uppercase().starts_with("LOOKUP_TABLE") {
                *self = start;
            }
        }
        let numbers = self.numbers(n.saturating_mul(components), scalar, "a value")?;
        Ok(Some(CellArray { name: decoded(name), components, numbers }))
    }

    fn unknown(&self, header: &str) -> InputError {
        let what = format!("the attribute `{}` is not read", excerpt(header));
        self.error(what, "save the file as .vtu, or without this attribute")
    }

    /// The arrays of a FIELD: name, components, tuples and type, then the data. Strings are skipped. METADATA
    /// of the preceding array can come first.
    pub(super) fn fields(&mut self, n: &str, mut use_array: impl FnMut(CellArray)) -> Result<(), InputError> {
        for _ in 0..self.count(n)? {
            let mut header = self.line("a field array")?;
            while header.to_uppercase().starts_with("METADATA") {
                self.skip_metadata();
                header = self.line("a field array")?;
            }
            let [name, components, tuples, scalar] = header.split_whitespace().collect::<Vec<_>>()[..] else {
                let what = format!("expected a field array, found `{}`", excerpt(&header));
                return Err(self.error(what, DAMAGED));
            };
            let components = self.count(components)?;
            let n = components.saturating_mul(self.count(tuples)?);
            if scalar == "string" {
                (0..n).try_for_each(|_| self.skip_string())?;
            } else {
                let numbers = self.numbers(n, scalar, "a field value")?;
                use_array(CellArray { name: decoded(name), components, numbers });
            }
        }
        Ok(())
    }

    /// Skips the lines up to an empty one.
    pub(super) fn skip_metadata(&mut self) {
        while !self.raw_line().trim().is_empty() {}
    }

    /// Skips a string: a line of text; in binary files the length in 6, 14, 30 or 62 bits (the two highest
    /// bits give its size), then the bytes.
    fn skip_string(&mut self) -> Result<(), InputError> {
        if !self.binary {
            return self.line("a string").map(drop);
        }
        let rest = &self.bytes[self.at..];
        let size = rest.first().map_or(1, |first| 1usize << (3 - (first >> 6)));
        let length = rest.get(..size).map(|bytes| {
            let number = bytes.iter().fold(0u64, |number, &byte| number << 8 | u64::from(byte));
            number & (u64::MAX >> (66 - 8 * size))
        });
        let end = length.and_then(|length| usize::try_from(length).ok()?.checked_add(size));
        let Some(end) = end.filter(|&end| end <= rest.len()) else {
            return Err(self.error("the file ends inside a string", DAMAGED));
        };
        self.advance(end);
        Ok(())
    }
}

/// A name without its escapes: VTK writes a blank in a name as `%20`.
fn decoded(name: &str) -> String {
    let mut bytes = Vec::new();
    let mut rest = name.as_bytes();
    while let Some((&first, after)) = rest.split_first() {
        let code = after.get(..2).and_then(|code| std::str::from_utf8(code).ok());
        match code.and_then(|code| u8::from_str_radix(code, 16).ok()).filter(|_| first == b'%') {
            Some(byte) => {
                bytes.push(byte);
                rest = &after[2..];
            }
            None => {
                bytes.push(first);
                rest = after;
            }
        }
    }
    String::from_utf8_lossy(&bytes).into_owned()
}
