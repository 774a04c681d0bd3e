//! Checks the documents: links have targets, the programs and tests that they name exist, and the word limits
//! hold.

use std::collections::BTreeSet;

use cargo_metadata::{Metadata, MetadataCommand};
use palpate_tests::{documents, rust_files};

/// Maximum number of words of README.md.
const README_WORDS: usize = 600;
/// Maximum number of words of all documents in docs/, except tables and commands of the measurements.
const DOCS_WORDS: usize = 20_700;

/// The anchor of a heading.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// The text outside of code blocks.
fn prose(document: &str) -> String {
    let mut inside = false;
    let outside = document.lines().filter(|line| {
        let is_fence = line.trim_start().starts_with("```");
        inside ^= is_fence;
        !inside && !is_fence
    });
    outside.map(|line| format!("{line}\n")).collect()
}

fn anchors(document: &str) -> BTreeSet<String> {
    let text = prose(document);
    text.lines()
        .filter(|line| line.starts_with('#'))
        .map(|line| anchor(line.trim_start_matches('#')))
        .collect()
}

/// Targets of links and pictures.
fn targets(document: &str) -> Vec<String> {
    let text = prose(document);
    let after = text.split("](").skip(1);
    after.filter_map(|rest| rest.split_once(')').map(|(target, _)| target.to_owned())).collect()
}

#[test]
fn every_link_leads_somewhere() {
    let mut links = 0;
    for (name, text) in documents::all() {
        let folder = documents::root().join(&name).parent().expect("a folder").to_path_buf();
        for target in targets(&text) {
            if target.contains("://") {
                continue;
            }
            links += 1;
            let (path, heading) = target.split_once('#').unwrap_or((&target, ""));
            let file = if path.is_empty() { documents::root().join(&name) } else { folder.join(path) };
            assert!(file.exists(), "{name}: a link to `{target}`, which is not there");
            if !heading.is_empty() {
                let there = anchors(&std::fs::read_to_string(&file).expect("text"));
                assert!(there.contains(heading), "{name}: `{target}`: no such heading among {there:?}");
            }
        }
    }
    assert!(links > 30, "only {links} links were found");
}

/// The target that a `cargo` option names, and the kind of that target.
const NAMED: [(&str, &str); 5] =
    [("--test", "test"), ("--bench", "bench"), ("--example", "example"), ("--bin", "bin"), ("-p", "")];

fn is_there(metadata: &Metadata, kind: &str, name: &str) -> bool {
    let packages = metadata.workspace_packages();
    if kind.is_empty() {
        return packages.iter().any(|package| package.name.as_str() == name);
    }
    let mut targets = packages.iter().flat_map(|package| &package.targets);
    targets.any(|target| target.name == name && target.kind.iter().any(|of| of.to_string() == kind))
}

/// The names by which a command `cargo test` selects tests, without the path before them.
fn selected(words: &[String]) -> Vec<&str> {
    let Some(at) = words.windows(2).position(|pair| pair == ["cargo", "test"]) else { return Vec::new() };
    let takes_value = |word: &str| NAMED.iter().any(|(option, _)| *option == word);
    let mut found = Vec::new();
    let mut skip = false;
    for word in words[at + 2..].iter().filter(|word| *word != "--") {
        if !skip && !word.starts_with('-') {
            found.push(word.trim_end_matches("::").rsplit("::").next().unwrap_or_default());
        }
        skip = takes_value(word);
    }
    found
}

#[test]
fn every_program_and_test_that_a_command_names_is_there() {
    let metadata = MetadataCommand::new().no_deps().exec().expect("cargo metadata runs in this workspace");
    let folders =
        ["assets/", "docs/", "firmware-like-core/", "hil/", "host/", "precompute/", "tests/", "tools/"];
    let sources = rust_files(&documents::root());
    let sources: String = sources.iter().map(|path| std::fs::read_to_string(path).expect("text")).collect();
    let mut checked = 0;
    for (name, text) in documents::all() {
        let blocks = documents::blocks(&text).into_iter().filter(|block| block.language == "sh");
        for command in blocks.flat_map(|block| documents::commands(&block)) {
            let words = documents::words(&command.text);
            let paths = words.iter().filter(|word| folders.iter().any(|folder| word.starts_with(folder)));
            for path in paths.filter(|path| !path.contains("NAME")) {
                assert!(documents::root().join(path).exists(), "{name}:{}: no {path}", command.line);
                checked += 1;
            }
            for test in selected(&words) {
                let is_there =
                    [format!("mod {test};"), format!("fn {test}")].iter().any(|item| sources.contains(item));
                assert!(is_there, "{name}:{}: no test `{test}`", command.line);
                checked += 1;
            }
            for pair in words.windows(2).filter(|_| words.iter().any(|word| word == "cargo")) {
                for (_, kind) in NAMED.iter().filter(|(option, _)| *option == pair[0]) {
                    let found = is_there(&metadata, kind, &pair[1]);
                    assert!(found, "{name}:{}: no {kind} `{}` in the workspace", command.line, pair[1]);
                    checked += 1;
                }
            }
        }
    }
    assert!(checked > 10, "only {checked} names were found");
}

#[test]
fn the_documents_stay_short() {
    let is_word = |word: &&str| word.chars().any(char::is_alphanumeric);
    let count = |text: &str| text.split_whitespace().filter(is_word).count();
    let mut words = 0;
    for (name, text) in documents::all() {
        if name == "README.md" {
            let readme = count(&text);
            assert!(readme <= README_WORDS, "README.md has {readme} words, more than {README_WORDS}");
        } else if name == "docs/measurements.md" {
            let text = prose(&text);
            words += text.lines().filter(|line| !line.starts_with('|')).map(count).sum::<usize>();
        } else if name.starts_with("docs/") {
            words += count(&text);
        }
    }
    assert!(words <= DOCS_WORDS, "docs/ has {words} words, more than {DOCS_WORDS}");
}
