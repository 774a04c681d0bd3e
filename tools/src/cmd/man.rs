//! `palpate man`: the manual pages, from the definitions of the help.

use std::path::PathBuf;

use clap::builder::Resettable;
use clap::{Args as ClapArgs, Command};
use clap_mangen::Man;

use crate::failure::Failure;
use crate::files::{FileKind, Files, Replace};
use crate::output;

/// Write the manual pages into a folder.
///
/// One page for each command, as palpate.1 and palpate-live.1. `man -l FOLDER/palpate.1` shows one. The Debian
/// package has installed them.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The folder; it is created if it is missing, and pages in it are replaced
    folder: PathBuf,
    #[command(flatten)]
    replace: Replace,
}

/// Runs the command; `command` is the whole command line.
pub(crate) fn run(args: &Args, command: Command) -> Result<(), Failure> {
    let pages = pages(command)?;
    let is_page = |name: &str| pages.iter().any(|(page, _)| page == name).then_some(FileKind::Text);
    let folder = Files::new(args.replace).folder("FOLDER", &args.folder, is_page)?;
    for (name, page) in &pages {
        folder.file(name).put(page)?;
    }
    output::line(format!("{} manual pages in {}", pages.len(), args.folder.display()))
}

/// File names and contents.
fn pages(command: Command) -> Result<Vec<(String, Vec<u8>)>, Failure> {
    // The long version names the processor, so the pages would differ between machines.
    let mut command = command.long_version(Resettable::Reset);
    // Gives the subcommands their full names.
    command.build();
    let mut pages = Vec::new();
    add(&command, &mut pages).map_err(Failure::work)?;
    Ok(pages)
}

/// Adds the page of a command and those of its subcommands, without what the help hides.
fn add(command: &Command, pages: &mut Vec<(String, Vec<u8>)>) -> std::io::Result<()> {
    let man =
        Man::new(command.clone()).manual("Palpate").source(concat!("palpate ", env!("CARGO_PKG_VERSION")));
    let mut page = Vec::new();
    man.render(&mut page)?;
    pages.push((man.get_filename(), with_usage(&page, command)));
    command.get_subcommands().filter(|below| !below.is_hide_set()).try_for_each(|below| add(below, pages))
}

/// A page whose synopsis is the usage of the help, instead of a list of all options.
fn with_usage(page: &[u8], command: &Command) -> Vec<u8> {
    let page = String::from_utf8_lossy(page);
    let usage = command.clone().render_usage().to_string();
    let usage = usage.trim_start_matches("Usage: ").replace('-', "\\-").replace('\n', "\n.br\n");
    let mut lines: Vec<&str> = page.lines().collect();
    if let Some(line) =
        lines.iter().position(|line| *line == ".SH SYNOPSIS").and_then(|at| lines.get_mut(at + 1))
    {
        *line = &usage;
    }
    (lines.join("\n") + "\n").into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Cli, usage};

    #[test]
    fn every_shown_command_has_a_page_with_its_options() {
        let pages = pages(usage::command::<Cli>()).expect("rendered");
        let page = |name: &str| {
            let found = pages.iter().find(|(file, _)| file == name);
            found.map(|(_, page)| String::from_utf8(page.clone()).expect("text"))
        };
        for below in usage::command::<Cli>().get_subcommands() {
            let name = format!("palpate-{}.1", below.get_name());
            assert_eq!(page(&name).is_some(), !below.is_hide_set(), "{name}");
        }
        assert!(page("palpate-paper-held-out.1").is_some(), "commands below commands");
        let live = page("palpate-live.1").expect("it is shown");
        assert!(live.contains(".TH palpate-live 1") && live.contains("\\-\\-help\\-all"), "{live}");
        assert!(live.contains(".SH SYNOPSIS\npalpate live [OPTIONS] <SCENE>\n"), "{live}");
        let own = page("palpate.1").expect("the root");
        assert!(own.contains("palpate\\-live(1)") && !own.contains("live\\-solver"), "{own}");
    }
}
