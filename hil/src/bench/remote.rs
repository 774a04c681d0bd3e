//! Remote procedure calls from a [`Rig`] in the guest to its device in the bench, where time advances only on
//! request. A call is one line, and so is its reply. A line is a word followed by numbers. A missing value is
//! written as -1, which no valid value equals.

use super::command::UnknownCommand;
use crate::fault::{FaultCounts, Faults};
use crate::force_record::ForceRecord;
use crate::mechanism::Waypoint;
use crate::rig::{Cut, HardwareFault, Rig};
use core::fmt;
use core::str::FromStr;
use palpate_core::Vec3;

/// A request to the bench.
#[derive(Debug, Clone, PartialEq)]
pub enum RigRequest {
    /// Replaces the device by a new one, plugged in.
    NewDevice {
        /// Seed of its faults.
        seed: u64,
    },
    /// The guest starts to open a driver. Time advances while a transfer waits.
    BeginOpen,
    /// The driver is open. Its clock starts, and time stands still.
    EndOpen,
    /// Advances to a time. The reply holds the true positions of the grip.
    Advance {
        /// Start of the recorded positions, us.
        from_us: u64,
        /// End, us.
        until_us: u64,
        /// Sampling period of the recorded positions, us.
        every_us: u64,
        /// Delay the reply until the driver has processed all that the device sent and has posted another
        /// transfer.
        wait_for_driver: bool,
    },
    /// Reads the record of the force on the hand.
    ForceRecord,
    /// Reads the true position of the grip and the position that its encoders report.
    Position,
    /// Reads the counts of injected link faults.
    Counts,
    /// Resets the record of the force on the hand.
    ResetRecord,
    /// Moves the hand along another path.
    Follow(Vec<Waypoint>),
    /// Presses these buttons.
    Press(u8),
    /// Sets the faults of the links to the device and to the host.
    Faults(Faults, Faults),
    /// Pulls the cable.
    Unplug(Cut),
    /// Plugs the cable in again.
    Replug,
    /// Injects a fault of the device.
    Inject(HardwareFault),
}

/// A word and its numbers. Every integer is far below 2^53; a seed is sent as two halves.
struct Line(&'static str, Vec<f64>);

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)?;
        // A value that is exact in f32 is written as f32, which halves its length.
        self.1.iter().try_for_each(|number| match *number as f32 {
            short if f64::from(short) == *number => write!(f, " {short}"),
            _ => write!(f, " {number}"),
        })
    }
}

fn numbers<'l>(words: impl Iterator<Item = &'l str>) -> Result<Vec<f64>, UnknownCommand> {
    words.map(|word| word.parse().map_err(|_| UnknownCommand)).collect()
}

fn vector(from: &[f64]) -> Vec3 {
    [0, 1, 2].map(|axis| from.get(axis).map_or(0.0, |number| *number as f32))
}

fn of_vector(vector: Vec3) -> [f64; 3] {
    vector.map(f64::from)
}

fn of_faults(faults: Faults) -> [f64; 14] {
    let Faults {
        drop,
        truncate,
        corrupt,
        delay,
        delay_us,
        duplicate,
        reorder,
        stall,
        stall_us,
        unplug,
        unplug_us,
        noise,
        noise_period_us,
        refuse,
    } = faults;
    let shares = [drop, truncate, corrupt, delay, duplicate, reorder, stall, unplug, noise].map(f64::from);
    let [drop, truncate, corrupt, delay, duplicate, reorder, stall, unplug, noise] = shares;
    let times = [delay_us, stall_us, unplug_us, noise_period_us].map(|us| us as f64);
    let [delay_us, stall_us, unplug_us, noise_period_us] = times;
    [
        drop,
        truncate,
        corrupt,
        delay,
        delay_us,
        duplicate,
        reorder,
        stall,
        stall_us,
        unplug,
        unplug_us,
        noise,
        noise_period_us,
        f64::from(u8::from(refuse)),
    ]
}

fn faults(from: &[f64]) -> Option<Faults> {
    let [
        drop,
        truncate,
        corrupt,
        delay,
        delay_us,
        duplicate,
        reorder,
        stall,
        stall_us,
        unplug,
        unplug_us,
        noise,
        noise_period_us,
        refuse,
    ] = *<&[f64; 14]>::try_from(from).ok()?;
    Some(Faults {
        drop: drop as f32,
        truncate: truncate as f32,
        corrupt: corrupt as f32,
        delay: delay as f32,
        delay_us: delay_us as u64,
        duplicate: duplicate as f32,
        reorder: reorder as f32,
        stall: stall as f32,
        stall_us: stall_us as u64,
        unplug: unplug as f32,
        unplug_us: unplug_us as u64,
        noise: noise as f32,
        noise_period_us: noise_period_us as u64,
        refuse: refuse != 0.0,
    })
}

impl fmt::Display for RigRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = match self {
            Self::NewDevice { seed } => {
                Line("new-device", vec![(seed >> 32) as f64, (seed & 0xffff_ffff) as f64])
            }
            Self::BeginOpen => Line("begin-open", Vec::new()),
            Self::EndOpen => Line("end-open", Vec::new()),
            Self::Advance { from_us, until_us, every_us, wait_for_driver } => {
                let times = [from_us, until_us, every_us].map(|us| *us as f64);
                Line("advance", [&times[..], &[u8::from(*wait_for_driver).into()]].concat())
            }
            Self::ForceRecord => Line("force-record", Vec::new()),
            Self::Position => Line("position", Vec::new()),
            Self::Counts => Line("counts", Vec::new()),
            Self::ResetRecord => Line("reset-force-record", Vec::new()),
            Self::Follow(path) => {
                let point = |Waypoint { t_us, position_m: [x, y, z] }: &Waypoint| {
                    [*t_us as f64, f64::from(*x), f64::from(*y), f64::from(*z)]
                };
                Line("follow", path.iter().flat_map(point).collect())
            }
            Self::Press(buttons) => Line("press", vec![f64::from(*buttons)]),
            Self::Faults(to_device, to_host) => {
                Line("faults", [of_faults(*to_device), of_faults(*to_host)].concat())
            }
            Self::Unplug(cut) => Line("unplug", vec![u8::from(*cut == Cut::MidFrame).into()]),
            Self::Replug => Line("replug", Vec::new()),
            Self::Inject(HardwareFault::EncoderJump { axis, by_m }) => {
                Line("encoder-jump", vec![*axis as f64, f64::from(*by_m)])
            }
            Self::Inject(HardwareFault::HomingLost) => Line("lose-homing", Vec::new()),
            Self::Inject(HardwareFault::PowerCycle) => Line("power-cycle", Vec::new()),
        };
        line.fmt(f)
    }
}

impl FromStr for RigRequest {
    type Err = UnknownCommand;

    fn from_str(line: &str) -> Result<Self, UnknownCommand> {
        let mut words = line.split(' ');
        let word = words.next().ok_or(UnknownCommand)?;
        let numbers = numbers(words)?;
        Ok(match (word, &numbers[..]) {
            ("new-device", [high, low]) => Self::NewDevice { seed: (*high as u64) << 32 | *low as u64 },
            ("begin-open", []) => Self::BeginOpen,
            ("end-open", []) => Self::EndOpen,
            ("advance", [from_us, until_us, every_us, wait_for_driver]) => Self::Advance {
                from_us: *from_us as u64,
                until_us: *until_us as u64,
                every_us: *every_us as u64,
                wait_for_driver: *wait_for_driver != 0.0,
            },
            ("force-record", []) => Self::ForceRecord,
            ("position", []) => Self::Position,
            ("counts", []) => Self::Counts,
            ("reset-force-record", []) => Self::ResetRecord,
            ("follow", points) if points.len() % 4 == 0 => {
                let point =
                    |point: &[f64]| Waypoint { t_us: point[0] as u64, position_m: vector(&point[1..]) };
                Self::Follow(points.chunks(4).map(point).collect())
            }
            ("press", [buttons]) => Self::Press(*buttons as u8),
            ("faults", both) => {
                let (to_device, to_host) = both.split_at(both.len() / 2);
                let both = faults(to_device).zip(faults(to_host)).ok_or(UnknownCommand)?;
                Self::Faults(both.0, both.1)
            }
            ("unplug", [mid_frame]) => {
                Self::Unplug(if *mid_frame != 0.0 { Cut::MidFrame } else { Cut::Between })
            }
            ("replug", []) => Self::Replug,
            ("encoder-jump", [axis, by_m]) => {
                Self::Inject(HardwareFault::EncoderJump { axis: *axis as usize, by_m: *by_m as f32 })
            }
            ("lose-homing", []) => Self::Inject(HardwareFault::HomingLost),
            ("power-cycle", []) => Self::Inject(HardwareFault::PowerCycle),
            _ => return Err(UnknownCommand),
        })
    }
}

/// The reply.
#[derive(Debug, Clone, PartialEq)]
pub enum RigReply {
    /// Done.
    Done,
    /// True positions of the grip, one for each sampling time.
    Positions(Vec<Vec3>),
    /// The record of the force on the hand.
    ForceRecord(ForceRecord),
    /// True position of the grip, and the position that its encoders report.
    Position(Vec3, Vec3),
    /// Counts of injected link faults.
    Counts(FaultCounts),
}

impl RigReply {
    /// Executes a request that concerns only the rig.
    pub fn of(rig: &mut dyn Rig, request: RigRequest) -> Self {
        match request {
            RigRequest::Advance { from_us, until_us, every_us, .. } => {
                let mut truth = Vec::new();
                rig.advance_noting(from_us, until_us, every_us.max(1), &mut truth);
                rig.advance(until_us);
                return Self::Positions(truth.into_iter().map(|(_, position_m)| position_m).collect());
            }
            RigRequest::ForceRecord => return Self::ForceRecord(rig.force_record()),
            RigRequest::Position => return Self::Position(rig.position_m(), rig.reported_m()),
            RigRequest::Counts => return Self::Counts(rig.counts()),
            RigRequest::ResetRecord => rig.reset_record(),
            RigRequest::Follow(path) => rig.follow(path),
            RigRequest::Press(buttons) => rig.press(buttons),
            RigRequest::Faults(to_device, to_host) => rig.set_faults(to_device, to_host),
            RigRequest::Unplug(cut) => rig.unplug(cut),
            RigRequest::Replug => rig.replug(),
            RigRequest::Inject(fault) => drop(rig.inject(fault)),
            RigRequest::NewDevice { .. } | RigRequest::BeginOpen | RigRequest::EndOpen => {}
        }
        Self::Done
    }
}

impl fmt::Display for RigReply {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let time = |us: Option<u64>| us.map_or(-1.0, |us| us as f64);
        let line = match self {
            Self::Done => Line("done", Vec::new()),
            Self::Positions(positions) => {
                Line("positions", positions.iter().flat_map(|position| of_vector(*position)).collect())
            }
            Self::ForceRecord(felt) => {
                let [x, y, z] = of_vector(felt.force_n);
                let largest =
                    [felt.largest_force_n, felt.largest_unhomed_n, felt.largest_step_n, felt.largest_drop_n];
                let [force, unhomed, step, drop] = largest.map(f64::from);
                let steepest = f64::from(felt.steepest_n_per_s);
                let (motor, commands) = (felt.largest_motor.into(), felt.commands as f64);
                let (last, off) = (time(felt.last_command_us), time(felt.off_since_us));
                let numbers = [
                    x,
                    y,
                    z,
                    force,
                    unhomed,
                    step,
                    steepest,
                    drop,
                    motor,
                    commands,
                    last,
                    off,
                    felt.work_j,
                    felt.drag_j,
                ];
                Line("force-record", numbers.into())
            }
            Self::Position(actual, reported) => {
                Line("position", [of_vector(*actual), of_vector(*reported)].concat())
            }
            Self::Counts(counts) => {
                let FaultCounts {
                    dropped,
                    truncated,
                    corrupted,
                    delayed,
                    duplicated,
                    reordered,
                    stalled,
                    unplugged,
                    noise_bursts,
                    refused,
                } = *counts;
                let counts = [
                    dropped,
                    truncated,
                    corrupted,
                    delayed,
                    duplicated,
                    reordered,
                    stalled,
                    unplugged,
                    noise_bursts,
                    refused,
                ];
                Line("counts", counts.map(|count| count as f64).into())
            }
        };
        line.fmt(f)
    }
}

impl FromStr for RigReply {
    type Err = UnknownCommand;

    fn from_str(line: &str) -> Result<Self, UnknownCommand> {
        let mut words = line.split(' ');
        let word = words.next().ok_or(UnknownCommand)?;
        let numbers = numbers(words)?;
        let time = |us: f64| (us >= 0.0).then_some(us as u64);
        Ok(match (word, &numbers[..]) {
            ("done", []) => Self::Done,
            ("positions", positions) if positions.len() % 3 == 0 => {
                Self::Positions(positions.chunks(3).map(vector).collect())
            }
            (
                "force-record",
                [_, _, _, force, unhomed, step, steepest, drop, motor, commands, last, off, work_j, drag_j],
            ) => Self::ForceRecord(ForceRecord {
                force_n: vector(&numbers),
                largest_force_n: *force as f32,
                largest_unhomed_n: *unhomed as f32,
                largest_step_n: *step as f32,
                steepest_n_per_s: *steepest as f32,
                largest_drop_n: *drop as f32,
                largest_motor: *motor as u16,
                commands: *commands as u64,
                last_command_us: time(*last),
                off_since_us: time(*off),
                work_j: *work_j,
                drag_j: *drag_j,
            }),
            ("position", positions) if positions.len() == 6 => {
                Self::Position(vector(positions), vector(&positions[3..]))
            }
            ("counts", counts) => {
                let counts = <&[f64; 10]>::try_from(counts).map_err(|_| UnknownCommand)?;
                let [
                    dropped,
                    truncated,
                    corrupted,
                    delayed,
                    duplicated,
                    reordered,
                    stalled,
                    unplugged,
                    noise_bursts,
                    refused,
                ] = counts.map(|count| count as u64);
                Self::Counts(FaultCounts {
                    dropped,
                    truncated,
                    corrupted,
                    delayed,
                    duplicated,
                    reordered,
                    stalled,
                    unplugged,
                    noise_bursts,
                    refused,
                })
            }
            _ => return Err(UnknownCommand),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_round_trip_through_text() {
        let faults = Faults {
            drop: 0.1,
            truncate: 0.2,
            corrupt: 0.3,
            delay: 0.4,
            delay_us: 5,
            duplicate: 0.6,
            reorder: 0.7,
            stall: 0.8,
            stall_us: 9,
            unplug: 0.11,
            unplug_us: 12,
            noise: 0.13,
            noise_period_us: 14,
            refuse: true,
        };
        let path = vec![
            Waypoint { t_us: 1, position_m: [0.1, -0.2, 1e-9] },
            Waypoint { t_us: 400_000, position_m: [0.0; 3] },
        ];
        for request in [
            RigRequest::NewDevice { seed: u64::MAX - 6 },
            RigRequest::BeginOpen,
            RigRequest::EndOpen,
            RigRequest::Advance { from_us: 1, until_us: 1_000, every_us: 250, wait_for_driver: true },
            RigRequest::ForceRecord,
            RigRequest::Position,
            RigRequest::Counts,
            RigRequest::ResetRecord,
            RigRequest::Follow(path),
            RigRequest::Press(9),
            RigRequest::Faults(faults, Faults::NONE),
            RigRequest::Faults(Faults::NONE, faults),
            RigRequest::Unplug(Cut::Between),
            RigRequest::Unplug(Cut::MidFrame),
            RigRequest::Replug,
            RigRequest::Inject(HardwareFault::EncoderJump { axis: 2, by_m: -0.01 }),
            RigRequest::Inject(HardwareFault::HomingLost),
            RigRequest::Inject(HardwareFault::PowerCycle),
        ] {
            assert_eq!(request.to_string().parse(), Ok(request));
        }
        for line in [
            "",
            "advance 1 2",
            "advance 1 2 3 x",
            "faults 1 2 3",
            "follow 1 2 3",
            "begin-open 1",
            "Begin-open",
        ] {
            assert_eq!(line.parse::<RigRequest>(), Err(UnknownCommand), "{line}");
        }
    }

    #[test]
    fn replies_round_trip_through_text() {
        let felt = ForceRecord {
            force_n: [0.1, -2.0, 1e-7],
            largest_force_n: 2.5,
            largest_unhomed_n: 0.25,
            largest_step_n: 1.5,
            steepest_n_per_s: 512.0,
            largest_drop_n: 0.75,
            largest_motor: 4_096,
            commands: 12,
            last_command_us: Some(0),
            off_since_us: None,
            work_j: -1e-3,
            drag_j: 2e-3,
        };
        let counts = FaultCounts {
            dropped: 1,
            truncated: 2,
            corrupted: 3,
            delayed: 4,
            duplicated: 5,
            reordered: 6,
            stalled: 7,
            unplugged: 8,
            noise_bursts: 9,
            refused: 10,
        };
        for reply in [
            RigReply::Done,
            RigReply::Positions(Vec::new()),
            RigReply::Positions(vec![[0.1, 0.2, 0.3], [-1.0, 0.0, 1e-9]]),
            RigReply::ForceRecord(felt),
            RigReply::Position([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]),
            RigReply::Counts(counts),
        ] {
            assert_eq!(reply.to_string().parse(), Ok(reply));
        }
        assert_eq!("force-record 1 2 3".parse::<RigReply>(), Err(UnknownCommand));
    }
}
