//! Checks that the command line accepts the arguments of every `palpate` command in the documents.

use std::ffi::OsString;

use clap::error::ErrorKind;
use palpate_tests::documents;

use crate::{Cli, usage};

/// The arguments of the first `palpate` in a command, which may follow variables, a path or `cargo run`.
fn arguments(command: &str) -> Option<Vec<String>> {
    let words = documents::words(command);
    let is_palpate = |word: &String| word.rsplit('/').next() == Some("palpate");
    let start = match words.iter().position(|word| word == "--") {
        Some(separator) if words.starts_with(&["cargo".into(), "run".into()]) => {
            // `cargo run -p palpate-hil` is another program.
            let is_other = words[..separator].iter().any(|word| word.starts_with("palpate-"));
            (!is_other).then_some(separator)?
        }
        _ => words.iter().position(|word| !word.contains('=')).filter(|first| is_palpate(&words[*first]))?,
    };
    let ends = |word: &&String| !matches!(word.as_str(), "|" | "&&" | ";" | ">");
    Some(words[start + 1..].iter().take_while(ends).cloned().collect())
}

fn refusal(arguments: &[String]) -> Option<String> {
    let words = std::iter::once("palpate").chain(arguments.iter().map(String::as_str)).map(OsString::from);
    let error = usage::parse::<Cli>(words).err()?;
    let shows = matches!(error.kind(), ErrorKind::DisplayHelp | ErrorKind::DisplayVersion);
    (!shows).then(|| error.to_string())
}

#[test]
fn every_printed_command_is_accepted() {
    let mut checked = 0;
    for (name, text) in documents::all() {
        for block in documents::blocks(&text) {
            let commands = documents::commands(&block);
            for (command, arguments) in commands.iter().filter_map(|c| arguments(&c.text).map(|a| (c, a))) {
                assert_eq!(
                    block.language, "sh",
                    "{name}:{}: a command belongs into an `sh` block",
                    command.line
                );
                let refused = refusal(&arguments);
                assert!(refused.is_none(), "{name}:{}: `{}`: {refused:?}", command.line, command.text);
                checked += 1;
            }
        }
    }
    assert!(checked > 30, "only {checked} commands were found");
}

#[test]
fn a_misspelt_command_is_found() {
    let refused = |command| refusal(&arguments(command).expect("a command of palpate")).is_some();
    assert!(refused("palpate precompute liver.toml --uot liver.space"));
    assert!(refused("cargo run --release -- dmeo"));
    assert!(!refused("A=1 target/release/palpate run liver.blob --json | jq ."));
    assert!(arguments("cargo run --release -p palpate-hil -- emulate polhem").is_none());
    assert!(arguments("cp palpate /usr/local/bin/").is_none());
}
