//! The error of bad input: one line with the file, the line, the problem and the fix.
//!
//! Every error in a user's input (a scene, a mesh, a set of nodes) is an [`InputError`]. The command line
//! prints it and exits with code 2. A solve that does not converge is no input error: the solver stores it as
//! a configuration tag.

use std::fmt;
use std::path::{Path, PathBuf};

/// A problem in an input, its position and its fix.
///
/// `Display` is one line, `file:line: what; fix`. Line breaks inside a part (a TOML excerpt, a file name)
/// become blanks, because scripts read the error line by line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct InputError {
    /// The file with the problem.
    pub file: PathBuf,
    /// 1-based line in `file`, if the format has lines and the problem has a position.
    pub line: Option<usize>,
    /// The problem; names the key, node or element.
    pub what: String,
    /// What the user should do.
    pub fix: String,
}

impl InputError {
    /// An error of a whole file, without a line.
    pub(crate) fn new(file: &Path, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { file: file.to_path_buf(), line: None, what: what.into(), fix: fix.into() }
    }

    /// An error at a 1-based line of a file.
    pub(crate) fn at(file: &Path, line: usize, what: impl Into<String>, fix: impl Into<String>) -> Self {
        Self { line: Some(line), ..Self::new(file, what, fix) }
    }

    /// A file that cannot be opened or read; contains the operating system's message.
    pub(crate) fn unreadable(file: &Path, error: &std::io::Error) -> Self {
        let fix = match error.kind() {
            std::io::ErrorKind::NotFound => "check the path",
            std::io::ErrorKind::PermissionDenied => "make the file readable for this user",
            _ => "check that it is a readable file",
        };
        Self::new(file, format!("cannot read the file ({error})"), fix)
    }
}

impl fmt::Display for InputError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut text = self.file.display().to_string();
        if let Some(line) = self.line {
            text.push_str(&format!(":{line}"));
        }
        text.push_str(&format!(": {}; {}", self.what, self.fix));
        f.write_str(&text.replace(['\n', '\r'], " "))
    }
}

impl std::error::Error for InputError {}

/// A count with its noun: `1 node`, `2 nodes`.
pub(crate) fn count(n: usize, noun: &str) -> String {
    if n == 1 { format!("1 {noun}") } else { format!("{n} {noun}s") }
}

/// The word of `known` that `word` most likely misspells, or `None` if no word is close enough.
///
/// The measure is the edit distance (insert, delete, replace). The largest accepted distance is a third of
/// the longer word's letters; the first of equal candidates is returned. A word that only lacks its unit
/// (`radius` for `radius_m`) is always accepted.
pub(crate) fn nearest_word<'k>(word: &str, known: impl IntoIterator<Item = &'k str>) -> Option<&'k str> {
    known
        .into_iter()
        .filter_map(|candidate| {
            let distance = strsim::levenshtein(word, candidate);
            let longer = word.chars().count().max(candidate.chars().count());
            let unit_lost = !word.is_empty() && candidate.starts_with(&format!("{word}_"));
            (unit_lost || 3 * distance <= longer).then_some((distance, candidate))
        })
        .min_by_key(|&(distance, _)| distance)
        .map(|(_, candidate)| candidate)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn display_is_one_line_with_file_line_what_and_fix() {
        let error = InputError::at(Path::new("dir/liver.toml"), 7, "unknown\nkey `x`", "remove it");
        assert_eq!(error.to_string(), "dir/liver.toml:7: unknown key `x`; remove it");
        let whole = InputError::new(Path::new("a\r\nb.msh"), "empty", "save it again");
        assert_eq!(whole.to_string(), "a  b.msh: empty; save it again");
    }

    #[test]
    fn suggestions_are_near_or_none() {
        let known = ["radius_m", "spacing_m", "points"];
        assert_eq!(nearest_word("radius", known), Some("radius_m"));
        assert_eq!(nearest_word("spaceing_m", known), Some("spacing_m"));
        assert_eq!(nearest_word("colour", known), None);
        assert_eq!(nearest_word("", known), None);
    }
}
