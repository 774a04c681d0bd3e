//! Numbers in the text of a document: in cells of tables and in sentences.

use super::Missing;

/// A number as printed.
#[derive(Debug, Clone, PartialEq)]
pub struct Number {
    /// Its characters.
    pub text: String,
    /// Its value.
    pub value: f64,
}

impl Number {
    /// One unit of its last digit.
    pub fn step(&self) -> f64 {
        let (mantissa, exponent) = self.text.split_once('e').unwrap_or((&self.text, "0"));
        let decimals = mantissa.split_once('.').map_or(0, |(_, decimals)| decimals.len());
        10.0_f64.powi(exponent.parse().unwrap_or(0) - decimals as i32)
    }

    /// Whether a new value is the same. A tolerance above 1 is a factor, below 1 a share; with 0 all printed
    /// digits are compared.
    pub fn is_same(&self, new: f64, tolerance: f64) -> bool {
        let off = (new - self.value).abs();
        if tolerance > 1.0 {
            let ratio = new / self.value;
            return ratio >= 1.0 / tolerance && ratio <= tolerance;
        }
        off <= tolerance * self.value.abs() + 0.500_000_1 * self.step()
    }
}

/// The number at the beginning of the text: digits, perhaps in groups of three, a point, a power of ten.
pub(super) fn number(text: &str) -> Option<Number> {
    let bytes = text.as_bytes();
    let digits =
        |from: usize| bytes[from.min(bytes.len())..].iter().take_while(|c| c.is_ascii_digit()).count();
    let mut end = usize::from(bytes.first() == Some(&b'-'));
    let whole = digits(end);
    end += whole;
    while whole > 0 && bytes.get(end) == Some(&b',') && digits(end + 1) >= 3 {
        end += 4;
    }
    if bytes.get(end) == Some(&b'.') && digits(end + 1) > 0 {
        end += 1 + digits(end + 1);
    } else if whole == 0 {
        return None;
    }
    let sign = end + 1;
    if bytes.get(end) == Some(&b'e') {
        let power = sign + usize::from(matches!(bytes.get(sign), Some(b'-' | b'+')));
        end = if digits(power) > 0 { power + digits(power) } else { end };
    }
    let text = text[..end].to_owned();
    let value = text.replace(',', "").parse().ok()?;
    Some(Number { text, value })
}

/// All numbers of a text that are not parts of a word.
pub(super) fn numbers(text: &str) -> Vec<Number> {
    let (mut found, mut at) = (Vec::new(), 0);
    while let Some(character) = text[at..].chars().next() {
        let before = text[..at].chars().next_back();
        let is_inside = before.is_some_and(|c| c.is_alphanumeric() || matches!(c, '_' | '.' | ','));
        match number(&text[at..]).filter(|_| !is_inside) {
            Some(number) => {
                at += number.text.len();
                found.push(number);
            }
            None => at += character.len_utf8(),
        }
    }
    found
}

/// A heading without its mark.
pub fn without_mark(heading: &str) -> &str {
    heading.trim_start_matches('#').trim()
}

/// The text below a heading up to the next one.
///
/// # Errors
///
/// If there is no such heading.
pub fn section_of<'t>(text: &'t str, heading: &str) -> Result<&'t str, Missing> {
    let (mut start, mut is_code, mut at) = (None, false, 0);
    for line in text.split_inclusive('\n') {
        is_code ^= line.starts_with("```");
        if line.starts_with('#') && !is_code {
            if let Some(start) = start {
                return Ok(&text[start..at]);
            }
            if without_mark(line) == heading {
                start = Some(at + line.len());
            }
        }
        at += line.len();
    }
    start.map(|start| &text[start..]).ok_or_else(|| format!("no heading `{heading}`"))
}

/// A table; a leading cell that is empty has the label of the row above.
pub(super) struct Table {
    header: Vec<Vec<String>>,
    rows: Vec<Vec<String>>,
    labels: Vec<Vec<String>>,
}

impl Table {
    fn of(lines: &[&str]) -> Self {
        let cells = |line: &&str| -> Vec<String> {
            let line = line.trim().trim_start_matches('|');
            let line = line.strip_suffix('|').unwrap_or(line);
            line.split('|').map(|cell| cell.trim().to_owned()).collect()
        };
        let rows: Vec<Vec<String>> = lines[2..].iter().map(cells).collect();
        let mut labels: Vec<Vec<String>> = Vec::new();
        for row in &rows {
            let mut is_leading = true;
            let label = |(k, cell): (usize, &String)| {
                is_leading &= cell.is_empty();
                let above = labels.last().and_then(|above: &Vec<String>| above.get(k)).filter(|_| is_leading);
                above.unwrap_or(cell).clone()
            };
            let of_row = row.iter().enumerate().map(label).collect();
            labels.push(of_row);
        }
        Self { header: cells(&lines[0]).into_iter().map(|cell| vec![cell]).collect(), rows, labels }
    }

    /// The numbers of a cell.
    pub(super) fn cell(&self, row: &str, column: &str) -> Result<Vec<Number>, Missing> {
        let line = &self.rows[one_of(row, &self.labels)?];
        Ok(numbers(line.get(one_of(column, &self.header)?).map_or("", String::as_str)))
    }

    fn has(&self, rows: &[String], columns: &[String]) -> Result<(), Missing> {
        rows.iter().try_for_each(|row| one_of(row, &self.labels).map(drop))?;
        columns.iter().try_for_each(|column| one_of(column, &self.header).map(drop))
    }
}

/// The only index whose labels are those of `name`, which are separated by ` | `, or begin with them.
fn one_of(name: &str, labels: &[Vec<String>]) -> Result<usize, Missing> {
    let wanted: Vec<&str> = name.split(" | ").collect();
    let those = |fits: fn(&str, &str) -> bool| -> Vec<usize> {
        let is_it =
            |of: &[String]| wanted.len() <= of.len() && of.iter().zip(&wanted).all(|(of, w)| fits(of, w));
        (0..labels.len()).filter(|k| is_it(&labels[*k])).collect()
    };
    let equal = those(|of, wanted| of == wanted);
    let found = if equal.is_empty() { those(|of, wanted| of.starts_with(wanted)) } else { equal };
    match found[..] {
        [one] => Ok(one),
        _ => Err(format!("{} of `{name}`", found.len())),
    }
}

/// The only table that has all rows and columns, and this label above its rows.
pub(super) fn table(
    section: &str,
    rows: &[String],
    columns: &[String],
    corner: Option<&str>,
) -> Result<Table, Missing> {
    let (mut tables, mut lines) = (Vec::new(), Vec::new());
    for line in section.lines().chain([""]) {
        if line.starts_with('|') {
            lines.push(line);
        } else if lines.len() > 2 {
            tables.push(Table::of(&lines));
            lines.clear();
        } else {
            lines.clear();
        }
    }
    let all = tables.len();
    let mut said = format!("{all} tables");
    let is_it = |table: &Table| corner.is_none_or(|corner| table.header[0][0] == corner);
    tables.retain(|table| is_it(table) && table.has(rows, columns).map_err(|missing| said = missing).is_ok());
    match (tables.pop(), tables.len()) {
        (Some(table), 0) => Ok(table),
        (_, others) => Err(format!("{others} more of {all} tables have all rows and columns: {said}")),
    }
}

/// The numbers at the places `{}` of the first text that is like `words`. `{_}` is a number that is not wanted,
/// `...` any text, white space any white space.
pub(super) fn find(text: &str, words: &str) -> Result<Vec<Number>, Missing> {
    let joined = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
    let (text, like) = (joined(text), joined(words));
    let starts = text.char_indices().map(|(at, _)| at);
    let mut found = starts.filter_map(|at| matched(&text[at..], &like));
    found.next().ok_or_else(|| format!("no text `{words}`"))
}

fn matched(text: &str, like: &str) -> Option<Vec<Number>> {
    if like.is_empty() {
        return Some(Vec::new());
    }
    if let Some(rest) = like.trim_start().strip_prefix("...") {
        let rest = rest.trim_start();
        return text.char_indices().find_map(|(at, _)| matched(&text[at..], rest));
    }
    for (mark, is_wanted) in [("{}", true), ("{_}", false)] {
        if let Some(rest) = like.strip_prefix(mark) {
            let first = number(text)?;
            let others = matched(&text[first.text.len()..], rest)?;
            return Some(is_wanted.then_some(first).into_iter().chain(others).collect());
        }
    }
    let first = like.chars().next()?;
    matched(text.strip_prefix(first)?, &like[first.len_utf8()..])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_those_that_a_reader_sees() {
        let texts = |text| numbers(text).into_iter().map(|n| n.text).collect::<Vec<_>>();
        assert_eq!(texts("39.4 / .85 / 1,234.5"), ["39.4", ".85", "1,234.5"]);
        assert_eq!(
            texts("553 - 10,600; P1/P1 x2 (7.3x), -1.06 %, 7e-16"),
            ["553", "10,600", "7.3", "-1.06", "7e-16"]
        );
        assert!(number("1,795").is_some_and(|n| n.value == 1795.0 && n.step() == 1.0));
    }

    #[test]
    fn the_printed_digits_are_compared() {
        let printed = number(".094").expect("a number");
        assert!(printed.is_same(0.0941, 0.0) && !printed.is_same(0.0946, 0.0));
        assert!(printed.is_same(0.18, 2.0) && !printed.is_same(0.19, 2.0) && !printed.is_same(-0.094, 2.0));
        assert!(printed.is_same(0.1, 0.1) && !printed.is_same(0.12, 0.1));
    }

    #[test]
    fn a_cell_is_found_by_its_labels() {
        let section =
            "| body | grid | s |\n|---|---|---|\n| MR | 514 | 1 |\n| | 1,418 | 2 (3 %) |\n\nWithin\n4 mN.\n";
        let at = |row: &str, column: &str| {
            let own = |text: &str| [String::from(text)];
            let found = table(section, &own(row), &own(column), Some("body"))?.cell(row, column)?;
            Ok::<_, Missing>(found.into_iter().map(|n| n.value).collect::<Vec<_>>())
        };
        assert_eq!(at("MR | 1,418", "s"), Ok(vec![2.0, 3.0]));
        assert!(at("MR", "s").is_err() && at("StVK", "s").is_err() && at("MR | 514", "t").is_err());
        assert_eq!(find(section, "Within {} mN").map(|n| n[0].value), Ok(4.0));
        assert_eq!(
            find(section, "MR | {_} ... | {} ({} %)").map(|n| (n[0].value, n[1].value)),
            Ok((2.0, 3.0))
        );
        assert!(find(section, "Within {} N").is_err());
    }
}
