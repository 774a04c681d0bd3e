//! What a [`Rig`] in the guest asks of its device in the bench, where time stands still unless it is told to go on: a line each, and the line
//! that comes back. A line is a word and numbers; a number that has no value is -1, as none of those can be.

use super::order::NotUnderstood;
use crate::fault::{FaultCounts, Faults};
use crate::felt::Felt;
use crate::mechanism::Waypoint;
use crate::rig::{Cut, Mishap, Rig};
use core::fmt;
use core::str::FromStr;
use palpate_core::Vec3;

/// A line to the bench.
#[derive(Debug, Clone, PartialEq)]
pub enum Ask {
    /// A device like new, and the cable in.
    Fresh {
        /// Of its faults.
        seed: u64,
    },
    /// A driver is being opened: time goes on while a transfer waits.
    Run,
    /// It is open: its clock begins, and time stands still.
    Hold,
    /// On to a time. Answered with where the grip really was.
    Pass {
        /// From when on the grip's place is written down, us.
        from_us: u64,
        /// To when, us.
        until_us: u64,
        /// How often it is written down, us.
        every_us: u64,
        /// The answer comes when the driver has dealt with everything the device sent: it keeps a transfer waiting.
        is_read: bool,
    },
    /// What the hand felt.
    Felt,
    /// Where the grip is, and where its encoders say that it is.
    Place,
    /// What went wrong on the way.
    Counts,
    /// The record of what the hand felt begins anew.
    Forget,
    /// The hand takes another path.
    Follow(Vec<Waypoint>),
    /// The hand holds these buttons.
    Press(u8),
    /// What goes wrong on the way to the device and to the host.
    Faults(Faults, Faults),
    /// The cable is pulled.
    Unplug(Cut),
    /// It is put in again.
    Replug,
    /// Something happens to the device.
    Strike(Mishap),
}

/// A line of a word and numbers. Every integer in here is far below 2^53, but for seeds, which go in halves.
struct Line(&'static str, Vec<f64>);

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)?;
        // What is an f32 is written as one: half as long.
        self.1.iter().try_for_each(|number| match *number as f32 {
            short if f64::from(short) == *number => write!(f, " {short}"),
            _ => write!(f, " {number}"),
        })
    }
}

fn numbers<'l>(words: impl Iterator<Item = &'l str>) -> Result<Vec<f64>, NotUnderstood> {
    words.map(|word| word.parse().map_err(|_| NotUnderstood)).collect()
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
        babble,
        chatter_us,
        refuse,
    } = faults;
    let shares = [drop, truncate, corrupt, delay, duplicate, reorder, stall, unplug, babble].map(f64::from);
    let [drop, truncate, corrupt, delay, duplicate, reorder, stall, unplug, babble] = shares;
    let times = [delay_us, stall_us, unplug_us, chatter_us].map(|us| us as f64);
    let [delay_us, stall_us, unplug_us, chatter_us] = times;
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
        babble,
        chatter_us,
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
        babble,
        chatter_us,
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
        babble: babble as f32,
        chatter_us: chatter_us as u64,
        refuse: refuse != 0.0,
    })
}

impl fmt::Display for Ask {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let line = match self {
            Self::Fresh { seed } => Line("fresh", vec![(seed >> 32) as f64, (seed & 0xffff_ffff) as f64]),
            Self::Run => Line("run", Vec::new()),
            Self::Hold => Line("hold", Vec::new()),
            Self::Pass { from_us, until_us, every_us, is_read } => {
                let times = [from_us, until_us, every_us].map(|us| *us as f64);
                Line("pass", [&times[..], &[u8::from(*is_read).into()]].concat())
            }
            Self::Felt => Line("felt", Vec::new()),
            Self::Place => Line("place", Vec::new()),
            Self::Counts => Line("counts", Vec::new()),
            Self::Forget => Line("clear", Vec::new()),
            Self::Follow(path) => {
                let point = |Waypoint { t_us, position_m: [x, y, z] }: &Waypoint| {
                    [*t_us as f64, f64::from(*x), f64::from(*y), f64::from(*z)]
                };
                Line("follow", path.iter().flat_map(point).collect())
            }
            Self::Press(buttons) => Line("buttons", vec![f64::from(*buttons)]),
            Self::Faults(to_device, to_host) => {
                Line("faults", [of_faults(*to_device), of_faults(*to_host)].concat())
            }
            Self::Unplug(cut) => Line("unplug", vec![u8::from(*cut == Cut::MidFrame).into()]),
            Self::Replug => Line("replug", Vec::new()),
            Self::Strike(Mishap::EncoderJump { axis, by_m }) => {
                Line("jump", vec![*axis as f64, f64::from(*by_m)])
            }
            Self::Strike(Mishap::LoseHoming) => Line("unhome", Vec::new()),
            Self::Strike(Mishap::PowerCycle) => Line("power", Vec::new()),
        };
        line.fmt(f)
    }
}

impl FromStr for Ask {
    type Err = NotUnderstood;

    fn from_str(line: &str) -> Result<Self, NotUnderstood> {
        let mut words = line.split(' ');
        let word = words.next().ok_or(NotUnderstood)?;
        let numbers = numbers(words)?;
        Ok(match (word, &numbers[..]) {
            ("fresh", [high, low]) => Self::Fresh { seed: (*high as u64) << 32 | *low as u64 },
            ("run", []) => Self::Run,
            ("hold", []) => Self::Hold,
            ("pass", [from_us, until_us, every_us, is_read]) => Self::Pass {
                from_us: *from_us as u64,
                until_us: *until_us as u64,
                every_us: *every_us as u64,
                is_read: *is_read != 0.0,
            },
            ("felt", []) => Self::Felt,
            ("place", []) => Self::Place,
            ("counts", []) => Self::Counts,
            ("clear", []) => Self::Forget,
            ("follow", points) if points.len() % 4 == 0 => {
                let point =
                    |point: &[f64]| Waypoint { t_us: point[0] as u64, position_m: vector(&point[1..]) };
                Self::Follow(points.chunks(4).map(point).collect())
            }
            ("buttons", [buttons]) => Self::Press(*buttons as u8),
            ("faults", both) => {
                let (to_device, to_host) = both.split_at(both.len() / 2);
                let both = faults(to_device).zip(faults(to_host)).ok_or(NotUnderstood)?;
                Self::Faults(both.0, both.1)
            }
            ("unplug", [mid_frame]) => {
                Self::Unplug(if *mid_frame != 0.0 { Cut::MidFrame } else { Cut::Between })
            }
            ("replug", []) => Self::Replug,
            ("jump", [axis, by_m]) => {
                Self::Strike(Mishap::EncoderJump { axis: *axis as usize, by_m: *by_m as f32 })
            }
            ("unhome", []) => Self::Strike(Mishap::LoseHoming),
            ("power", []) => Self::Strike(Mishap::PowerCycle),
            _ => return Err(NotUnderstood),
        })
    }
}

/// The line that comes back.
#[derive(Debug, Clone, PartialEq)]
pub enum Told {
    /// Done.
    Done,
    /// Where the grip was: one place each time that was asked for.
    Was(Vec<Vec3>),
    /// What the hand felt.
    Felt(Felt),
    /// Where the grip is, and where its encoders say that it is.
    Place(Vec3, Vec3),
    /// What went wrong on the way.
    Counts(FaultCounts),
}

impl Told {
    /// Does what was asked of a rig that needs nothing but itself for it.
    pub fn of(rig: &mut dyn Rig, ask: Ask) -> Self {
        match ask {
            Ask::Pass { from_us, until_us, every_us, .. } => {
                let mut truth = Vec::new();
                rig.advance_noting(from_us, until_us, every_us.max(1), &mut truth);
                rig.advance(until_us);
                return Self::Was(truth.into_iter().map(|(_, position_m)| position_m).collect());
            }
            Ask::Felt => return Self::Felt(rig.felt()),
            Ask::Place => return Self::Place(rig.position_m(), rig.reported_m()),
            Ask::Counts => return Self::Counts(rig.counts()),
            Ask::Forget => rig.forget(),
            Ask::Follow(path) => rig.follow(path),
            Ask::Press(buttons) => rig.press(buttons),
            Ask::Faults(to_device, to_host) => rig.set_faults(to_device, to_host),
            Ask::Unplug(cut) => rig.unplug(cut),
            Ask::Replug => rig.replug(),
            Ask::Strike(mishap) => drop(rig.strike(mishap)),
            Ask::Fresh { .. } | Ask::Run | Ask::Hold => {}
        }
        Self::Done
    }
}

impl fmt::Display for Told {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let time = |us: Option<u64>| us.map_or(-1.0, |us| us as f64);
        let line = match self {
            Self::Done => Line("done", Vec::new()),
            Self::Was(places) => Line("was", places.iter().flat_map(|place| of_vector(*place)).collect()),
            Self::Felt(felt) => {
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
                Line("felt", numbers.into())
            }
            Self::Place(is, said) => Line("place", [of_vector(*is), of_vector(*said)].concat()),
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
                    babbled,
                    refused,
                } = *counts;
                let counts = [
                    dropped, truncated, corrupted, delayed, duplicated, reordered, stalled, unplugged,
                    babbled, refused,
                ];
                Line("counts", counts.map(|count| count as f64).into())
            }
        };
        line.fmt(f)
    }
}

impl FromStr for Told {
    type Err = NotUnderstood;

    fn from_str(line: &str) -> Result<Self, NotUnderstood> {
        let mut words = line.split(' ');
        let word = words.next().ok_or(NotUnderstood)?;
        let numbers = numbers(words)?;
        let time = |us: f64| (us >= 0.0).then_some(us as u64);
        Ok(match (word, &numbers[..]) {
            ("done", []) => Self::Done,
            ("was", places) if places.len() % 3 == 0 => Self::Was(places.chunks(3).map(vector).collect()),
            (
                "felt",
                [_, _, _, force, unhomed, step, steepest, drop, motor, commands, last, off, work_j, drag_j],
            ) => Self::Felt(Felt {
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
            ("place", places) if places.len() == 6 => Self::Place(vector(places), vector(&places[3..])),
            ("counts", counts) => {
                let counts = <&[f64; 10]>::try_from(counts).map_err(|_| NotUnderstood)?;
                let [
                    dropped,
                    truncated,
                    corrupted,
                    delayed,
                    duplicated,
                    reordered,
                    stalled,
                    unplugged,
                    babbled,
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
                    babbled,
                    refused,
                })
            }
            _ => return Err(NotUnderstood),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_is_read_as_it_is_written() {
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
            babble: 0.13,
            chatter_us: 14,
            refuse: true,
        };
        let path = vec![
            Waypoint { t_us: 1, position_m: [0.1, -0.2, 1e-9] },
            Waypoint { t_us: 400_000, position_m: [0.0; 3] },
        ];
        for ask in [
            Ask::Fresh { seed: u64::MAX - 6 },
            Ask::Run,
            Ask::Hold,
            Ask::Pass { from_us: 1, until_us: 1_000, every_us: 250, is_read: true },
            Ask::Felt,
            Ask::Place,
            Ask::Counts,
            Ask::Forget,
            Ask::Follow(path),
            Ask::Press(9),
            Ask::Faults(faults, Faults::NONE),
            Ask::Faults(Faults::NONE, faults),
            Ask::Unplug(Cut::Between),
            Ask::Unplug(Cut::MidFrame),
            Ask::Replug,
            Ask::Strike(Mishap::EncoderJump { axis: 2, by_m: -0.01 }),
            Ask::Strike(Mishap::LoseHoming),
            Ask::Strike(Mishap::PowerCycle),
        ] {
            assert_eq!(ask.to_string().parse(), Ok(ask));
        }
        for line in ["", "pass 1 2", "pass 1 2 3 x", "faults 1 2 3", "follow 1 2 3", "run 1", "Run"] {
            assert_eq!(line.parse::<Ask>(), Err(NotUnderstood), "{line}");
        }
    }

    #[test]
    fn so_is_what_is_told() {
        let felt = Felt {
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
            babbled: 9,
            refused: 10,
        };
        for told in [
            Told::Done,
            Told::Was(Vec::new()),
            Told::Was(vec![[0.1, 0.2, 0.3], [-1.0, 0.0, 1e-9]]),
            Told::Felt(felt),
            Told::Place([1.0, 2.0, 3.0], [4.0, 5.0, 6.0]),
            Told::Counts(counts),
        ] {
            assert_eq!(told.to_string().parse(), Ok(told));
        }
        assert_eq!("felt 1 2 3".parse::<Told>(), Err(NotUnderstood));
    }
}
