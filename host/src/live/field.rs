//! The loop's side of a live solver: it takes jets, keeps them, and tells where the hand is.

use super::Frame;
use super::channel::LoopEnd;
use super::hand::{Axis, Hand, VelocityFilter};
use super::partner::{PRESSES_N, Partner};
use core::fmt::Debug;
use palpate_core::{Command, Controller, Coverage, Jet, JetMemory, Sample, Solver, State, vec3};
use serde::{Deserialize, Serialize};
use std::io;

/// Contact points whose jets the loop keeps at a time.
pub const CONTACTS: usize = 64;
/// Jets of one contact point.
pub const JETS: usize = 256;

/// Stack of the thread that makes the memory, bytes: several times its size.
const MAKING_STACK: usize = 32 << 20;

/// Where the jets come from: the channel to a solver, or a recording.
///
/// In every tick the loop calls [`JetSource::take`], [`JetSource::solver`], [`JetSource::partner`] and
/// [`JetSource::publish`] in this order, each once. None may wait, allocate or make a system call.
pub trait JetSource: Debug + Send {
    /// Copies the next frame; `false` if there is none.
    fn take(&mut self, frame: &mut Frame) -> bool;

    /// State of the solver at the time of the tick.
    fn solver(&mut self, now_ns: u64) -> Solver;

    /// Another tool on the same body, if its session runs.
    fn partner(&mut self, _now_ns: u64) -> Option<Partner> {
        None
    }

    /// Tells the solver where the hand is.
    fn publish(&mut self, hand: &Hand);
}

impl JetSource for LoopEnd {
    fn take(&mut self, frame: &mut Frame) -> bool {
        LoopEnd::take(self, frame)
    }

    fn solver(&mut self, now_ns: u64) -> Solver {
        LoopEnd::solver(self, now_ns)
    }

    fn partner(&mut self, now_ns: u64) -> Option<Partner> {
        LoopEnd::partner(self, now_ns)
    }

    fn publish(&mut self, hand: &Hand) {
        LoopEnd::publish(self, hand);
    }
}

/// What a tick got from the solver; with the frames it is all that a replay needs.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LiveTick {
    /// Frames taken so far, that of this tick included.
    pub jets: u32,
    /// Sequence number of the last jet that was kept.
    pub sequence: u32,
    /// Changes of the active jet of a touched contact so far.
    pub hand_overs: u32,
    /// Size of the step that their fades made in the force, N.
    #[serde(default)]
    pub fade_step_n: f32,
    /// State of the solver.
    #[serde(with = "solver_name")]
    pub solver: Solver,
    /// Another tool on the same body, if its session runs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub partner: Option<Partner>,
}

/// A frame as the loop has taken it, for a recording. The loop records also one that it refuses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TakenJet {
    /// The tick in which it was taken, before the force was evaluated.
    pub tick: u64,
    /// Time of that tick, us.
    pub t_us: u64,
    /// Its number among the frames taken, from 1.
    pub number: u32,
    /// The frame.
    pub frame: Frame,
}

/// What the loop took from the solver.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct LiveCounts {
    /// Frames taken.
    pub taken: u32,
    /// Frames among them that were no valid jet, or had no room.
    pub refused: u32,
    /// Frames missing from the recording because its queue was full.
    pub dropped_by_recorder: u32,
}

/// The jets of a session with their source: what the loop renders in place of tables.
#[derive(Debug)]
pub struct LiveField {
    memory: Box<JetMemory<CONTACTS, JETS>>,
    source: Box<dyn JetSource>,
    filter: VelocityFilter,
    /// The same of the end of a capsule.
    turning: VelocityFilter,
    /// The axis in the last tick.
    axis: Option<Axis>,
    frame: Frame,
    /// Sequence number of the last jet that was kept.
    sequence: u32,
    counts: LiveCounts,
    recording: Option<rtrb::Producer<TakenJet>>,
}

impl LiveField {
    /// An empty memory of jets, which fills from `source`.
    ///
    /// # Errors
    ///
    /// The thread that makes the memory cannot be started.
    pub fn new(source: impl JetSource + 'static) -> io::Result<Self> {
        // Half the usual stack of a thread, before it is moved into its box.
        let making = std::thread::Builder::new().stack_size(MAKING_STACK);
        let making = making.spawn(|| Box::new(JetMemory::new()))?;
        let memory = making.join().map_err(|_| io::ErrorKind::OutOfMemory)?;
        Ok(Self {
            memory,
            source: Box::new(source),
            filter: VelocityFilter::default(),
            turning: VelocityFilter::default(),
            axis: None,
            frame: [0; Jet::FRAME_LEN],
            sequence: 0,
            counts: LiveCounts::default(),
            recording: None,
        })
    }

    /// Sets the queue of a recorder. A frame that finds it full is counted, and missing from the recording.
    #[must_use]
    pub fn with_recording(mut self, queue: Option<rtrb::Producer<TakenJet>>) -> Self {
        self.recording = queue;
        self
    }

    /// What was taken so far.
    #[must_use]
    pub const fn counts(&self) -> LiveCounts {
        self.counts
    }

    /// One tick of the controller: takes at most one jet, evaluates, and publishes the hand. `now_ns` is on the
    /// clock of the solver's heartbeat. Wait-free.
    pub fn tick<const N: usize>(
        &mut self,
        controller: &Controller<'_, '_, N>,
        state: &mut State,
        (index, now_ns, now_us): (u64, u64, u64),
        sample: Option<&Sample>,
    ) -> (Command, LiveTick) {
        self.take(index, now_us);
        let solver = self.source.solver(now_ns);
        self.memory.solver(solver);
        let partner = self.source.partner(now_ns);
        let pressing = partner.filter(|partner| partner.presses);
        let start_m =
            controller.organ().spaces.first().map_or(vec3::ZERO, |space| space.active.rest_position_m);
        self.memory.partner(pressing.map(|partner| vec3::sub(partner.position_m, start_m)));
        let command = controller.tick_on(state, now_us, sample, &mut *self.memory);
        let velocity_m_s = match sample {
            Some(sample) => self.filter.update(sample.t_us, sample.position_m),
            None => self.filter.velocity_m_s(),
        };
        let half_m = controller.organ().tool.half_axis_m();
        if let (Some(half_m), Some(sample)) = (half_m, sample.filter(|it| it.orientation.is_rotation())) {
            let half_m = sample.orientation.turn(half_m);
            let velocity_m_s = self.turning.update(sample.t_us, half_m);
            self.axis = Some(Axis { half_m, velocity_m_s });
        }
        let LiveCounts { taken, refused, .. } = self.counts;
        self.source.publish(&Hand {
            tick: index,
            t_us: now_us,
            engaged: command.weights,
            displacement_m: command.displacement_m,
            velocity_m_s,
            hip_m: command.hip_m,
            is_engaged: command.engaged.is_some(),
            is_extrapolated: command.coverage == Some(Coverage::Extrapolated),
            missing: command.weights.map(|at| at.weight > 0.0 && self.memory.jets(at.space) == 0),
            taken,
            refused,
            sequence: self.sequence,
            presses: vec3::norm(command.reaction_n) > PRESSES_N,
            partner: pressing,
            axis: self.axis,
        });
        let (hand_overs, fade_step_n) = (self.memory.hand_overs(), self.memory.fade_step_n());
        (command, LiveTick { jets: taken, sequence: self.sequence, hand_overs, fade_step_n, solver, partner })
    }

    /// Takes the next frame, checks it, and keeps its jet.
    fn take(&mut self, tick: u64, t_us: u64) {
        if !self.source.take(&mut self.frame) {
            return;
        }
        self.counts.taken = self.counts.taken.wrapping_add(1);
        match Jet::decode(&self.frame) {
            Ok(jet) if self.memory.insert(&jet) => self.sequence = jet.sequence,
            _ => self.counts.refused = self.counts.refused.wrapping_add(1),
        }
        let taken = TakenJet { tick, t_us, number: self.counts.taken, frame: self.frame };
        if self.recording.as_mut().is_some_and(|queue| queue.push(taken).is_err()) {
            self.counts.dropped_by_recorder = self.counts.dropped_by_recorder.wrapping_add(1);
        }
    }
}

/// The state of the solver by its name.
mod solver_name {
    use palpate_core::Solver;
    use serde::de::{Error, Unexpected};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    const NAMES: [(Solver, &str); 3] =
        [(Solver::Alive, "alive"), (Solver::Silent, "silent"), (Solver::Gone, "gone")];

    pub(super) fn serialize<S: Serializer>(solver: &Solver, to: S) -> Result<S::Ok, S::Error> {
        let name = NAMES.iter().find(|(state, _)| state == solver).map_or("gone", |(_, name)| name);
        name.serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Solver, D::Error> {
        let name = String::deserialize(from)?;
        let found = NAMES.iter().find(|(_, known)| *known == name).map(|(state, _)| *state);
        found.ok_or_else(|| D::Error::invalid_value(Unexpected::Str(&name), &"alive, silent or gone"))
    }
}
