//! A recording as a picture: force, displacement and speed over time, and when the force was limited or absent.

use std::collections::VecDeque;

use palpate_core::{Coverage, Phase, Solver, Vec3, vec3};
use palpate_host::rt::TickRecord;
use palpate_host::session::TouchDisplacement;
use palpate_record::Header;

use super::trace::{Columns, Extremes};
use crate::plot::{Axis, Curve, Lane, PALETTE, Panel, Timeline as Drawing};
use crate::words::percent;

/// Time over which the speed is a mean, us. The steps of an encoder in a single tick are faster than a hand.
const SPEED_US: u64 = 20_000;

/// The part of a recording that is drawn, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Window {
    from_us: u64,
    until_us: u64,
}

impl Window {
    pub(super) const ALL: Self = Self { from_us: 0, until_us: u64::MAX };

    /// `FROM,UNTIL` in seconds.
    pub(super) fn parse(text: &str) -> Result<Self, String> {
        let seconds = text.split_once(',').and_then(|(from, until)| {
            let [from, until] = [from, until].map(|text| text.trim().parse::<f64>().ok());
            from.zip(until)
        });
        match seconds {
            Some((from_s, until_s)) if 0.0 <= from_s && from_s < until_s && until_s.is_finite() => {
                let [from_us, until_us] = [from_s, until_s].map(|seconds| (seconds * 1e6).round() as u64);
                Ok(Self { from_us, until_us })
            }
            _ => Err("give two times in seconds, the earlier one first, such as 0.5,2".into()),
        }
    }

    fn contains(&self, t_us: u64) -> bool {
        (self.from_us..=self.until_us).contains(&t_us)
    }
}

/// Magnitude and components of a vector.
struct VectorTrace([Columns<Extremes>; 4]);

impl VectorTrace {
    fn add(&mut self, t_us: u64, vector: Vec3, factor: f64) {
        let [x, y, z] = vector;
        for (columns, value) in self.0.iter_mut().zip([x, y, z, vec3::norm(vector)]) {
            // A damaged recording may hold any number.
            if value.is_finite() {
                columns.add(t_us, Extremes::of([t_us as f64 * 1e-6, factor * f64::from(value)]));
            }
        }
    }

    fn curves(&self) -> Vec<Curve> {
        let looks = [
            ("x", PALETTE[5], ""),
            ("y", PALETTE[4], "6 3"),
            ("z", PALETTE[3], "2 3"),
            ("magnitude", PALETTE[0], ""),
        ];
        let curve = |(columns, (name, colour, dash)): (
            &Columns<Extremes>,
            (&'static str, &'static str, &'static str),
        )| { Curve { name, colour, dash, pieces: columns.pieces() } };
        self.0.iter().zip(looks).map(curve).collect()
    }
}

/// A condition: what it is called, its colour, whether the panels show it, and when it held.
struct Condition {
    name: &'static str,
    colour: &'static str,
    is_shaded: bool,
    holds: fn(&TickRecord) -> bool,
    ticks: u64,
    columns: Columns<()>,
}

type Described = (&'static str, &'static str, bool, fn(&TickRecord) -> bool);

/// The conditions of a tick. The order is that of the lanes.
const CONDITIONS: [Described; 6] = [
    ("in touch", PALETTE[5], false, |r| r.engaged.is_some()),
    ("extrapolated", PALETTE[1], true, |r| r.coverage == Some(Coverage::Extrapolated)),
    ("force limited", PALETTE[6], false, |r| r.clamped),
    ("energy guard", PALETTE[3], false, |r| r.damped),
    ("disarmed", "#9a9a9a", true, |r| r.phase == Phase::Disarmed),
    ("fault", PALETTE[4], true, |r| matches!(r.phase, Phase::SafeZero(_))),
];
/// One more in a live session.
const SOLVER: Described =
    ("solver silent", PALETTE[2], false, |r| r.live.is_some_and(|live| live.solver != Solver::Alive));

/// What the picture shows of the ticks so far.
pub(super) struct Timeline {
    window: Window,
    period_us: u32,
    title: String,
    ticks: u64,
    last_us: u64,
    before: Option<TickRecord>,
    touch: TouchDisplacement,
    places: VecDeque<(u64, Vec3)>,
    force: VectorTrace,
    moment: VectorTrace,
    /// Whether a tick has a moment.
    turns: bool,
    displacement: VectorTrace,
    speed: Columns<Extremes>,
    conditions: Vec<Condition>,
    missing: Columns<()>,
    missing_ticks: u64,
    faults: Vec<(f64, &'static str)>,
}

impl Timeline {
    pub(super) fn new(header: &Header, window: Window) -> Self {
        let period_us = header.haptic.period_us;
        let columns = || Columns::new(window.from_us, period_us);
        let vector = || VectorTrace(std::array::from_fn(|_| columns()));
        let condition = |&(name, colour, is_shaded, holds): &Described| Condition {
            name,
            colour,
            is_shaded,
            holds,
            ticks: 0,
            columns: Columns::new(window.from_us, period_us),
        };
        let of_solver = header.is_live().then_some(SOLVER);
        Self {
            window,
            period_us,
            title: format!("{}, {}, {}", header.scene, header.device.name, header.config.method_name()),
            ticks: 0,
            last_us: window.from_us,
            before: None,
            touch: TouchDisplacement::default(),
            places: VecDeque::new(),
            force: vector(),
            moment: vector(),
            turns: false,
            displacement: vector(),
            speed: columns(),
            conditions: CONDITIONS.iter().chain(&of_solver).map(condition).collect(),
            missing: Columns::new(window.from_us, period_us),
            missing_ticks: 0,
            faults: Vec::new(),
        }
    }

    /// Takes the next tick. Those before the window count too: a touch and a speed may begin there.
    pub(super) fn take(&mut self, record: &TickRecord) {
        let displacement_m = self.touch.next_m(record);
        self.take_speed(record);
        let before = self.before.replace(*record);
        if !self.window.contains(record.t_us) {
            return;
        }
        let t_us = record.t_us;
        self.ticks += 1;
        self.last_us = t_us;
        self.force.add(t_us, record.hand_force_n, 1.0);
        self.moment.add(t_us, record.reaction_n_m, 1e3);
        self.turns |= record.reaction_n_m != vec3::ZERO;
        if let Some(displacement_m) = displacement_m {
            self.displacement.add(t_us, displacement_m, 1e3);
        }
        for condition in self.conditions.iter_mut().filter(|condition| (condition.holds)(record)) {
            condition.ticks += 1;
            condition.columns.add(t_us, ());
        }
        let Some(before) = before else { return };
        self.missing_ticks += record.tick.saturating_sub(before.tick.saturating_add(1));
        if self.is_gap(&before, record) {
            self.missing.add_span(before.t_us.saturating_add(self.period_us.into()), t_us);
        }
        if let Phase::SafeZero(fault) = record.phase
            && before.phase != record.phase
        {
            self.faults.push((t_us as f64 * 1e-6, fault.name()));
        }
    }

    /// Whether a tick is missing between two: skipped by a late loop, or lost by the recorder. After a late tick the times
    /// differ, and the numbers one tick later.
    fn is_gap(&self, before: &TickRecord, record: &TickRecord) -> bool {
        record.t_us.saturating_sub(before.t_us) >= 2 * u64::from(self.period_us)
    }

    /// The mean speed of the tool over the last 20 ms, at their middle.
    fn take_speed(&mut self, record: &TickRecord) {
        if self.before.is_some_and(|before| self.is_gap(&before, record)) {
            // The place that a late tick reads is older than the tick.
            self.places.clear();
        }
        self.places.push_back((record.t_us, record.hip_m));
        let is_old = |place: Option<&(u64, Vec3)>| {
            place.is_some_and(|(at_us, _)| at_us.saturating_add(SPEED_US) <= record.t_us)
        };
        while is_old(self.places.get(1)) {
            self.places.pop_front();
        }
        let (at_us, place_m) = self.places[0];
        let (way_m, time_us) = (vec3::distance(place_m, record.hip_m), record.t_us.saturating_sub(at_us));
        let middle_us = at_us + time_us / 2;
        let is_mean = (SPEED_US..2 * SPEED_US).contains(&time_us) && way_m.is_finite();
        if is_mean && self.window.contains(middle_us) {
            let mm_s = f64::from(way_m) * 1e9 / time_us as f64;
            self.speed.add(middle_us, Extremes::of([middle_us as f64 * 1e-6, mm_s]));
        }
    }

    /// The content of the SVG file; `None` if no tick lies in the window.
    pub(super) fn svg(self) -> Option<String> {
        if self.ticks == 0 {
            return None;
        }
        let until_us = if self.window == Window::ALL { self.last_us } else { self.window.until_us };
        let [from_s, until_s] =
            [self.window.from_us, until_us.max(self.window.from_us + 1)].map(|us| us as f64 * 1e-6);
        let speed = Curve { name: "", colour: PALETTE[0], dash: "", pieces: self.speed.pieces() };
        let panel = |title: &str, height, curves| Panel { title: title.into(), height, curves };
        let share =
            |ticks: u64| if ticks == 0 { "none".into() } else { percent(ticks as f64 / self.ticks as f64) };
        let of = |condition: Condition| Lane {
            name: condition.name,
            colour: condition.colour,
            is_shaded: condition.is_shaded,
            spans: condition.columns.spans(),
            marks: if condition.name == "fault" { self.faults.clone() } else { Vec::new() },
            note: share(condition.ticks),
        };
        let mut lanes: Vec<Lane> = self.conditions.into_iter().map(of).collect();
        lanes.push(Lane {
            name: "ticks missing",
            colour: PALETTE[0],
            is_shaded: false,
            spans: self.missing.spans(),
            marks: Vec::new(),
            note: if self.missing_ticks == 0 { "none".into() } else { self.missing_ticks.to_string() },
        });
        let moment = self
            .turns
            .then(|| panel("moment on the body about the tool's centre, mN m", 120.0, self.moment.curves()));
        let mut panels = vec![panel("force for the hand, N", 190.0, self.force.curves())];
        panels.extend(moment);
        panels.extend([
            panel("displacement of the tool in the touch, mm", 150.0, self.displacement.curves()),
            panel("speed of the tool, mean over 20 ms, mm/s", 100.0, vec![speed]),
        ]);
        let drawing = Drawing {
            title: self.title,
            time: Axis::span("time since the loop began, s", from_s, until_s),
            panels,
            lanes,
        };
        Some(drawing.svg_file())
    }
}
