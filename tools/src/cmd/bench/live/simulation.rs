//! One hand, in simulated time.

use std::time::{Duration, Instant};

use nalgebra::Vector3;
use palpate_core::{Coverage, Field, ForceSample, JetMemory, NodeWeight};
use palpate_host::sys::{cpu_ns, lower_priority};
use palpate_precompute::live::{Hand as Seen, LiveSolver, Step, Touch, Truth};
use palpate_precompute::spec::Tolerance;
use serde::Serialize;

use super::hands::Hand;
use crate::failure::Failure;

type V = Vector3<f64>;

/// The solver prepares a touch for at most this time of its own, s.
const LONGEST_WAIT_S: f64 = 120.0;
/// Gains of the filter of the velocity.
const ALPHA: f64 = 0.4;
const BETA: f64 = 0.06;

/// What was measured with one hand.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Outcome {
    hand: &'static str,
    peak_mm_s: f64,
    jets: u64,
    mean_solve_ms: f64,
    longest_solve_ms: f64,
    busy_share: f64,
    first_force_ms: usize,
    error_mean_mn: f64,
    error_p99_mn: f64,
    error_max_mn: f64,
    not_felt_share: f64,
    /// Largest step of the force in a tick by a hand-over.
    handover_max_mn: f64,
    /// Largest energy given to the hand round a loop, and the energy exchanged in it.
    pumped_mj: f64,
    exchanged_mj: f64,
    extrapolated_share: f64,
    landings: u64,
    lost: u64,
    /// Jumps of the true force.
    folds: Vec<Fold>,
    checked: usize,
    #[serde(skip)]
    rows: Vec<Row>,
}

/// The felt and the true force at one time.
#[derive(Debug, Clone, Copy)]
struct Row {
    ms: usize,
    /// Whether the body has landed on another branch since the row before.
    lands: bool,
    control_m: V,
    felt_n: V,
    true_n: V,
}

impl Outcome {
    pub(super) const HEAD: &str = "hand      peak mm/s  solves x ms (longest)  busy %  error mN: mean   p99   max  not felt % (of)  hand-over mN  pumped mJ of    extrapolated %  landings lost  folds: ms late, jump, error at most mN";

    pub(super) fn line(&self) -> String {
        format!(
            "{:9} {:9.0}  {:6} x {:<5.1} ({:>5.1})  {:6.1}  {:14.1} {:5.1} {:5.1}  {:10.2} {:>5}  {:12.1}  {:9.3} {:<6.1} {:10.2}  {:8} {:4}  {}",
            self.hand,
            self.peak_mm_s,
            self.jets,
            self.mean_solve_ms,
            self.longest_solve_ms,
            100.0 * self.busy_share,
            self.error_mean_mn,
            self.error_p99_mn,
            self.error_max_mn,
            100.0 * self.not_felt_share,
            format!("({})", self.checked),
            self.handover_max_mn,
            self.pumped_mj,
            self.exchanged_mj,
            100.0 * self.extrapolated_share,
            self.landings,
            self.lost,
            self.folds_line(),
        )
    }

    /// Number of folds, the latest landing, the largest jump and the largest error there.
    fn folds_line(&self) -> String {
        let largest = |of: fn(&Fold) -> f64| self.folds.iter().map(of).fold(0.0, f64::max);
        match self.folds.len() {
            0 => "-".into(),
            n => format!(
                "{n}: {:.0}, {:.0}, {:.0}",
                largest(|fold| fold.landed_ms as f64),
                largest(|fold| fold.jump_mn),
                largest(|fold| fold.error_max_mn.max(fold.before_max_mn))
            ),
        }
    }
}

/// A jump of the true force to another branch.
#[derive(Debug, Clone, Copy, Serialize)]
struct Fold {
    ms: usize,
    /// The step of the true force beyond that of the motion.
    jump_mn: f64,
    /// Time until the error of the felt force is not felt.
    landed_ms: usize,
    /// Largest error until then, and in the time before the jump.
    error_max_mn: f64,
    before_max_mn: f64,
}

/// Time before a jump in which the felt force may already change, ms.
const BEFORE_MS: usize = 100;

impl Fold {
    /// The folds in these rows.
    fn all(rows: &[Row]) -> Vec<Self> {
        let at = |k: usize| Self::at(rows, k);
        (2..rows.len()).filter(|&k| rows[k].lands).map(at).collect()
    }

    /// The fold before row k.
    fn at(rows: &[Row], k: usize) -> Self {
        let error = |row: &Row| (row.felt_n - row.true_n).norm();
        let [earlier, before, now] = [&rows[k - 2], &rows[k - 1], &rows[k]];
        let steady = before.true_n - earlier.true_n;
        let is_unfelt = |row: &&Row| error(row) <= Tolerance::IMPERCEPTIBLE.of_size(row.true_n.norm());
        let landed = rows[k..].iter().find(is_unfelt).or(rows.last()).unwrap_or(now);
        let most = |from: usize, to: usize| {
            let within = rows.iter().filter(|row| (from..to).contains(&row.ms));
            1e3 * within.map(error).fold(0.0, f64::max)
        };
        Self {
            ms: now.ms,
            jump_mn: 1e3 * (now.true_n - before.true_n - steady).norm(),
            landed_ms: landed.ms - now.ms,
            error_max_mn: most(now.ms, landed.ms + 1),
            before_max_mn: most(now.ms.saturating_sub(BEFORE_MS), now.ms),
        }
    }
}

/// The felt and true forces of all hands.
pub(super) fn csv(outcomes: &[Outcome]) -> Result<Vec<u8>, Failure> {
    let mut text = String::from(
        "hand,t_ms,dx_m,dy_m,dz_m,felt_fx_n,felt_fy_n,felt_fz_n,true_fx_n,true_fy_n,true_fz_n\n",
    );
    for outcome in outcomes {
        for row in &outcome.rows {
            text.push_str(&format!("{},{}", outcome.hand, row.ms));
            for value in row.control_m.iter().chain(row.felt_n.iter()).chain(row.true_n.iter()) {
                text.push_str(&format!(",{value:e}"));
            }
            text.push('\n');
        }
    }
    Ok(text.into_bytes())
}

/// The ticks of one hand.
struct Ticks {
    felt_n: Vec<V>,
    extrapolated: usize,
    first_force_ms: usize,
    handover_n: f64,
}

/// What the solver spent beside the ticks.
#[derive(Default)]
struct Spent {
    solving_ms: f64,
    longest_ms: f64,
    busy_s: f64,
}

/// Forces of the loop at every millisecond of a hand, N, without their comparison. The time is simulated: a solve
/// takes `slower` times as long as on this CPU.
pub(in crate::cmd::bench) fn felt_forces(
    solver: &mut LiveSolver,
    contact: u16,
    control_m: &[V],
    slower: f64,
) -> Vec<V> {
    follow(solver, contact, control_m, slower).0.felt_n
}

/// A solver beside a loop in simulated time, with the loop's memory of its jets.
pub(in crate::cmd::bench) struct Beside<'s> {
    solver: &'s mut LiveSolver,
    contact: u16,
    /// A solve takes so many times as long as on this CPU.
    slower: f64,
    memory: Box<JetMemory<8, 256>>,
    sequence: u32,
    /// When the jets of the present solve are known to the loop, and when the solver is free, ms.
    solved_ms: Option<f64>,
    free_ms: f64,
    at_m: V,
    velocity_m_s: V,
    spent: Spent,
    /// Time in calls of the solver since it was last taken.
    solving: Duration,
    begun_ns: u64,
}

impl<'s> Beside<'s> {
    /// A solver that has solved what a tool that comes near finds solved.
    pub(in crate::cmd::bench) fn new(solver: &'s mut LiveSolver, contact: u16, at_m: V, slower: f64) -> Self {
        solver.renew_beside(lower_priority);
        let mut beside = Self {
            solver,
            contact,
            slower,
            memory: Box::default(),
            sequence: 0,
            solved_ms: None,
            free_ms: 0.0,
            at_m,
            velocity_m_s: V::zeros(),
            spent: Spent::default(),
            solving: Duration::ZERO,
            begun_ns: 0,
        };
        beside.solve_near();
        beside.begun_ns = cpu_ns();
        beside
    }

    /// Solves near the place until all is known there, within the longest wait.
    fn solve_near(&mut self) {
        let near = Seen { touch: Some(touch(self.contact, &self.at_m)), ..Seen::default() };
        let mut waited_s = 0.0;
        while waited_s < LONGEST_WAIT_S {
            let start = Instant::now();
            if self.solver.step(&near) == Step::Idle {
                if !self.solver.is_renewing() {
                    return;
                }
                std::thread::sleep(Duration::from_millis(1));
                continue;
            }
            let solve_s = self.slower * start.elapsed().as_secs_f64();
            waited_s += solve_s;
            self.solver.took(solve_s);
            self.publish();
        }
    }

    fn publish(&mut self) {
        while let Some(published) = self.solver.published() {
            self.memory.insert(&published.jet(self.sequence));
            self.sequence += 1;
        }
    }

    /// The solver's work until now, `period_s` after the last call; the tool is displaced by `d`.
    fn advance(&mut self, now_ms: f64, period_s: f64, d: &V) {
        let expected = self.at_m + self.velocity_m_s * period_s;
        self.at_m = expected + (d - expected) * ALPHA;
        self.velocity_m_s += (d - expected) * (BETA / period_s);
        loop {
            if self.solved_ms.is_some_and(|at_ms| at_ms <= now_ms) {
                self.solved_ms = None;
                self.publish();
            }
            if self.solved_ms.is_some() || self.free_ms > now_ms {
                return;
            }
            let seen = Seen {
                hip_m: (*d).into(),
                velocity_m_s: self.velocity_m_s.into(),
                touch: Some(touch(self.contact, d)),
                partner: None,
                axis: None,
            };
            let start = Instant::now();
            let step = self.solver.step(&seen);
            let seconds = self.slower * start.elapsed().as_secs_f64();
            if step == Step::Idle {
                self.free_ms = now_ms + 1e3 * period_s;
                if self.solver.is_renewing() {
                    // The factor is made in the time of the CPU.
                    std::thread::sleep(Duration::from_secs_f64(period_s / self.slower));
                }
                return;
            }
            self.solver.took(seconds);
            self.spent.solving_ms += 1e3 * seconds;
            self.spent.longest_ms = self.spent.longest_ms.max(1e3 * seconds);
            self.free_ms = self.free_ms.max(now_ms - 1e3 * period_s) + 1e3 * seconds;
            self.solved_ms = Some(self.free_ms);
        }
    }

    /// The force of the jets at a touch of the one contact, `period_s` after the last one.
    pub(in crate::cmd::bench) fn force(&mut self, touch: &palpate_core::Touch, period_s: f64) -> ForceSample {
        let d = V::from(touch.displacement_m.map(f64::from));
        let begun = Instant::now();
        self.advance(1e-3 * touch.now_us as f64, period_s, &d);
        self.solving += begun.elapsed();
        let mut weights = [NodeWeight::default(); 3];
        weights[0] = NodeWeight { space: self.contact, weight: 1.0 };
        let touch = palpate_core::Touch { weights, ..*touch };
        self.memory.force(&touch).expect("a jet memory always answers")
    }

    /// The time of the solver in the forces since the last call.
    pub(in crate::cmd::bench) fn take_solving(&mut self) -> Duration {
        std::mem::take(&mut self.solving)
    }

    /// The memory of the loop.
    pub(in crate::cmd::bench) fn memory(&self) -> &JetMemory<8, 256> {
        &self.memory
    }

    /// The same, to tell it what happens.
    pub(in crate::cmd::bench) fn memory_mut(&mut self) -> &mut JetMemory<8, 256> {
        &mut self.memory
    }

    fn spent(self) -> Spent {
        let busy_s = self.slower * 1e-9 * (cpu_ns() - self.begun_ns) as f64;
        Spent { busy_s, ..self.spent }
    }
}

/// The ticks along a hand.
fn follow(solver: &mut LiveSolver, contact: u16, control_m: &[V], slower: f64) -> (Ticks, Spent) {
    let mut beside = Beside::new(solver, contact, control_m[0], slower);
    let mut ticks =
        Ticks { felt_n: Vec::new(), extrapolated: 0, first_force_ms: usize::MAX, handover_n: 0.0 };
    for (ms, d) in control_m.iter().enumerate() {
        let d = d.map(|x| x as f32).into();
        let touch = palpate_core::Touch {
            now_us: 1000 * ms as u64,
            weights: [NodeWeight::default(); 3],
            displacement_m: d,
            hip_m: d,
            half_axis_m: None,
        };
        let answer = beside.force(&touch, 1e-3);
        let is_covered = answer.coverage != Coverage::Extrapolated;
        ticks.extrapolated += usize::from(!is_covered);
        if is_covered && ticks.first_force_ms == usize::MAX {
            ticks.first_force_ms = ms;
        }
        ticks.handover_n = ticks.handover_n.max(f64::from(beside.memory.fade_step_n()));
        ticks.felt_n.push(V::from(answer.force_n.map(f64::from)));
    }
    (ticks, beside.spent())
}

pub(super) fn run(
    solver: &mut LiveSolver,
    contact: u16,
    hand: &Hand,
    slower: f64,
    every: usize,
) -> Result<Outcome, Failure> {
    let (ticks, Spent { solving_ms, longest_ms, busy_s }) = follow(solver, contact, &hand.control_m, slower);
    let totals = solver.totals();
    let rows = rows(solver, contact, hand, &ticks.felt_n, every)?;
    let first = ticks.first_force_ms;
    let rows: Vec<Row> = rows.into_iter().filter(|row| row.ms >= first).collect();
    let mut errors: Vec<(f64, f64)> =
        rows.iter().map(|row| ((row.felt_n - row.true_n).norm(), row.true_n.norm())).collect();
    errors.sort_by(|a, b| a.0.total_cmp(&b.0));
    let unfelt = errors.iter().filter(|(e, h)| *e <= Tolerance::IMPERCEPTIBLE.of_size(*h)).count();
    let quantile = |q: f64| errors.get(((errors.len() - 1) as f64 * q) as usize).map_or(0.0, |e| 1e3 * e.0);
    let works = hand.loops.iter().map(|&(from, to)| loop_work(hand, &ticks.felt_n, from, to));
    let (pumped_j, exchanged_j) =
        works.fold((f64::NEG_INFINITY, 0.0), |most: (f64, f64), one| if one.0 > most.0 { one } else { most });
    let peak = hand.control_m.windows(2).map(|w| (w[1] - w[0]).norm()).fold(0.0, f64::max);
    Ok(Outcome {
        hand: hand.name,
        peak_mm_s: 1e6 * peak,
        jets: totals.jets,
        mean_solve_ms: solving_ms / (totals.jets + totals.lost).max(1) as f64,
        longest_solve_ms: longest_ms,
        busy_share: 1e3 * busy_s / hand.control_m.len() as f64,
        first_force_ms: first,
        error_mean_mn: 1e3 * errors.iter().map(|e| e.0).sum::<f64>() / errors.len().max(1) as f64,
        error_p99_mn: quantile(0.99),
        error_max_mn: quantile(1.0),
        not_felt_share: unfelt as f64 / errors.len().max(1) as f64,
        handover_max_mn: 1e3 * ticks.handover_n,
        pumped_mj: if hand.loops.is_empty() { 0.0 } else { 1e3 * pumped_j },
        exchanged_mj: 1e3 * exchanged_j,
        extrapolated_share: ticks.extrapolated as f64 / hand.control_m.len() as f64,
        landings: totals.landings,
        lost: totals.lost,
        folds: Fold::all(&rows),
        checked: errors.len(),
        rows,
    })
}

/// The tool at the control `d` of one contact.
pub(in crate::cmd::bench) fn touch(contact: u16, d: &V) -> Touch {
    Touch { contacts: [(contact, 1.0), (0, 0.0), (0, 0.0)], control_m: (*d).into() }
}

fn rows(
    solver: &LiveSolver,
    contact: u16,
    hand: &Hand,
    felt_n: &[V],
    every: usize,
) -> Result<Vec<Row>, Failure> {
    let mut truth = Truth::new(solver);
    (0..hand.control_m.len())
        .step_by(every.max(1))
        .map(|ms| {
            let control_m = hand.control_m[ms];
            let before = truth.landings();
            let true_n = truth.force_n(&touch(contact, &control_m)).map_err(Failure::work)?;
            let lands = truth.landings() > before;
            Ok(Row { ms, lands, control_m, felt_n: felt_n[ms], true_n: true_n.into() })
        })
        .collect()
}

/// Work on the hand between two ticks, and the work that was exchanged.
fn loop_work(hand: &Hand, felt_n: &[V], from: usize, to: usize) -> (f64, f64) {
    let works = (from..to).map(|k| {
        // The hand gets -h.
        -0.5 * (felt_n[k] + felt_n[k + 1]).dot(&(hand.control_m[k + 1] - hand.control_m[k]))
    });
    works.fold((0.0, 0.0), |(sum, all), work| (sum + work, all + work.abs()))
}
