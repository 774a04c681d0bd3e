//! Round marks of a scale: four to six values of one, two or five times a power of ten.

/// Fewest and most marks.
const COUNT: core::ops::RangeInclusive<usize> = 4..=6;
/// Ratios of the ends of a logarithmic scale: up to the first it has evenly spaced marks, up to the second
/// where no others suit, and beyond it none.
const SMALL_RATIOS: [f64; 2] = [4.0, 10.0];
/// Sets of marks of a logarithmic scale: the values in each decade, and the decades from mark to mark.
const DECADES: [(&[f64], i32); 7] = [
    (&[1.0, 2.0, 5.0], 1),
    (&[1.0, 5.0], 1),
    (&[1.0], 1),
    (&[1.0], 2),
    (&[1.0], 3),
    (&[1.0], 5),
    (&[1.0], 10),
];

/// A scale: its ends and its marks, ascending.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scale {
    pub(super) ends: [f32; 2],
    pub(super) marks: Vec<f32>,
}

/// The scale of finite values from `low` to `high`, `low < high`; both are positive if it is logarithmic.
///
/// The ends are moved out to the next marks only where no round step has four to six marks between them.
pub(super) fn scale([low, high]: [f32; 2], is_logarithmic: bool) -> Scale {
    let ends = [low, high].map(f64::from);
    let beyond = |ratio: f64| is_logarithmic && ends[1] > ratio * ends[0];
    let mut steps = if beyond(SMALL_RATIOS[0]) { decades(ends) } else { Vec::new() };
    if !beyond(SMALL_RATIOS[1]) {
        steps.extend(even(ends));
    }
    let found = steps.iter().find_map(|marks| inside(ends, marks).map(|marks| (ends, marks)));
    let found = found.or_else(|| steps.iter().find_map(|marks| round_it(ends, marks)));
    let ([low, high], marks) = found.unwrap_or((ends, ends.to_vec()));
    Scale { ends: [low as f32, high as f32], marks: marks.iter().map(|mark| *mark as f32).collect() }
}

/// Marks of every even step that may serve, with at least one beyond each end; the smallest step first.
fn even([low, high]: [f64; 2]) -> Vec<Vec<f64>> {
    let decade = (high - low).log10().floor() as i32 - 1;
    let steps = (decade..decade + 3).flat_map(|decade| [1.0, 2.0, 5.0].map(|step| (step, decade)));
    let marks = |(step, decade): (f64, i32)| {
        // A division by a whole power of ten keeps 0.1, 0.2 .. exact to the last digit.
        let at = |n: i64| {
            if decade < 0 {
                n as f64 * step / 10_f64.powi(-decade)
            } else {
                n as f64 * step * 10_f64.powi(decade)
            }
        };
        let width = at(1);
        ((low / width).floor() as i64..=(high / width).ceil() as i64).map(at).collect()
    };
    steps.map(marks).collect()
}

/// Marks of every set of [`DECADES`], with at least one beyond each end.
fn decades([low, high]: [f64; 2]) -> Vec<Vec<f64>> {
    let of = |(values, every): (&[f64], i32)| {
        let (first, last) = (low.log10().floor() as i32, high.log10().ceil() as i32);
        let all: Vec<f64> = (first.div_euclid(every)..=last.div_euclid(every) + 1)
            .flat_map(|n| values.iter().map(move |value| value * 10_f64.powi(n * every)))
            .collect();
        let (from, to) = (all.partition_point(|mark| *mark <= low), all.partition_point(|mark| *mark < high));
        all[from.saturating_sub(1)..=to.min(all.len() - 1)].to_vec()
    };
    DECADES.into_iter().map(of).collect()
}

/// The marks between the ends, if their number suits.
fn inside([low, high]: [f64; 2], marks: &[f64]) -> Option<Vec<f64>> {
    // A mark at an end may be a rounding error beyond it.
    let within = low - 1e-6 * low.abs()..=high + 1e-6 * high.abs();
    let all: Vec<f64> = marks.iter().copied().filter(|mark| within.contains(mark)).collect();
    COUNT.contains(&all.len()).then_some(all)
}

/// Ends at the marks beyond them, if the number of marks then suits.
fn round_it(ends: [f64; 2], marks: &[f64]) -> Option<([f64; 2], Vec<f64>)> {
    let (&[.., last], &[first, ..]) = (marks, marks) else { return None };
    (COUNT.contains(&marks.len()) && first <= ends[0] && ends[1] <= last)
        .then(|| ([first, last], marks.to_vec()))
}

/// A mark as text of at most five characters, a sign apart: thousands and millions by letter.
pub(super) fn label(mark: f32) -> String {
    let rounded = |x: f64| {
        let text = format!("{x:.3}");
        text.trim_end_matches('0').trim_end_matches('.').to_owned()
    };
    let x = f64::from(mark);
    match x.abs() {
        0.0 => "0".into(),
        1e9.. => format!("{x:.0e}"),
        1e6.. => format!("{}M", rounded(x * 1e-6)),
        1e4.. => format!("{}k", rounded(x * 1e-3)),
        1e-3.. => rounded(x),
        _ => format!("{x:.0e}"),
    }
}

/// The largest of one, two or five times a power of ten that is at most `most`.
pub(super) fn round_below(most: f32) -> f32 {
    let decade = 10_f32.powf(most.log10().floor());
    [5.0, 2.0].into_iter().map(|factor| factor * decade).find(|x| *x <= most).unwrap_or(decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a mark is one, two or five times a power of ten.
    fn is_round(x: f32) -> bool {
        let digits = format!("{x:.5e}");
        let (mantissa, _) = digits.split_once('e').expect("a power");
        ["1.00000", "2.00000", "5.00000"].contains(&mantissa)
    }

    #[test]
    fn every_range_has_four_to_six_round_marks() {
        let ends: Vec<f32> = (0..60).map(|n| 1.3e-2 * 1.37_f32.powi(n)).collect();
        for (at, &low) in ends.iter().enumerate() {
            for &high in &ends[at + 1..] {
                for is_logarithmic in [false, true] {
                    let Scale { ends: [from, to], marks } = scale([low, high], is_logarithmic);
                    let what =
                        format!("{low} to {high}, logarithmic {is_logarithmic}: {from} {to} {marks:?}");
                    assert!((4..=6).contains(&marks.len()), "{what}");
                    assert!(marks.windows(2).all(|pair| pair[0] < pair[1]), "{what}");
                    let slack = 1e-5 * (to - from);
                    assert!(from - slack <= marks[0] && marks[marks.len() - 1] <= to + slack, "{what}");
                    assert!(from <= low * 1.000_01 && high <= to * 1.000_01, "{what}");
                    assert!(marks.iter().all(|mark| label(*mark).len() <= 5), "{what}");
                    let all_round = marks.iter().all(|mark| is_round(*mark));
                    assert!(all_round || !is_logarithmic || high < 10.0 * low, "{what}");
                    if !(all_round && is_logarithmic) {
                        let step = marks[1] - marks[0];
                        assert!(is_round((1e4 * step).round() * 1e-4), "{what}");
                        let multiple = |mark: &f32| (mark / step - (mark / step).round()).abs() < 1e-3;
                        assert!(marks.iter().all(multiple), "{what}");
                    }
                }
            }
        }
    }

    #[test]
    fn known_ranges_have_known_marks() {
        let marks = |ends, is_logarithmic| scale(ends, is_logarithmic).marks;
        assert_eq!(marks([0.0, 1.0], false), [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]);
        assert_eq!(marks([0.1, 10.9], false), [2.0, 4.0, 6.0, 8.0, 10.0]);
        assert_eq!(marks([-0.3, 2.1], false), [0.0, 0.5, 1.0, 1.5, 2.0]);
        assert_eq!(marks([300.0, 450.0], true), [300.0, 350.0, 400.0, 450.0]);
        assert_eq!(marks([3.0, 300.0], true), [5.0, 10.0, 20.0, 50.0, 100.0, 200.0]);
        assert_eq!(marks([0.5, 2.0e6], true), [1.0, 100.0, 1e4, 1e6]);
        let rounded = scale([0.1, 14.0], false);
        assert_eq!((rounded.ends, rounded.marks), ([0.0, 15.0], vec![0.0, 5.0, 10.0, 15.0]));
        let text: Vec<String> =
            [0.0, 0.02, 0.5, 1.0, -250.0, 9_000.0, 20_000.0, 1.5e6, 2e-5].map(label).to_vec();
        assert_eq!(text, ["0", "0.02", "0.5", "1", "-250", "9000", "20k", "1.5M", "2e-5"]);
        assert_eq!([0.9, 1.0, 4.9, 5.0, 23.0].map(round_below), [0.5, 1.0, 2.0, 5.0, 20.0]);
    }
}
