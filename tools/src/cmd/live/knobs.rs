//! What a user changes while touching: values of the scene, by key, by socket or at the start.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

use palpate_host::live::SolverProcess;
use palpate_host::rt::Controls;

use super::super::live_solver::FIXED_PART;
use crate::control::Control;
use crate::failure::Failure;
use crate::setting::split;
use crate::touch::Between;

/// Time between two looks for lines of the solver.
const LOOK: Duration = Duration::from_millis(30);
/// Time after a change in which the loop fades over to it: six of its time constants.
const FADE: Duration = Duration::from_millis(600);
/// Largest number of keys of the window.
const KEYS: usize = 9;

/// A value of the scene with its alternatives.
#[derive(Debug, Clone, PartialEq)]
struct Knob {
    key: String,
    values: Vec<String>,
    at: usize,
}

/// The knobs of a session.
#[derive(Debug, Default)]
pub(super) struct Knobs {
    knobs: Vec<Knob>,
    process: Option<SolverProcess>,
    looked: Option<Instant>,
    /// Changes that the solver was asked for and has not reported.
    asked: VecDeque<String>,
    /// Changes that it has made, and when the last one was.
    made: Vec<String>,
    last: Option<Instant>,
}

impl Knobs {
    /// `KEY=VALUE` each; a key that occurs several times has several values.
    pub(super) fn of(settings: &[String]) -> Result<Self, Failure> {
        let mut knobs: Vec<Knob> = Vec::new();
        for setting in settings {
            let (key, value) = split(setting)?;
            match knobs.iter_mut().find(|knob| knob.key == key) {
                Some(knob) => knob.values.push(value.into()),
                None => knobs.push(Knob { key: key.into(), values: vec![value.into()], at: 0 }),
            }
        }
        if knobs.len() > KEYS {
            return Err(Failure::input(format!("--set: at most {KEYS} different keys")));
        }
        Ok(Self { knobs, ..Self::default() })
    }

    /// The present setting of each key.
    pub(super) fn settings(&self) -> impl Iterator<Item = String> {
        self.knobs.iter().map(|knob| format!("{}={}", knob.key, knob.values[knob.at]))
    }

    /// The solver that carries changes out. It ends when the knobs are dropped.
    pub(super) fn drive(&mut self, process: SolverProcess) {
        self.process = Some(process);
    }

    /// Passes on what the user asked for, and returns a line of the solver, if it has one.
    fn poll(&mut self, controls: &Controls, control: Option<&Control>) -> Option<String> {
        if let Some(knob) = controls.take_knob() {
            self.turn(usize::from(knob));
        }
        if self.looked.is_some_and(|at| at.elapsed() < LOOK) {
            return None;
        }
        self.looked = Some(Instant::now());
        while let Some(setting) = control.and_then(Control::take_setting) {
            self.tell(&setting);
        }
        let line = self.process.as_mut()?.next_line(Duration::ZERO).ok().flatten()?;
        eprintln!("palpate: {line}");
        // This line is no answer.
        if line != FIXED_PART {
            self.note(&line);
        }
        Some(line)
    }

    /// Notes what came of the oldest change that was asked for.
    fn note(&mut self, line: &str) {
        let Some(setting) = self.asked.pop_front() else { return };
        // A refusal is the line of its error.
        if line.strip_prefix(&setting).is_some_and(|rest| rest.starts_with(" (")) {
            self.made.push(setting);
            self.last = Some(Instant::now());
        }
    }

    /// Number of changes that the force shows; `None` during a change.
    fn changes(&self) -> Option<usize> {
        let is_settled = self.asked.is_empty() && self.last.is_none_or(|at| at.elapsed() > FADE);
        is_settled.then_some(self.made.len())
    }

    /// Goes to the next value of a knob.
    fn turn(&mut self, index: usize) {
        let Some(knob) = self.knobs.get_mut(index).filter(|knob| knob.values.len() > 1) else { return };
        let next = (knob.at + 1) % knob.values.len();
        let setting = format!("{}={}", knob.key, knob.values[next]);
        if self.tell(&setting) {
            self.knobs[index].at = next;
        }
    }

    /// Asks the solver for a change; whether it was taken. A solver that is gone has its fault in the loop.
    fn tell(&mut self, setting: &str) -> bool {
        let Some(process) = &self.process else { return true };
        let is_taken = process.tell(setting).unwrap_or(false);
        if is_taken {
            self.asked.push_back(setting.into());
        } else {
            eprintln!("palpate: {setting}: not taken, the solver is busy with earlier changes; ask again");
        }
        is_taken
    }
}

/// The knobs of a session with the socket that controls it.
#[derive(Debug)]
pub(super) struct Turned<'s> {
    knobs: RefCell<Knobs>,
    control: Option<&'s Control>,
}

impl<'s> Turned<'s> {
    pub(super) fn new(knobs: Knobs, control: Option<&'s Control>) -> Self {
        Self { knobs: RefCell::new(knobs), control }
    }

    /// Number of changes of the scene that the force shows; `None` during a change.
    pub(super) fn changes(&self) -> Option<usize> {
        self.knobs.borrow().changes()
    }

    /// Ends the solver; the changes in their order.
    pub(super) fn end(self) -> Vec<String> {
        self.knobs.into_inner().made
    }
}

impl Between for Turned<'_> {
    fn poll(&self, controls: &Controls) -> Option<String> {
        self.knobs.borrow_mut().poll(controls, self.control)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_repeated_key_has_several_values_and_the_first_is_the_start() {
        let settings = ["a.b=1", "c = [0, 1]", "a.b=2"].map(String::from);
        let mut knobs = Knobs::of(&settings).expect("three settings");
        assert_eq!(knobs.settings().collect::<Vec<_>>(), ["a.b=1", "c=[0, 1]"]);
        knobs.turn(0);
        knobs.turn(1);
        knobs.turn(7);
        assert_eq!(knobs.settings().collect::<Vec<_>>(), ["a.b=2", "c=[0, 1]"]);
        knobs.turn(0);
        assert_eq!(knobs.settings().next().as_deref(), Some("a.b=1"));
        for wrong in ["", "a", "=1", "a="] {
            assert!(Knobs::of(&[wrong.to_owned()]).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_change_counts_when_the_solver_has_made_it() {
        let mut knobs = Knobs::default();
        assert_eq!(knobs.changes(), Some(0));
        knobs.asked.extend(["a.b=1", "a.c=2"].map(String::from));
        knobs.note("a.b=1 (0.10 s)");
        assert_eq!(knobs.changes(), None);
        knobs.note("scene.toml:3: unknown key `c`");
        assert_eq!(knobs.changes(), None, "the loop fades over");
        knobs.last = knobs.last.and_then(|at| at.checked_sub(2 * FADE));
        assert_eq!((knobs.changes(), knobs.made.as_slice()), (Some(1), &["a.b=1".to_owned()][..]));
    }
}
