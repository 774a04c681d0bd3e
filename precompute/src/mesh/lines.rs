//! Reads a text file line by line and keeps the line number for errors.
//!
//! All writers put one record on a line. The readers therefore read lines and not a stream of words: an error
//! about a missing number then names the right line.

use std::path::Path;
use std::str::{FromStr, SplitWhitespace};

use crate::error::{InputError, count};

/// Non-empty lines of a text without comments, numbered from 1.
pub(crate) struct Lines<'a> {
    file: &'a Path,
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    comment: Option<char>,
    last: usize,
}

impl<'a> Lines<'a> {
    /// `comment` is the character that starts a comment up to the end of the line, if the format has
    /// comments.
    pub(crate) fn new(file: &'a Path, text: &'a str, comment: Option<char>) -> Self {
        Self { file, lines: text.lines().enumerate(), comment, last: 0 }
    }

    /// The next non-empty line.
    pub(crate) fn next_line(&mut self) -> Option<Line<'a>> {
        for (index, text) in self.lines.by_ref() {
            self.last = index + 1;
            let text =
                self.comment.and_then(|c| text.split_once(c)).map_or(text, |(before, _)| before).trim();
            if !text.is_empty() {
                return Some(Line { file: self.file, number: Some(index + 1), text });
            }
        }
        None
    }

    /// The next line; an error at the end of the file names `wanted`.
    pub(crate) fn expect_line(&mut self, wanted: &str) -> Result<Line<'a>, InputError> {
        let last = self.last.max(1);
        self.next_line().ok_or_else(|| {
            InputError::at(
                self.file,
                last,
                format!("the file ends where {wanted} should follow"),
                "it is truncated: export or copy it again",
            )
        })
    }
}

/// One line of a file.
#[derive(Clone, Copy)]
pub(crate) struct Line<'a> {
    file: &'a Path,
    /// 1-based line number; `None` in a binary file.
    pub(crate) number: Option<usize>,
    /// Without surrounding blanks and comments; never empty.
    pub(crate) text: &'a str,
}

impl<'a> Line<'a> {
    /// A line of a file that has other content, too.
    pub(crate) fn new(file: &'a Path, number: Option<usize>, text: &'a str) -> Self {
        Self { file, number, text }
    }

    /// An error at this line.
    pub(crate) fn error(&self, what: impl Into<String>, fix: impl Into<String>) -> InputError {
        InputError { line: self.number, ..InputError::new(self.file, what, fix) }
    }

    /// Iterates over the words of the line.
    pub(crate) fn words(self) -> Words<'a> {
        Words { line: self, words: self.text.split_whitespace() }
    }
}

/// The words of one line.
pub(crate) struct Words<'a> {
    pub(crate) line: Line<'a>,
    words: SplitWhitespace<'a>,
}

pub(super) const DAMAGED: &str = "the file is damaged or its counts do not match: export it again";

impl Words<'_> {
    /// The next word as a number; `wanted` names it in the error.
    pub(crate) fn number<T: FromStr>(&mut self, wanted: &str) -> Result<T, InputError> {
        let Some(word) = self.words.next() else {
            let what = format!("expected {wanted} after `{}`", excerpt(self.line.text));
            return Err(self.line.error(what, DAMAGED));
        };
        word.parse()
            .map_err(|_| self.line.error(format!("expected {wanted}, found `{}`", excerpt(word)), DAMAGED))
    }

    /// The next three numbers as coordinates.
    pub(crate) fn position(&mut self) -> Result<[f64; 3], InputError> {
        Ok([self.number("x")?, self.number("y")?, self.number("z")?])
    }

    /// The rest of the line as numbers; an error unless there are `n` of them.
    pub(crate) fn exactly<T: FromStr>(&mut self, n: usize, wanted: &str) -> Result<Vec<T>, InputError> {
        let numbers = (0..n).map(|_| self.number(wanted)).collect::<Result<_, _>>()?;
        self.end()?;
        Ok(numbers)
    }

    /// An error if words are left on the line.
    pub(crate) fn end(&mut self) -> Result<(), InputError> {
        match self.words.by_ref().count() {
            0 => Ok(()),
            more => Err(self.line.error(format!("{} too many on the line", count(more, "value")), DAMAGED)),
        }
    }

    /// Number of words left.
    pub(crate) fn left(&self) -> usize {
        self.words.clone().count()
    }
}

/// Start of a text for a message, without control characters.
pub(super) fn excerpt(text: &str) -> String {
    const MAX_EXCERPT: usize = 40;
    let clean: String =
        text.chars().map(|c| if c.is_control() { '?' } else { c }).take(MAX_EXCERPT).collect();
    if text.chars().nth(MAX_EXCERPT).is_some() { clean + "..." } else { clean }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_skip_blanks_and_comments_and_keep_their_numbers() {
        let mut lines = Lines::new(Path::new("f"), "a\r\n\n  # all remark\n b c # tail\n", Some('#'));
        let first = lines.expect_line("a").expect("there");
        assert_eq!((first.number, first.text), (Some(1), "a"));
        let second = lines.expect_line("b").expect("there");
        assert_eq!((second.number, second.text), (Some(4), "b c"));
        let error = lines.expect_line("the end").err().expect("nothing left");
        assert_eq!(
            error.to_string(),
            "f:4: the file ends where the end should follow; it is truncated: export or copy it again"
        );
    }

    #[test]
    fn words_name_what_they_wanted() {
        let line = Line { file: Path::new("f"), number: Some(3), text: "1 x 3" };
        let mut words = line.words();
        assert_eq!(words.number::<u32>("a tag"), Ok(1));
        let error = words.number::<f64>("x").unwrap_err();
        assert!(error.to_string().starts_with("f:3: expected x, found `x`; "), "{error}");
        assert!(words.end().unwrap_err().what.contains("1 value too many"));
        let short = line.words().exactly::<char>(4, "a letter").unwrap_err();
        assert!(short.what.contains("expected a letter after `1 x 3`"), "{short}");
        assert_eq!(excerpt(&"\u{1}".repeat(50)), "?".repeat(40) + "...");
    }
}
