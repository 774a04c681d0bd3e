//! A quantity over time in a bounded number of columns.
//!
//! The length of a recording is known only at its end, and its ticks may exceed the memory. So a column first holds one
//! tick. When one is needed beyond the last, each two neighbours become one of twice the width.

/// Largest number of columns: about two for each unit of the drawing at most.
const MAX_COLUMNS: u64 = 1600;
/// A longer time without a value than this many columns is a gap.
const GAP: f64 = 2.5;

/// The content of a column, which can take that of the next one.
pub(super) trait Join {
    /// Takes the content of a later column.
    fn join(&mut self, later: Self);
}

/// A condition that held at some time in the column.
impl Join for () {
    fn join(&mut self, (): Self) {}
}

/// The smallest and the largest value of a column, each with its time, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Extremes {
    low: [f64; 2],
    high: [f64; 2],
}

impl Extremes {
    pub(super) const fn of(point: [f64; 2]) -> Self {
        Self { low: point, high: point }
    }
}

impl Join for Extremes {
    fn join(&mut self, later: Self) {
        if later.low[1] < self.low[1] {
            self.low = later.low;
        }
        if later.high[1] > self.high[1] {
            self.high = later.high;
        }
    }
}

/// Columns of equal width over time.
#[derive(Debug, Clone)]
pub(super) struct Columns<T> {
    from_us: u64,
    width_us: u64,
    columns: Vec<Option<T>>,
}

impl<T: Join> Columns<T> {
    /// From this time on, with columns of one period at first.
    pub(super) fn new(from_us: u64, period_us: u32) -> Self {
        Self { from_us, width_us: u64::from(period_us.max(1)), columns: Vec::new() }
    }

    /// Adds a value at a time that is not before the beginning.
    pub(super) fn add(&mut self, t_us: u64, value: T) {
        let column = self.column(t_us);
        match &mut self.columns[column] {
            Some(before) => before.join(value),
            empty => *empty = Some(value),
        }
    }

    /// The index of the column at a time, which exists afterwards.
    fn column(&mut self, t_us: u64) -> usize {
        let after_us = t_us.saturating_sub(self.from_us);
        while after_us / self.width_us >= MAX_COLUMNS {
            self.width_us = self.width_us.saturating_mul(2);
            let mut old = std::mem::take(&mut self.columns).into_iter();
            while let Some(first) = old.next() {
                self.columns.push(joined(first, old.next().flatten()));
            }
        }
        let column = (after_us / self.width_us) as usize;
        if column >= self.columns.len() {
            self.columns.resize_with(column + 1, || None);
        }
        column
    }

    fn width_s(&self) -> f64 {
        self.width_us as f64 * 1e-6
    }
}

fn joined<T: Join>(first: Option<T>, second: Option<T>) -> Option<T> {
    match (first, second) {
        (Some(mut first), Some(second)) => {
            first.join(second);
            Some(first)
        }
        (first, second) => first.or(second),
    }
}

impl Columns<()> {
    /// Adds all of a time.
    pub(super) fn add_span(&mut self, from_us: u64, until_us: u64) {
        // The last one first: it may change the width.
        let last = self.column(until_us);
        let first = self.column(from_us.min(until_us));
        self.columns[first..=last].fill(Some(()));
    }

    /// Beginnings and ends of the times in which the condition held, s.
    pub(super) fn spans(&self) -> Vec<[f64; 2]> {
        let edge = |column: usize| self.from_us as f64 * 1e-6 + column as f64 * self.width_s();
        let mut spans: Vec<[f64; 2]> = Vec::new();
        let mut was_on = false;
        for (n, column) in self.columns.iter().enumerate() {
            match (was_on, column) {
                (true, Some(())) => spans.last_mut().expect("one has begun")[1] = edge(n + 1),
                (false, Some(())) => spans.push([edge(n), edge(n + 1)]),
                (_, None) => {}
            }
            was_on = column.is_some();
        }
        spans
    }
}

impl Columns<Extremes> {
    /// The values as lines: the extremes of each column in the order of their times, without a line over a gap.
    pub(super) fn pieces(&self) -> Vec<Vec<[f64; 2]>> {
        let mut pieces: Vec<Vec<[f64; 2]>> = Vec::new();
        for Extremes { low, high } in self.columns.iter().flatten() {
            let (first, last) = if low[0] <= high[0] { (low, high) } else { (high, low) };
            let before = pieces.last().and_then(|piece| piece.last());
            if before.is_none_or(|before| first[0] - before[0] > GAP * self.width_s()) {
                pieces.push(Vec::new());
            }
            let piece = pieces.last_mut().expect("one has begun");
            piece.push(*first);
            if last[0] > first[0] {
                piece.push(*last);
            }
        }
        pieces
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trace(values: impl Fn(u64) -> Option<f64>, ticks: u64) -> Columns<Extremes> {
        let mut columns = Columns::new(0, 1000);
        for tick in 0..ticks {
            if let Some(value) = values(tick) {
                columns.add(1000 * tick, Extremes::of([tick as f64 * 1e-3, value]));
            }
        }
        columns
    }

    /// However long the recording is, a peak of one tick stays, at its time.
    #[test]
    fn no_peak_of_one_tick_is_lost() {
        for (ticks, peak, dip) in
            [(100, 7, 8), (1_601, 1_600, 0), (9_000, 4_321, 4_320), (3_600_000, 12_345, 3_599_999)]
        {
            let of = |tick| {
                Some(if tick == peak {
                    9.0
                } else if tick == dip {
                    -9.0
                } else {
                    0.001 * (tick % 7) as f64
                })
            };
            let columns = trace(of, ticks);
            assert!(
                columns.columns.len() as u64 <= MAX_COLUMNS
                    && 2 * columns.columns.len() as u64 >= ticks.min(MAX_COLUMNS)
            );
            let points = columns.pieces().concat();
            assert!(points.windows(2).all(|pair| pair[0][0] < pair[1][0]), "in the order of time");
            for (tick, value) in [(peak, 9.0), (dip, -9.0)] {
                assert!(points.contains(&[tick as f64 * 1e-3, value]), "{ticks} ticks: {value} at {tick}");
            }
        }
    }

    #[test]
    fn a_gap_parts_the_line_and_a_missing_tick_does_not() {
        let columns = trace(|tick| (tick != 20 && !(40..60).contains(&tick)).then_some(1.0), 100);
        let pieces = columns.pieces();
        let ends: Vec<[f64; 2]> =
            pieces.iter().map(|piece| [piece[0][0], piece[piece.len() - 1][0]]).collect();
        assert_eq!(ends, [[0.0, 0.039], [0.060, 0.099]]);
    }

    #[test]
    fn a_condition_of_one_tick_is_a_span_of_its_column() {
        let mut columns = Columns::<()>::new(5_000, 1000);
        columns.add(7_000, ());
        columns.add_span(9_000, 11_000);
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12;
        let is = |found: Vec<[f64; 2]>, expected: &[[f64; 2]]| {
            found.len() == expected.len()
                && found.iter().zip(expected).all(|(a, b)| near(a[0], b[0]) && near(a[1], b[1]))
        };
        assert!(is(columns.spans(), &[[0.007, 0.008], [0.009, 0.012]]), "{:?}", columns.spans());
        columns.add(5_000 + 1_600_000, ());
        assert!(is(columns.spans(), &[[0.007, 0.013], [1.605, 1.607]]), "{:?}", columns.spans());
    }

    /// A damaged time neither overflows nor takes the memory.
    #[test]
    fn every_time_has_a_column() {
        let mut columns = Columns::<()>::new(0, 1000);
        columns.add_span(0, u64::MAX);
        assert_eq!(columns.spans().len(), 1);
    }
}
