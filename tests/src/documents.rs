//! Code blocks of the Markdown documents, for tests that run what a reader would type.
//!
//! A block that opens with ```` ```sh ```` contains commands that run as printed, in order, in a clone. The
//! mark `no-run` is for commands that need hardware, a display, administrator rights or minutes.

use std::fs;
use std::path::{Path, PathBuf};

/// One fenced block of a document.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Block {
    /// First word after the fence; empty if there is none.
    pub language: String,
    /// Whether `no-run` follows it.
    pub no_run: bool,
    /// 1-based line of the fence.
    pub line: usize,
    /// The lines between the fences, without the indentation of the fence.
    pub text: String,
}

/// One command of an `sh` block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Command {
    /// 1-based line in the document.
    pub line: usize,
    /// The command without its comment.
    pub text: String,
    /// Exit code that the comment states (`# exit code 1`), or 0.
    pub exit_code: i32,
}

/// The repository's root.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// README.md and every document in docs/, by path relative to the root.
///
/// # Panics
///
/// If one cannot be read.
pub fn all() -> Vec<(String, String)> {
    let mut names: Vec<String> = ["README.md", "assets/README.md"].map(String::from).into();
    let entries = fs::read_dir(root().join("docs")).expect("docs/ is there");
    let documents = entries.map(|entry| entry.expect("readable").file_name().into_string().expect("UTF-8"));
    names.extend(documents.filter(|name| name.ends_with(".md")).map(|name| format!("docs/{name}")));
    names.sort();
    let read = |name: String| {
        let text = fs::read_to_string(root().join(&name)).unwrap_or_else(|error| panic!("{name}: {error}"));
        (name, text)
    };
    names.into_iter().map(read).collect()
}

/// The fenced blocks of a document, in order. A block that does not end is cut at the end of the document.
pub fn blocks(document: &str) -> Vec<Block> {
    let mut blocks = Vec::new();
    let mut open: Option<(Block, usize)> = None;
    for (line, text) in (1..).zip(document.lines()) {
        let indentation = text.len() - text.trim_start().len();
        let Some(information) = text.trim_start().strip_prefix("```") else {
            if let Some((block, indentation)) = &mut open {
                block.text.push_str(text.get(*indentation..).unwrap_or_default());
                block.text.push('\n');
            }
            continue;
        };
        if let Some((block, _)) = open.take() {
            blocks.push(block);
            continue;
        }
        let mut words = information.split_whitespace().map(String::from);
        let language = words.next().unwrap_or_default();
        let no_run = words.any(|word| word == "no-run");
        open = Some((Block { language, no_run, line, text: String::new() }, indentation));
    }
    blocks.extend(open.map(|(block, _)| block));
    blocks
}

/// The commands of a block: one a line, a comment begins with ` #`.
pub fn commands(block: &Block) -> Vec<Command> {
    let lines = (block.line + 1..).zip(block.text.lines());
    let commands = lines.map(|(line, text)| {
        let (text, comment) = text.split_once(" #").unwrap_or((text, ""));
        let exit_code = comment.split_once("exit code ").and_then(|(_, code)| code.trim().parse().ok());
        Command { line, text: text.trim().into(), exit_code: exit_code.unwrap_or(0) }
    });
    commands.filter(|command| !command.text.is_empty()).collect()
}

/// The words of a command, as a shell would split them: spaces outside of quotes.
pub fn words(command: &str) -> Vec<String> {
    let mut words = Vec::new();
    let (mut word, mut quote): (Option<String>, Option<char>) = (None, None);
    for character in command.chars() {
        match quote {
            Some(end) if character == end => quote = None,
            None if matches!(character, '\'' | '"') => {
                quote = Some(character);
                word.get_or_insert_default();
            }
            None if character.is_whitespace() => words.extend(word.take()),
            _ => word.get_or_insert_default().push(character),
        }
    }
    words.extend(word);
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_commands_and_words_are_those_of_the_document() {
        let document = "text\n```sh\nA=1 palpate run 'a b' --x=1   # a comment\npalpate path # exit code 1\n```\n\
                        1. item\n\n   ```sh no-run\n   sudo x | y\n   ```\n```toml\nkey = 1\n```\n";
        let found = blocks(document);
        let kinds: Vec<_> = found.iter().map(|b| (b.language.as_str(), b.no_run, b.line)).collect();
        assert_eq!(kinds, [("sh", false, 2), ("sh", true, 8), ("toml", false, 11)]);
        let of_first = commands(&found[0]);
        assert_eq!((of_first[0].line, of_first[0].exit_code), (3, 0));
        assert_eq!(words(&of_first[0].text), ["A=1", "palpate", "run", "a b", "--x=1"]);
        assert_eq!((of_first[1].text.as_str(), of_first[1].exit_code), ("palpate path", 1));
        assert_eq!(commands(&found[1])[0].text, "sudo x | y");
        assert_eq!(found[2].text, "key = 1\n");
    }
}
