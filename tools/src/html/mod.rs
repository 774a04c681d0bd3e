//! HTML elements of the page. Every element is closed, so that the page is also well-formed XML.

use crate::plot::{self, Style, escaped};

const STYLE: &str = include_str!("style.css");

/// The whole page with its style sheets.
pub(crate) fn page(title: &str, body: &str) -> String {
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\"/>\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\"/>\n<title>{}</title>\n\
         <style>\n{}{STYLE}</style>\n</head>\n<body>\n{body}</body>\n</html>\n",
        escaped(title),
        plot::STYLE
    )
}

/// A section with its anchor.
pub(crate) fn section(id: &str, title: &str, body: &str) -> String {
    format!("<section id=\"{id}\">\n<h2>{}</h2>\n{body}</section>\n", escaped(title))
}

/// A heading within a section.
pub(crate) fn heading(text: &str) -> String {
    format!("<h3>{}</h3>\n", escaped(text))
}

/// A paragraph.
pub(crate) fn paragraph(class: &str, text: &str) -> String {
    format!("<p class=\"{class}\">{}</p>\n", escaped(text))
}

/// Sentences that describe the result.
pub(crate) fn says(sentences: &[String]) -> String {
    if sentences.is_empty() {
        return String::new();
    }
    let items: String = sentences.iter().map(|s| format!("<li>{}</li>\n", escaped(s))).collect();
    format!("<ul class=\"says\">\n{items}</ul>\n")
}

/// An entry of a legend.
#[derive(Debug)]
pub(crate) struct Key {
    /// A small drawing.
    pub swatch: String,
    /// Its name.
    pub name: String,
}

impl Key {
    /// Entry of a line with markers.
    pub(crate) fn line(style: Style, name: impl Into<String>) -> Self {
        Self { swatch: style.swatch(), name: name.into() }
    }

    /// Entry of a bar.
    pub(crate) fn bar(style: Style, name: impl Into<String>) -> Self {
        Self { swatch: style.block(), name: name.into() }
    }
}

/// Plots in a row with a common legend.
pub(crate) fn figure(keys: &[Key], note: &str, plots: &[String]) -> String {
    let entry = |key: &Key| format!("<span>{}{}</span>", key.swatch, escaped(&key.name));
    let mut legend: String = keys.iter().map(entry).collect();
    if !note.is_empty() {
        legend += &format!("<span>{}</span>", escaped(note));
    }
    format!(
        "<figure>\n<div class=\"keys\">{legend}</div>\n<div class=\"plots\">\n{}\n</div>\n</figure>\n",
        plots.join("\n")
    )
}

/// Links to the tables.
pub(crate) fn files(names: &[&str]) -> String {
    let links: Vec<String> = names
        .iter()
        .map(|name| format!("<a href=\"{name}.csv\">{name}.csv</a>, <a href=\"{name}.json\">{name}.json</a>"))
        .collect();
    format!("<p class=\"files\">Figures: {}</p>\n", links.join("; "))
}

/// A cell of a table.
#[derive(Debug, Clone, Default)]
pub(crate) struct Cell {
    /// Its text.
    pub text: String,
    /// Whether it is the best value.
    pub best: bool,
}

impl<T: Into<String>> From<T> for Cell {
    fn from(text: T) -> Self {
        Self { text: text.into(), best: false }
    }
}

/// A table. A row whose first cell differs from that of the row before starts a group.
pub(crate) fn table(head: &[&str], rows: &[Vec<Cell>]) -> String {
    // Columns of text are left-aligned.
    let words = |n: usize| {
        rows.first().and_then(|row| row.get(n)?.text.chars().next()).is_some_and(char::is_alphabetic)
    };
    let head: String = head
        .iter()
        .enumerate()
        .map(|(n, text)| {
            format!("<th{}>{}</th>", if words(n) { " class=\"left\"" } else { "" }, escaped(text))
        })
        .collect();
    let mut body = String::new();
    let mut before: Option<&str> = None;
    for row in rows {
        let first = row.first().map(|cell| cell.text.as_str());
        let (starts, again) = (before.is_some() && before != first && repeats(rows), before == first);
        body += if starts { "<tr class=\"group\">" } else { "<tr>" };
        for (n, cell) in row.iter().enumerate() {
            let class = match (cell.best, words(n)) {
                (true, _) => " class=\"best\"",
                (false, true) => " class=\"left\"",
                (false, false) => "",
            };
            // Only the first row of a group shows its name.
            let text = if n == 0 && again { "" } else { &cell.text };
            body += &format!("<td{class}>{}</td>", escaped(text));
        }
        body += "</tr>\n";
        before = first;
    }
    format!(
        "<div class=\"scroll\"><table>\n<thead><tr>{head}</tr></thead>\n<tbody>\n{body}</tbody>\n</table></div>\n"
    )
}

/// Whether the first column groups the rows.
fn repeats(rows: &[Vec<Cell>]) -> bool {
    rows.windows(2).any(|pair| pair[0].first().map(|c| &c.text) == pair[1].first().map(|c| &c.text))
}
