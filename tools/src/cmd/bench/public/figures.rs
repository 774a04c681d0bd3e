//! Figures of the page: sections of tables. The page, the JSON and the CSV files show the same cells.

use serde::{Deserialize, Serialize};

/// A finished section.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Section {
    /// Its name on the command line.
    pub(super) key: String,
    /// Its heading.
    pub(super) title: String,
    /// What is measured and how to read it, in sentences.
    pub(super) explains: Vec<String>,
    /// Commands that repeat the figures.
    pub(super) repeats: Vec<String>,
    /// Files with what was asked and answered.
    pub(super) files: Vec<String>,
    /// Whether it has fewer positions than a full run.
    pub(super) quick: bool,
    /// When it was measured, in UTC.
    pub(super) date: String,
    /// Wall time of the measurement, s.
    pub(super) seconds: f64,
    /// Share of processor time of other processes in it.
    pub(super) others_share: Option<f64>,
    /// Its tables.
    pub(super) tables: Vec<Table>,
}

/// Where the figures of another system come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Others {
    /// From its forces, by the same code as for the own methods.
    Judged,
    /// From its own statement.
    Declared,
    /// The table has no column for another system.
    None,
}

/// A table; a column for each system or case.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Table {
    /// Name in files of figures: `SECTION.NAME`.
    pub(super) key: String,
    /// Its title.
    pub(super) title: String,
    /// How to read it, in a sentence or two.
    pub(super) explains: String,
    /// Heading of the first column.
    pub(super) of: String,
    /// Names of the columns.
    pub(super) columns: Vec<String>,
    /// Source of the columns of other systems.
    pub(super) others: Others,
    /// Columns of another criterion: they are compared with each other only.
    #[serde(default)]
    pub(super) apart: Vec<String>,
    /// Share by which a value may be off by the way it is found: values nearer than this to the best one are as good.
    #[serde(default)]
    pub(super) accuracy: f64,
    /// Its rows.
    pub(super) rows: Vec<Row>,
}

/// The value that is marked as the best one of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum Best {
    /// The smallest.
    Least,
    /// The largest.
    Most,
    /// No value.
    None,
}

/// A row of figures; `None` is an empty cell.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Row {
    /// Name in files of figures.
    pub(super) key: String,
    /// Name with its unit.
    pub(super) name: String,
    /// Which value is the best one.
    pub(super) best: Best,
    /// One value for each column.
    pub(super) values: Vec<Option<f64>>,
}

/// A figure of one system.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Judged {
    /// Name in files.
    pub(super) key: String,
    /// Name with its unit.
    pub(super) name: String,
    /// Which value of several systems is the best one.
    pub(super) best: Best,
    /// The figure; `None` if the system did not answer.
    pub(super) value: Option<f64>,
}

impl Row {
    /// A row; a value that is not finite is an empty cell.
    pub(super) fn new(key: impl Into<String>, name: impl Into<String>, best: Best, values: Vec<f64>) -> Self {
        let values = values.into_iter().map(|value| Some(value).filter(|value| value.is_finite())).collect();
        Self { key: key.into(), name: name.into(), best, values }
    }
}

impl Table {
    /// An empty table with these columns.
    pub(super) fn new(key: &str, title: &str, explains: &str, of: &str, columns: Vec<String>) -> Self {
        Self {
            key: key.into(),
            title: title.into(),
            explains: explains.into(),
            of: of.into(),
            columns,
            others: Others::None,
            apart: Vec::new(),
            accuracy: 0.0,
            rows: Vec::new(),
        }
    }

    /// A table of systems, each judged from its forces. All have the same rows.
    pub(super) fn judged(
        key: &str,
        title: &str,
        explains: &str,
        systems: Vec<(String, Vec<Judged>)>,
    ) -> Self {
        let (columns, judged): (Vec<String>, Vec<Vec<Judged>>) = systems.into_iter().unzip();
        let mut table = Self::new(key, title, explains, "measure", columns);
        table.others = Others::Judged;
        for (n, first) in judged.first().into_iter().flatten().enumerate() {
            let values = judged.iter().map(|rows| rows[n].value).collect();
            let Judged { key, name, best, .. } = first.clone();
            table.rows.push(Row { key, name, best, values });
        }
        table.without_empty_columns();
        table
    }

    /// Leaves out the columns without a value: methods that an organ does not have.
    pub(super) fn without_empty_columns(&mut self) {
        let has_value = |n: usize| self.rows.iter().any(|row| row.values[n].is_some());
        let kept: Vec<bool> = (0..self.columns.len()).map(has_value).collect();
        let mut keep = kept.iter();
        self.columns.retain(|_| keep.next().copied().unwrap_or(false));
        for row in &mut self.rows {
            let mut keep = kept.iter();
            row.values.retain(|_| keep.next().copied().unwrap_or(false));
        }
    }

    /// The column with this name.
    pub(super) fn column(&self, name: &str) -> Option<usize> {
        self.columns.iter().position(|column| column == name)
    }

    /// A value by the keys of row and column.
    pub(super) fn value(&self, row: &str, column: &str) -> Option<f64> {
        self.rows.iter().find(|r| r.key == row)?.values[self.column(column)?]
    }

    /// Adds a column whose values are known by the keys of their rows.
    pub(super) fn add_column(&mut self, name: &str, value: impl Fn(&str) -> Option<f64>) {
        self.columns.push(name.into());
        for row in &mut self.rows {
            let value = value(&row.key).filter(|value| value.is_finite());
            row.values.push(value);
        }
    }
}

/// A cell as a row of the CSV file of all figures.
#[derive(Debug, Serialize)]
pub(super) struct Cell<'f> {
    section: &'f str,
    table: &'f str,
    row: &'f str,
    column: &'f str,
    value: Option<f64>,
}

/// All cells in the order of the page.
pub(super) fn cells(sections: &[Section]) -> Vec<Cell<'_>> {
    let mut cells = Vec::new();
    for section in sections {
        for table in &section.tables {
            for row in &table.rows {
                cells.extend(table.columns.iter().zip(&row.values).map(|(column, value)| Cell {
                    section: &section.key,
                    table: &table.key,
                    row: &row.key,
                    column,
                    value: *value,
                }));
            }
        }
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_an_empty_cell_and_not_zero() {
        let mut table = Table::new("t", "", "", "", vec!["a".into(), "b".into()]);
        table.rows.push(Row::new("r", "r, mN", Best::Least, vec![1.0, f64::NAN]));
        table.add_column("c", |row| (row == "r").then_some(f64::INFINITY));
        table.add_column("d", |row| (row == "r").then_some(2.0));
        assert_eq!(table.rows[0].values, [Some(1.0), None, None, Some(2.0)]);
        assert_eq!(
            (table.value("r", "d"), table.value("r", "b"), table.value("s", "a")),
            (Some(2.0), None, None)
        );
        let section = Section { key: "s".into(), tables: vec![table], ..Section::default() };
        let text = crate::output::csv(&cells(&[section])).expect("a table");
        let text = String::from_utf8(text).expect("text");
        assert_eq!(text, "section,table,row,column,value\ns,t,r,a,1.0\ns,t,r,b,\ns,t,r,c,\ns,t,r,d,2.0\n");
    }
}
