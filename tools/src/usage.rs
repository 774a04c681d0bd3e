//! Help and refusals of the command line. `--help` shows the common options of a command on one screen,
//! `--help-all` explains all of them; arguments that are not understood are refused in one line.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{Arg, ArgAction, Command, Error, Parser};

/// Replaces clap's help flags in `command` and in its subcommands.
fn with_help(command: Command) -> Command {
    let flag = |name: &'static str, action, help: &'static str| {
        Arg::new(name).long(name).action(action).help(help)
    };
    command
        .disable_help_flag(true)
        .disable_help_subcommand(true)
        .arg(flag("help", ArgAction::HelpShort, "Print the common options").short('h'))
        .arg(flag("help-all", ArgAction::HelpLong, "Print all options, explained"))
        .mut_subcommands(with_help)
}

/// Parses these arguments, the first of which is the name of the program.
pub(crate) fn parse<P: Parser>(arguments: impl IntoIterator<Item = OsString>) -> Result<P, Error> {
    let matches = with_help(P::command()).try_get_matches_from(arguments)?;
    P::from_arg_matches(&matches)
}

/// Prints help or version, or the error on one line. Returns the exit code.
pub(crate) fn answer(program: &str, error: &Error) -> ExitCode {
    match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            // A reader that closes the pipe has read enough.
            let _ = error.print();
        }
        _ => eprintln!("{program}: {}", one_line(&error.render().to_string())),
    }
    ExitCode::from(error.exit_code() as u8)
}

/// A message of clap without its blank lines; the usage becomes a reference to the command's help.
fn one_line(message: &str) -> String {
    let mut line = String::new();
    let mut command = "palpate".to_owned();
    for part in message.lines().map(str::trim).filter(|part| !part.is_empty()) {
        if let Some(usage) = part.strip_prefix("Usage: ") {
            let is_name = |word: &&str| !word.starts_with(['[', '<', '-']);
            command = usage.split_whitespace().take_while(is_name).collect::<Vec<_>>().join(" ");
            break;
        }
        if part.starts_with("For more information") {
            break;
        }
        line.push_str(match line.chars().last() {
            None => "",
            Some(':') => " ",
            Some(_) if part.starts_with(['[', 't']) => "; ",
            Some(_) => ", ",
        });
        line.push_str(part);
    }
    format!("{}; see {command} --help", line.trim_start_matches("error: "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Cli;

    fn said(arguments: &str) -> String {
        let words = std::iter::once("palpate").chain(arguments.split_whitespace()).map(OsString::from);
        let error = parse::<Cli>(words).expect_err("no command");
        let text = error.render().to_string();
        if error.use_stderr() { one_line(&text) } else { text }
    }

    /// Every command and subcommand, as typed.
    fn commands() -> Vec<String> {
        fn below(command: &Command, name: &str, names: &mut Vec<String>) {
            names.push(name.to_owned());
            for sub in command.get_subcommands() {
                below(sub, format!("{name} {}", sub.get_name()).trim(), names);
            }
        }
        let mut names = Vec::new();
        below(&<Cli as clap::CommandFactory>::command(), "", &mut names);
        names
    }

    #[test]
    fn the_help_of_every_command_fits_one_screen_and_names_the_rest() {
        for command in commands() {
            let [short, all] = ["--help", "--help-all"].map(|flag| said(&format!("{command} {flag}")));
            let (lines, wide) = (short.lines().count(), short.lines().map(|l| l.chars().count()).max());
            assert!(lines <= 30 && wide <= Some(100), "{command}: {lines} lines, {wide:?} wide\n{short}");
            assert!(short.contains("--help-all") && all.len() >= short.len(), "{command}");
        }
        let own = said("--help");
        assert!(own.lines().all(|line| line.chars().count() <= 80), "{own}");
    }

    #[test]
    fn a_refusal_is_one_line_with_the_command_to_look_up() {
        assert_eq!(
            said("run a.blob --sceonds 3"),
            "unexpected argument '--sceonds' found; tip: a similar argument exists: '--seconds'; see palpate run --help"
        );
        let missing = said("pack");
        assert!(missing.contains("not provided: --out <FILE.blob>, <SPACE>; see palpate pack --help"), "{missing}");
        let method = said("query a.blob --method magic");
        assert!(method.contains("'magic'") && method.contains("choose from trilinear, "), "{method}");
        assert!(said("dmeo").contains("'demo'; see palpate --help"), "{}", said("dmeo"));
    }
}
