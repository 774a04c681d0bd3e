//! Which command makes which number of the documents: the entries of docs/figures/*.toml, which docs/figures/README.md
//! describes. `docs/remake` reads them in the same way.

mod outputs;
mod places;

use std::fs;
use std::path::Path;

use toml::{Table, Value};

use crate::documents;
pub use places::{Number, section_of, without_mark};

/// What an entry names and what is not there.
pub type Missing = String;

/// One entry: a command, and the numbers and pictures that it makes.
#[derive(Debug, Clone)]
pub struct Figure {
    /// Its name for `docs/remake`.
    pub name: String,
    /// Document, relative to the root.
    pub file: String,
    /// Heading without its mark.
    pub heading: String,
    /// Commands of a shell.
    pub run: String,
    /// About how long they take on two cores.
    pub seconds: Option<f64>,
    /// Whether a test runs them: fast, with the same numbers in each run.
    pub test: bool,
    /// Why nothing is compared.
    pub why: Option<String>,
    /// Pictures: path relative to the root.
    pub pictures: Vec<String>,
    /// Numbers.
    pub places: Vec<Place>,
}

/// The numbers of one cell or sentence, and how their new values are read.
#[derive(Debug, Clone)]
pub struct Place {
    /// Document, relative to the root.
    pub file: String,
    /// Heading without its mark.
    pub heading: String,
    /// Where below the heading.
    pub spot: Spot,
    how: Table,
}

/// Where below a heading.
#[derive(Debug, Clone)]
pub enum Spot {
    /// A cell of the only table that has all these rows and columns, and the label `corner` above its rows if the
    /// entry has one.
    Cell {
        /// Label of its row; those of several cells are separated by ` | `.
        row: String,
        /// Label of its column.
        column: String,
        /// Labels of all rows of the entry.
        rows: Vec<String>,
        /// Labels of all columns of the entry.
        columns: Vec<String>,
    },
    /// A sentence, with `{}` for each number.
    Sentence(String),
}

/// All entries.
///
/// # Errors
///
/// If a file has an unknown or a missing key.
pub fn all() -> Result<Vec<Figure>, Missing> {
    let mut found = Vec::new();
    let folder = documents::root().join("docs/figures");
    let entries = fs::read_dir(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let mut paths: Vec<_> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    paths.sort();
    for path in paths.iter().filter(|path| path.extension().is_some_and(|of| of == "toml")) {
        let of_file = |error: String| format!("{}: {error}", path.display());
        let text = fs::read_to_string(path).map_err(|error| of_file(error.to_string()))?;
        let content: Table = text.parse().map_err(|error: toml::de::Error| of_file(error.to_string()))?;
        let file = content.get("file").and_then(Value::as_str).unwrap_or_default();
        for entry in tables(&content, "figure") {
            found.push(Figure::of(entry, file).map_err(of_file)?);
        }
    }
    Ok(found)
}

fn tables<'t>(of: &'t Table, key: &str) -> impl Iterator<Item = &'t Table> + use<'t> {
    of.get(key).and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_table)
}

fn string(of: &Table, key: &str) -> Option<String> {
    of.get(key).and_then(Value::as_str).map(String::from)
}

fn float(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

impl Figure {
    fn of(entry: &Table, file: &str) -> Result<Self, Missing> {
        let name = string(entry, "name").ok_or("an entry without `name`")?;
        const KEYS: [&str; 11] =
            ["name", "file", "heading", "run", "seconds", "test", "why", "picture", "table", "text", "note"];
        if let Some(unknown) = entry.keys().find(|key| !KEYS.contains(&key.as_str())) {
            return Err(format!("{name}: unknown key `{unknown}`"));
        }
        let file = string(entry, "file").unwrap_or_else(|| file.into());
        let heading = string(entry, "heading").ok_or_else(|| format!("{name}: no `heading`"))?;
        let mut places = Vec::new();
        for table in tables(entry, "table") {
            places.extend(cells(table, &file, &heading).map_err(|missing| format!("{name}: {missing}"))?);
        }
        for text in tables(entry, "text") {
            let words = string(text, "words").ok_or_else(|| format!("{name}: a text without `words`"))?;
            places.push(Place::of(text, text.clone(), &file, &heading, Spot::Sentence(words)));
        }
        let pictures = tables(entry, "picture").filter_map(|picture| string(picture, "path")).collect();
        Ok(Self {
            run: string(entry, "run").unwrap_or_default(),
            seconds: entry.get("seconds").and_then(float),
            test: entry.get("test").and_then(Value::as_bool).unwrap_or(false),
            why: string(entry, "why"),
            name,
            file,
            heading,
            pictures,
            places,
        })
    }
}

/// The cells of a table's entry: each of its rows with each of its columns.
fn cells(table: &Table, file: &str, heading: &str) -> Result<Vec<Place>, Missing> {
    let columns = table.get("columns").and_then(Value::as_table).ok_or("a table without `columns`")?;
    let rows: Vec<(String, String)> = match table.get("rows").ok_or("a table without `rows`")? {
        Value::Table(rows) => {
            rows.iter().filter_map(|(k, v)| Some((k.clone(), v.as_str()?.into()))).collect()
        }
        Value::Array(rows) => rows.iter().filter_map(Value::as_str).map(|k| (k.into(), k.into())).collect(),
        _ => return Err("`rows` is neither a table nor a list".into()),
    };
    let labels: Vec<String> = rows.iter().map(|(label, _)| label.clone()).collect();
    let mut found = Vec::new();
    for (row, of_row) in &rows {
        for (column, value) in columns {
            let (mut how, key) = (table.clone(), value.as_str().unwrap_or_default());
            how.extend(value.as_table().cloned().unwrap_or_default());
            let how = how.into_iter().map(|(k, value)| (k, filled(value, of_row, key))).collect();
            let spot = Spot::Cell {
                row: row.clone(),
                column: column.clone(),
                rows: labels.clone(),
                columns: columns.keys().cloned().collect(),
            };
            found.push(Place::of(table, how, file, heading, spot));
        }
    }
    Ok(found)
}

fn filled(value: Value, row: &str, column: &str) -> Value {
    match value {
        Value::String(text) => text.replace("{row}", row).replace("{column}", column).into(),
        Value::Array(of) => of.into_iter().map(|item| filled(item, row, column)).collect::<Vec<_>>().into(),
        other => other,
    }
}

impl Place {
    fn of(own: &Table, how: Table, file: &str, heading: &str, spot: Spot) -> Self {
        let file = string(own, "file").unwrap_or_else(|| file.into());
        let heading = string(own, "heading").unwrap_or_else(|| heading.into());
        Self { file, heading, spot, how }
    }

    /// Where it is, for messages.
    pub fn what(&self) -> String {
        match &self.spot {
            Spot::Cell { row, column, .. } => format!("{}, {}: {row}, {column}", self.file, self.heading),
            Spot::Sentence(words) => format!("{}, {}: {words}", self.file, self.heading),
        }
    }

    fn paths(&self) -> Vec<&str> {
        match self.how.get("at") {
            Some(Value::String(one)) => vec![one],
            Some(Value::Array(all)) => all.iter().filter_map(Value::as_str).collect(),
            _ => Vec::new(),
        }
    }

    /// How many numbers the entry expects.
    pub fn expected(&self) -> usize {
        match self.how.get("find").and_then(Value::as_str) {
            Some(words) => words.matches("{}").count(),
            None => self.paths().len(),
        }
    }

    /// The numbers as the document has them.
    ///
    /// # Errors
    ///
    /// If they are not where the entry says.
    pub fn printed(&self) -> Result<Vec<Number>, Missing> {
        let text =
            fs::read_to_string(documents::root().join(&self.file)).map_err(|error| error.to_string())?;
        let section = section_of(&text, &self.heading)?;
        let found = match &self.spot {
            Spot::Cell { row, column, rows, columns } => {
                let corner = self.how.get("corner").and_then(Value::as_str);
                places::table(section, rows, columns, corner)?.cell(row, column)?
            }
            Spot::Sentence(words) => places::find(section, words)?,
        };
        if found.len() == self.expected() {
            Ok(found)
        } else {
            Err(format!("{} numbers, and the entry has {}", found.len(), self.expected()))
        }
    }

    /// The value of `key` for each number.
    fn each(&self, key: &str, otherwise: f64) -> Vec<f64> {
        match self.how.get(key) {
            Some(Value::Array(all)) => all.iter().filter_map(float).collect(),
            other => vec![other.and_then(float).unwrap_or(otherwise); self.expected()],
        }
    }

    /// What differs between the document and the files in this folder.
    ///
    /// # Errors
    ///
    /// If a number is missing in either.
    pub fn differences(&self, folder: &Path) -> Result<Vec<String>, Missing> {
        let file = string(&self.how, "from").unwrap_or_else(|| "output".into());
        let new: Vec<Option<f64>> = match string(&self.how, "find") {
            Some(words) => outputs::find(&folder.join(file), &words)?.into_iter().map(Some).collect(),
            None => {
                let one =
                    |path: &&str| (*path != "-").then(|| outputs::value(folder, &file, path)).transpose();
                self.paths().iter().map(one).collect::<Result<_, _>>()?
            }
        };
        let (scales, tolerances) = (self.each("scale", 1.0), self.each("tolerance", 0.0));
        let mut found = Vec::new();
        for (((old, new), scale), tolerance) in self.printed()?.iter().zip(new).zip(scales).zip(tolerances) {
            let Some(new) = new.map(|new| new * scale) else { continue };
            if !old.is_same(new, tolerance) {
                found.push(format!("{}: {} -> {new}", self.what(), old.text));
            }
        }
        Ok(found)
    }
}
