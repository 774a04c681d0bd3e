//! Where a session's tool was in touch, and what was felt there.

use palpate_core::{Coverage, NodeWeight, Vec3, vec3};
use palpate_host::rt::TickRecord;

/// Way of the control between two kept visits, m.
const WAY_M: f32 = 2e-3;

/// A position of the tool in touch.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Visit {
    pub(crate) weights: [NodeWeight; 3],
    pub(crate) control_m: [f32; 3],
    pub(crate) felt_n: [f32; 3],
    /// Whether no jet was trusted here, as the window says.
    pub(super) is_extrapolated: bool,
    /// Place of another tool that presses the same body, or the half axis of a capsule.
    pub(super) second_m: Option<[f32; 3]>,
    /// Whether a new touch begins here.
    pub(super) begins: bool,
    /// Number of changes of the scene before it.
    pub(super) changes: usize,
}

/// The net energy of the touches that ended: each is a closed loop from the free body and back.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Loops {
    pub(super) count: u32,
    /// The largest energy given to the hand round a loop, and the energy exchanged in that loop, J.
    pub(super) pumped_j: f32,
    pub(super) exchanged_j: f32,
}

/// The positions that a session visits, and its first touch.
#[derive(Debug, Default)]
pub(super) struct Visits {
    /// In the order of time.
    pub(super) kept: Vec<Visit>,
    pub(super) loops: Loops,
    pub(super) first_touch_us: Option<u64>,
    /// Whether positions are kept.
    keeps: bool,
    touches: bool,
    /// Half axis of a capsule in the frame of the grip, and turned with the grip.
    half_axis_m: Option<Vec3>,
    turned_m: Option<Vec3>,
    /// Whether something else has done work on the body in the present touch, another tool or the turning of this one: then it
    /// is no closed loop.
    is_open: bool,
    /// Work on the hand in the present touch: now, and its smallest and largest value, J.
    work_j: [f32; 3],
}

impl Visits {
    /// `keeps` says whether positions are of use; `half_axis_m` is that of a capsule.
    pub(super) fn new(keeps: bool, half_axis_m: Option<Vec3>) -> Self {
        Self { keeps, half_axis_m, ..Self::default() }
    }

    /// Takes the next record. `changes` is the number of changes of the scene before it; `None` during a change.
    pub(super) fn take(&mut self, record: &TickRecord, changes: Option<usize>) {
        if let (Some(half_m), Some(sample)) = (self.half_axis_m, &record.sample) {
            self.turned_m = Some(sample.orientation.turn(half_m));
        }
        let touched = std::mem::replace(&mut self.touches, record.engaged.is_some());
        if !self.touches {
            if touched && !std::mem::take(&mut self.is_open) {
                self.end_loop();
            }
            return;
        }
        let second_m = pressing_m(record).or(self.turned_m);
        self.is_open |= second_m.is_some();
        self.first_touch_us.get_or_insert(record.t_us);
        let [_, least_j, most_j] = if touched { self.work_j } else { [0.0; 3] };
        let work_j = record.hand_work_j;
        self.work_j = [work_j, least_j.min(work_j), most_j.max(work_j)];
        let Some(changes) = changes.filter(|_| self.keeps) else { return };
        let begins = !touched;
        let is_far = |last: &Visit| {
            vec3::distance(last.control_m, record.displacement_m) > WAY_M
                || match (last.second_m, second_m) {
                    (Some(one), Some(other)) => vec3::distance(one, other) > WAY_M,
                    (one, other) => one.is_some() != other.is_some(),
                }
                || last.weights.map(|node| node.space) != record.shares.map(|node| node.space)
                || last.changes != changes
        };
        if begins || self.kept.last().is_none_or(is_far) {
            let (weights, control_m, felt_n) = (record.shares, record.displacement_m, record.reaction_n);
            let is_extrapolated = record.coverage == Some(Coverage::Extrapolated);
            self.kept.push(Visit { weights, control_m, felt_n, is_extrapolated, second_m, begins, changes });
        }
    }

    fn end_loop(&mut self) {
        let [work_j, least_j, most_j] = self.work_j;
        let Loops { count, pumped_j, .. } = &mut self.loops;
        *count += 1;
        if *count == 1 || work_j > *pumped_j {
            *pumped_j = work_j;
            self.loops.exchanged_j = most_j - least_j;
        }
    }
}

/// Where another tool presses the same body in a tick, m.
fn pressing_m(record: &TickRecord) -> Option<Vec3> {
    let partner = record.live?.partner.filter(|partner| partner.presses)?;
    Some(partner.position_m)
}

#[cfg(test)]
mod tests {
    use super::*;
    use palpate_host::live::{LiveTick, Partner};

    fn record(engaged: bool, x_m: f32, work_j: f32) -> TickRecord {
        TickRecord {
            engaged: engaged.then_some(0),
            displacement_m: [x_m, 0.0, 0.0],
            hand_work_j: work_j,
            ..TickRecord::EMPTY
        }
    }

    #[test]
    fn touches_are_loops_and_visits_lie_apart() {
        let mut visits = Visits::new(true, None);
        let touch = |visits: &mut Visits, end_j: f32| {
            for step in 0..=10 {
                let way = (5 - (step - 5_i32).abs()) as f32;
                let work_j = -0.01 * way + end_j * step as f32 / 10.0;
                visits.take(&record(true, 1e-3 * way, work_j), (step != 3).then_some(1));
            }
            visits.take(&record(false, 0.0, 0.0), Some(1));
        };
        touch(&mut visits, -0.002);
        touch(&mut visits, 0.001);
        touch(&mut visits, -0.003);
        let Loops { count, pumped_j, exchanged_j } = visits.loops;
        assert_eq!(count, 3);
        assert!((pumped_j - 0.001).abs() < 1e-6 && (exchanged_j - 0.0505).abs() < 2e-3, "{exchanged_j}");
        // 0, 4, 1 mm of each touch: 3 mm fell into a change, and 2 mm is no further than the way.
        let places: Vec<i32> = visits.kept.iter().map(|v| (1e3 * v.control_m[0]).round() as i32).collect();
        assert_eq!(places, [0, 4, 1].repeat(3));
        assert_eq!(visits.kept.iter().filter(|visit| visit.begins).count(), 3);
    }

    #[test]
    fn a_touch_beside_another_tool_is_no_loop_and_is_visited_where_that_moves() {
        let mut visits = Visits::new(true, None);
        for step in 0..=9 {
            let partner = Partner {
                position_m: [0.0, 1.25e-3 * step as f32, 0.0],
                presses: step > 2,
                ..Partner::default()
            };
            let live = LiveTick { partner: Some(partner), ..LiveTick::default() };
            visits.take(&TickRecord { live: Some(live), ..record(true, 0.0, -0.01) }, Some(0));
        }
        visits.take(&record(false, 0.0, 0.0), Some(0));
        assert_eq!(visits.loops.count, 0);
        let partners: Vec<_> =
            visits.kept.iter().map(|v| v.second_m.map(|at_m| (1e3 * at_m[1]).round())).collect();
        assert_eq!(partners, [None, Some(4.0), Some(6.0), Some(9.0), Some(11.0)]);
    }
}
