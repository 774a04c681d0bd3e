//! `--second DEVICE`: another sphere on the same body, felt by another hand.
//!
//! The second session is a process of its own with its own loop, solver, recording and report. Each loop sees in every tick
//! where the other tool is.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitStatus};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use clap::Args as ClapArgs;
use palpate_host::live::{LinkState, LoopEnd, PartnerLink, SecondError, SecondSession, link_of_stdin};
use palpate_precompute::spec::Tool;
use serde_json::{Value, json};

use super::Args;
use crate::cmd::live_solver::scene;
use crate::device_spec::DeviceSpec;
use crate::failure::Failure;
use crate::output;

/// Arguments of the second tool.
#[derive(Debug, Default, ClapArgs)]
pub(crate) struct SecondArgs {
    /// Device of a second sphere on the same body, felt by another hand; not beside a capsule
    ///
    /// As --device, but neither mouse nor replay. With --record FILE.mcap its recording is FILE-second.mcap.
    #[arg(long, value_name = "DEVICE", value_parser = device)]
    second: Option<String>,
    /// Capabilities of the second device, as --profile
    #[arg(long, value_name = "NAME|FILE.toml", requires = "second", hide_short_help = true)]
    second_profile: Option<String>,
    /// This is the second session; the first one has started it
    #[arg(long, hide = true)]
    beside: bool,
}

/// The name of a device that a second session can have.
fn device(text: &str) -> Result<String, String> {
    match text.parse::<DeviceSpec>() {
        Ok(DeviceSpec::Mouse | DeviceSpec::Replay { .. }) => {
            Err("the second session has no window and repeats nothing: choose sim or a device".into())
        }
        Ok(_) => Ok(text.into()),
        Err(unknown) => Err(unknown.to_string()),
    }
}

/// Recording of the second session beside that of the first one.
fn recording(first: &Path) -> PathBuf {
    let stem = first.file_stem().unwrap_or_default().to_string_lossy();
    first.with_file_name(format!("{stem}-second.mcap"))
}

/// A line of the second session without the name of the program.
fn own(line: &str) -> &str {
    line.strip_prefix("palpate: ").unwrap_or(line)
}

/// The other session.
#[derive(Debug)]
pub(super) enum Other {
    /// There is none.
    None,
    /// This is the first session.
    Second(SecondSession),
    /// This is the second session, and says when it is ready.
    First(LinkState),
}

/// What a second session printed, and how it ended.
#[derive(Debug)]
pub(super) struct Report {
    device: String,
    how: ExitStatus,
    text: String,
}

impl Args {
    /// The command of the second session.
    fn second_command(&self, device: &str, settings: &[String]) -> Result<Command, Failure> {
        let mut command = Command::new(std::env::current_exe().map_err(Failure::work)?);
        let session = &self.session;
        command.arg("live").arg(&self.scene).args([
            "--beside",
            "--headless",
            "--frame-rate",
            "0",
            "--device",
            device,
        ]);
        let mut give = |option: &str, value: Option<String>| {
            if let Some(value) = value {
                command.arg(format!("{option}={value}"));
            }
        };
        let friction = |mu: f32| if mu.is_infinite() { "stick".into() } else { mu.to_string() };
        give("--profile", self.second.second_profile.clone());
        give("--check", Some(self.check.to_string()));
        give("--seconds", session.seconds.map(|seconds| seconds.to_string()));
        give("--friction", session.friction.map(friction));
        give("--guard-ms", Some(session.guard_ms.to_string()));
        give("--fifo", Some(session.timing.fifo.to_string()));
        give("--spin-us", Some(session.timing.spin_us.to_string()));
        give("--period-us", session.timing.period_us.map(|period_us| period_us.to_string()));
        settings.iter().for_each(|setting| give("--set", Some(setting.clone())));
        let flags =
            [("--motors-off", session.motors_off), ("--verbose", session.verbose), ("--json", session.json)];
        command.args(flags.into_iter().filter(|(_, is_set)| *is_set).map(|(flag, _)| flag));
        if let Some(blob) = &self.blob {
            command.arg("--blob").arg(blob);
        }
        if let Some(file) = &session.record {
            command.arg("--record").arg(recording(file));
        }
        Ok(command)
    }

    /// Starts the second session, or joins the first one.
    pub(super) fn other(
        &self,
        settings: &[String],
        stop: &Arc<AtomicBool>,
    ) -> Result<(Option<PartnerLink>, Other), Failure> {
        if self.second.beside {
            let by_hand =
                |error| Failure::input(format!("{error}: --beside is given by `palpate live --second`"));
            let link = link_of_stdin(Arc::clone(stop)).map_err(by_hand)?;
            let state = link.state();
            return Ok((Some(link), Other::First(state)));
        }
        let Some(device) = &self.second.second else { return Ok((None, Other::None)) };
        // The settings have the first value of each key.
        if self.set.len() > settings.len() {
            let line = "--second has one model for both hands: give --set one value for a key";
            return Err(Failure::input(line));
        }
        if !matches!(scene(&self.scene, settings)?.resolve()?.tool, Tool::Sphere(_)) {
            let line = "--second needs a scene with [tool] shape = \"sphere\": other tools hold their contacts alone";
            return Err(Failure::input(line));
        }
        let second = device.parse::<DeviceSpec>().map_err(Failure::input)?;
        let both = self.session.device.hardware().zip(second.hardware());
        if both.is_some_and(|(one, other)| one.is_same_device(other)) {
            return Err(Failure::input(format!("--device and --second are both {device}: give two devices")));
        }
        let (link, second) = SecondSession::start(self.second_command(device, settings)?, |line| {
            eprintln!("palpate: second tool: {}", own(line))
        })
        .map_err(Failure::work)?;
        Ok((Some(link), Other::Second(second)))
    }
}

/// The loop's end of the solver with the link to the other session.
pub(super) fn linked(for_loop: LoopEnd, link: Option<PartnerLink>) -> LoopEnd {
    match link {
        Some(link) => for_loop.with_partner(link),
        None => for_loop,
    }
}

impl Other {
    /// Waits until the second session can begin.
    pub(super) fn wait(&mut self, stop: &AtomicBool) -> Result<(), Failure> {
        let Self::Second(second) = self else { return Ok(()) };
        second.wait_ready(stop).map_err(|error| match error {
            SecondError::Ended(how, line) => {
                let error = SecondError::Ended(how, own(&line).into());
                if how.code() == Some(2) { Failure::input(error) } else { Failure::work(error) }
            }
            error => Failure::work(error),
        })
    }

    /// The device of this session is open.
    pub(super) fn opened(&self) {
        if let Self::First(state) = self {
            state.set_ready();
        }
    }

    /// The loop of this session has ended.
    pub(super) fn end_loop(&self) {
        match self {
            Self::None => {}
            Self::Second(second) => second.end_loop(),
            Self::First(state) => state.set_over(),
        }
    }

    /// Waits for the report of the second session, which may check its positions; the stop flag ends it.
    pub(super) fn end(self, args: &Args, stop: &AtomicBool) -> Result<Option<Report>, Failure> {
        let Self::Second(second) = self else { return Ok(None) };
        let (how, text) = second.end(stop).map_err(Failure::work)?;
        let device = args.second.second.clone().unwrap_or_default();
        Ok(Some(Report { device, how, text }))
    }
}

impl Report {
    /// Its figures.
    pub(super) fn json(&self) -> Value {
        json!({ "device": self.device, "report": serde_json::from_str::<Value>(&self.text).ok() })
    }

    /// Prints its report below that of the first session.
    pub(super) fn print(&self) -> Result<(), Failure> {
        output::line(format!("\nsecond tool ({})\n{}", self.device, self.text.trim_end()))
    }

    /// Fails if the session failed.
    pub(super) fn judge(&self) -> Result<(), Failure> {
        if self.how.success() {
            return Ok(());
        }
        Err(Failure::work(format!("the second session failed ({})", self.how)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_session_has_a_device_and_a_recording_of_its_own() {
        assert_eq!(device("sim:random:7"), Ok("sim:random:7".into()));
        for refused in ["mouse", "replay:a.mcap", "nothing"] {
            assert!(device(refused).is_err(), "{refused}");
        }
        assert_eq!(recording(Path::new("a/b.mcap")), Path::new("a/b-second.mcap"));
    }
}
