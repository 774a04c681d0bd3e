//! Help and refusals of the command line. `--help` shows the common options of a command on one screen,
//! `--help-all` explains all of them; arguments that are not understood are refused in one line.

use std::ffi::OsString;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{Arg, ArgAction, Command, Error, Parser};

/// Replaces clap's help flags in `command` and in its subcommands, and lets every option have a negative number.
fn with_help(command: Command) -> Command {
    let flag =
        |name: &'static str, action, help: &'static str| Arg::new(name).long(name).action(action).help(help);
    command
        .disable_help_flag(true)
        .disable_help_subcommand(true)
        .arg(flag("help", ArgAction::HelpShort, "Print the common options").short('h'))
        .arg(flag("help-all", ArgAction::HelpLong, "Print all options, explained"))
        // "--friction -0.1" gives a value out of range, not the unknown options -0 and -1.
        .mut_args(|arg| {
            let has_value = arg.get_action().takes_values() && !arg.is_positional();
            if has_value { arg.allow_negative_numbers(true) } else { arg }
        })
        .mut_subcommands(with_help)
}

/// The command line as it is parsed, with the help flags of [`with_help`].
pub(crate) fn command<P: Parser>() -> Command {
    with_help(P::command())
}

/// Parses these arguments, the first of which is the name of the program.
pub(crate) fn parse<P: Parser>(arguments: impl IntoIterator<Item = OsString>) -> Result<P, Error> {
    let matches = command::<P>().try_get_matches_from(arguments)?;
    P::from_arg_matches(&matches)
}

/// The command and subcommands that these arguments name.
fn named<P: Parser>(arguments: impl IntoIterator<Item = OsString>) -> String {
    let root = P::command();
    let (mut at, mut name) = (&root, root.get_name().to_owned());
    for word in arguments.into_iter().skip(1) {
        let Some(below) = at.get_subcommands().find(|below| word == *below.get_name()) else { break };
        at = below;
        name = format!("{name} {}", below.get_name());
    }
    name
}

/// Prints help or version, or the error on one line. Returns the exit code.
pub(crate) fn answer<P: Parser>(error: &Error) -> ExitCode {
    match error.kind() {
        ErrorKind::DisplayHelp
        | ErrorKind::DisplayVersion
        | ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            // A reader that closes the pipe has read enough.
            let _ = error.print();
        }
        _ => {
            let program = P::command().get_name().to_owned();
            let command = named::<P>(std::env::args_os());
            eprintln!("{program}: {}", one_line(&error.render().to_string(), &command));
        }
    }
    ExitCode::from(error.exit_code() as u8)
}

/// A message of clap without its blank lines; its usage is replaced by a reference to the command's help.
fn one_line(message: &str, command: &str) -> String {
    let mut line = String::new();
    let is_message = |part: &&str| !part.starts_with("Usage: ") && !part.starts_with("For more information");
    let parts = message.lines().map(str::trim).filter(|part| !part.is_empty());
    for part in parts.take_while(is_message) {
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
        let words: Vec<OsString> = words.collect();
        let error = parse::<Cli>(words.clone()).expect_err("no command");
        let text = error.render().to_string();
        if error.use_stderr() { one_line(&text, &named::<Cli>(words)) } else { text }
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
        assert!(
            missing.contains("not provided: --out <FILE.blob>, <SPACE>; see palpate pack --help"),
            "{missing}"
        );
        let method = said("query a.blob --method magic");
        assert!(method.contains("'magic'") && method.contains("choose from trilinear, "), "{method}");
        assert!(method.ends_with("; see palpate query --help"), "{method}");
        assert!(said("dmeo").contains("'demo'; see palpate --help"), "{}", said("dmeo"));
    }
}
