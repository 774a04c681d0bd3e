//! `palpate completions`: the words of the command line, for a shell.

use clap::{Args as ClapArgs, Command};
use clap_complete::Shell;

use crate::failure::Failure;
use crate::output;

/// Print the completions of a shell.
///
/// For example `palpate completions bash > ~/.local/share/bash-completion/completions/palpate`; fish reads them in
/// `~/.config/fish/completions/palpate.fish`, zsh as `_palpate` in a folder of its `fpath`. The Debian package has
/// installed them.
#[derive(Debug, ClapArgs)]
pub(crate) struct Args {
    /// The shell
    shell: Shell,
}

/// Runs the command; `command` is the whole command line.
pub(crate) fn run(args: &Args, command: Command) -> Result<(), Failure> {
    output::table(None, &script(args.shell, command))
}

/// The script for a shell, without the commands and options that the help hides.
fn script(shell: Shell, command: Command) -> Vec<u8> {
    // clap's names have to live as long as the program; this is one command line, at the end of a process.
    let mut shown = shown(Box::leak(Box::new(command)));
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut shown, "palpate", &mut script);
    script
}

/// A copy of the command line with only what its help shows: clap_complete does not omit the rest itself.
fn shown(command: &'static Command) -> Command {
    let below = command.get_subcommands().filter(|below| !below.is_hide_set()).map(shown);
    let copy = Command::new(command.get_name())
        .disable_help_flag(true)
        .disable_help_subcommand(true)
        .args(command.get_arguments().filter(|arg| !arg.is_hide_set()))
        .subcommands(below);
    let copy = match command.get_about() {
        Some(about) => copy.about(about.clone()),
        None => copy,
    };
    match command.get_version() {
        Some(version) => copy.version(version),
        None => copy,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Cli, usage};

    /// How a script of a shell names a command.
    fn named(shell: Shell, command: &str) -> String {
        match shell {
            Shell::Bash => format!("palpate,{command})"),
            Shell::Zsh => format!("'{command}:"),
            _ => format!("-a \"{command}\""),
        }
    }

    #[test]
    fn every_shell_gets_the_shown_commands_and_no_hidden_one() {
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let script = String::from_utf8(script(shell, usage::command::<Cli>())).expect("text");
            let command = usage::command::<Cli>();
            assert!(command.get_subcommands().any(Command::is_hide_set));
            for below in command.get_subcommands() {
                let name = named(shell, below.get_name());
                assert_eq!(script.contains(&name), !below.is_hide_set(), "{shell}: {name}");
            }
            for word in ["held-out", "help-all", "headless", "version"] {
                assert!(script.contains(word), "{shell}: no {word}");
            }
        }
    }

    #[test]
    fn an_option_that_the_help_hides_is_in_no_script() {
        let command = Command::new("palpate")
            .arg(clap::Arg::new("seen").long("seen"))
            .arg(clap::Arg::new("internal").long("internal").hide(true));
        for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
            let script = String::from_utf8(script(shell, command.clone())).expect("text");
            assert!(script.contains("seen") && !script.contains("internal"), "{shell}: {script}");
        }
    }
}
