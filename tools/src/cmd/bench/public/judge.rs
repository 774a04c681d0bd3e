//! Judges forces against the questions. The own methods and other systems are judged by the same functions.

use palpate_precompute::certificate::{Compared, Errors};

use super::answers::Forces;
use super::figures::{Best, Judged};
use super::questions::{Questions, Vec3, Way};

/// A position that was solved and answered.
type Pair = (Vec3, Vec3);

/// Least number of errors that have a 99th percentile other than the largest.
const PERCENTILE: usize = 100;

/// Errors over the answered ones of `asked` positions: mean, 99th percentile and maximum of |h - h~| in mN, and the
/// share that cannot be felt. Fewer than 100 have no 99th percentile.
fn errors(key: &str, name: &str, answered: &[Pair], asked: usize) -> Vec<Judged> {
    let compared: Vec<Compared> =
        answered.iter().map(|&(truth_n, found_n)| Compared { truth_n, found_n, covered: true }).collect();
    let found = (!compared.is_empty()).then(|| Errors::of(&compared));
    let figure = |part: &str, unit: &str, best: Best, of: &dyn Fn(&Errors) -> f64| Judged {
        key: format!("{key}{part}"),
        name: format!("{name}{unit}"),
        best,
        value: found.as_ref().map(of),
    };
    let mut judged = vec![figure("mean_mn", "mean error, mN", Best::Least, &|e| 1e3 * e.mean_n)];
    if asked >= PERCENTILE {
        let of = |e: &Errors| if e.count < PERCENTILE { f64::NAN } else { 1e3 * e.p99_n };
        let mut row = figure("p99_mn", "99th percentile, mN", Best::Least, &of);
        row.value = row.value.filter(|value| value.is_finite());
        judged.push(row);
    }
    let largest = format!("largest of {asked} errors, mN");
    judged.extend([
        figure("max_mn", &largest, Best::Least, &|e| 1e3 * e.max_n),
        figure("not_felt_percent", "not felt, %", Best::Most, &|e| {
            100.0 * e.below_jnd as f64 / e.count.max(1) as f64
        }),
    ]);
    judged
}

/// Row of the share of the questions that were answered, %.
pub(super) const ANSWERED: &str = "answered_percent";

/// Share of the questions that were answered; `None` if none was.
fn answered(count: usize, asked: usize) -> Judged {
    Judged {
        key: ANSWERED.into(),
        name: "answered, %".into(),
        best: Best::None,
        value: (count > 0).then(|| 100.0 * count as f64 / asked.max(1) as f64),
    }
}

/// Errors at the independent positions.
pub(super) fn positions(questions: &Questions, forces: &Forces) -> Vec<Judged> {
    let pairs = questions.positions.iter().zip(&forces.positions);
    let found: Vec<Pair> = pairs.filter_map(|(at, found)| Some((at.truth_n, (*found)?))).collect();
    let asked = questions.positions.len();
    let mut judged = errors("", "", &found, asked);
    judged.push(answered(found.len(), asked));
    judged
}

/// Errors along each hand, at the ticks that were solved.
pub(super) fn hands(questions: &Questions, forces: &Forces) -> Vec<Judged> {
    let (mut judged, mut count, mut asked) = (Vec::new(), 0, 0);
    for (way, found) in questions.hands.iter().zip(&forces.hands) {
        let pairs = way.truth_n.iter().zip(found);
        let found: Vec<Pair> = pairs.filter_map(|(truth, found)| Some(((*truth)?, (*found)?))).collect();
        let solved = way.truth_n.iter().flatten().count();
        (count, asked) = (count + found.len(), asked + solved);
        judged.extend(errors(&format!("{}.", way.name), &format!("{}: ", way.name), &found, solved));
    }
    judged.push(answered(count, asked));
    judged
}

/// Net energy given to the hand round a loop, and the energy exchanged in it, J; `None` unless all of it is
/// answered.
///
/// The hand receives -h, so the work on it is - sum (h_k + h_k+1) / 2 . (d_k+1 - d_k).
pub(super) fn loop_work(way: &Way, forces: &[Option<Vec3>]) -> Option<(f64, f64)> {
    let (d, h) = (way.displacement_m.get(way.counted_from..)?, forces.get(way.counted_from..)?);
    let h: Vec<Vec3> = h.iter().copied().collect::<Option<_>>()?;
    let works = d.windows(2).zip(h.windows(2)).map(|(d, h)| -> f64 {
        (0..3).map(|axis| -0.5 * (h[0][axis] + h[1][axis]) * (d[1][axis] - d[0][axis])).sum()
    });
    Some(works.fold((0.0, 0.0), |(net, all), work| (net + work, all + work.abs())))
}

/// Energy round the closed loops.
pub(super) fn energy(questions: &Questions, forces: &Forces) -> Vec<Judged> {
    let pairs = questions.loops.iter().zip(&forces.loops);
    let works: Vec<(f64, f64)> = pairs.filter_map(|(way, found)| loop_work(way, found)).collect();
    let worst = works.iter().copied().max_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
    let share = |(net, all): &(f64, f64)| net.abs() / all.max(f64::MIN_POSITIVE);
    let mean = works.iter().map(share).sum::<f64>() / works.len().max(1) as f64;
    let figure = |key: &str, name: &str, best: Best, value: Option<f64>| Judged {
        key: key.into(),
        name: name.into(),
        best,
        value,
    };
    let is_answered = |value: f64| (!works.is_empty()).then_some(value);
    vec![
        figure("net_mj", "largest net energy of a loop, mJ", Best::Least, worst.map(|w| 1e3 * w.0.abs())),
        figure("exchanged_mj", "energy exchanged in that loop, mJ", Best::None, worst.map(|w| 1e3 * w.1)),
        figure(
            "share_percent",
            "net of exchanged, mean over the loops, %",
            Best::Least,
            is_answered(100.0 * mean),
        ),
        answered(works.len(), questions.loops.len()),
    ]
}

#[cfg(test)]
mod tests;
