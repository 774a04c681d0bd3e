//! A factor LDL^T in 16 bits an entry, to solve with from any number of threads.
//!
//! A solve reads the whole factor twice and does little with an entry, so its time is mostly that of the memory: at 52,000
//! equations 22 ms instead of 32 with 32 bits an entry, for three columns 31 instead of 51. A column j of L is q_ij s_j with integers q_ij and s_j = max_i |L_ij| / 32,767,
//! which leaves an error of at most s_j / 2. (Half precision would leave one of L_ij / 2,048.) D, the vectors and the
//! sums are f32. The error is that of a preconditioner: it costs residual steps, no accuracy.
//!
//! Adjacent columns with the same rows below them are a block. Its rows, those of its own triangle first, are kept in
//! panels of 16, and a panel column by column, in the order in which both passes use them.

use faer::sparse::linalg::cholesky::{SymbolicCholeskyRaw, supernodal};
use pulp::{Simd, WithSimd};

use super::super::{Problem, pressure_share};
use super::RIGHT_SIDES;
use super::single::{SingleFactor, SingleScratch};
use super::symbolic::SymbolicFactor;
use crate::fem::assembly::Assembled;
use crate::fem::element::Order;
use crate::num::lanes;

/// Regularisation of the pressures without a block, V_i / mu: above the rounding of 16 bits. More costs P1/P1, which is not
/// inf-sup stable, many residual steps.
const DELTA: f64 = 1e-4;
/// Rows of a panel.
const PANEL: usize = 16;
/// Most columns of a block: their partial sums stay in the first cache.
pub(super) const COLUMNS: usize = 128;
/// Largest |q|.
const LARGEST: f32 = 32_767.0;

/// The regularisation in units of that of the analysis.
pub(super) fn delta(order: Order) -> f64 {
    DELTA / pressure_share(order)
}

/// One column of a panel.
type Strip = [i16; PANEL];

/// Adjacent columns with the same rows below them.
#[derive(Debug)]
struct Block {
    begin: usize,
    columns: usize,
    /// Where its strips begin: those of its triangle, then those of the panels below.
    strips: usize,
    /// Where the equations of the panels below begin and end. Those that fill the last panel are `unknowns`.
    rows: [usize; 2],
}

impl Block {
    /// Strips of the panels of the triangle before panel p, which end with its diagonal.
    fn before(&self, panel: usize) -> usize {
        (0..panel).map(|p| self.strips_of(p)).sum()
    }

    /// Strips of panel p of the triangle.
    fn strips_of(&self, panel: usize) -> usize {
        self.columns.min(PANEL * (panel + 1))
    }

    /// Panels of the triangle.
    fn panels(&self) -> usize {
        self.columns.div_ceil(PANEL)
    }

    /// Columns on the diagonal of panel p of the triangle.
    fn diagonal(&self, panel: usize) -> std::ops::Range<usize> {
        PANEL * panel..self.strips_of(panel)
    }
}

/// The factor.
#[derive(Debug)]
pub(in crate::fem::solve) struct PackedFactor {
    blocks: Vec<Block>,
    rows: Vec<u32>,
    strips: Vec<Strip>,
    /// s_j.
    steps: Vec<f32>,
    /// 1 / D_j.
    pivots: Vec<f32>,
    /// By equation, that of [`SingleFactor`].
    scale: Vec<f64>,
}

impl PackedFactor {
    /// That of the tangent at rest without a tool; `None` if it is singular.
    pub(in crate::fem::solve) fn at_rest(problem: &Problem) -> Option<Self> {
        let (body, pattern, symbolic) = (&problem.body, &problem.pattern, &problem.symbolic);
        let mut assembled = Assembled::new(body, pattern);
        assembled.assemble(body, pattern, &body.rest_state);
        let mut factor = SingleFactor::new(symbolic, problem.unknowns());
        let mut scratch = SingleScratch::new(symbolic, problem.unknowns());
        let made = factor.make(problem.matrix(&assembled.tangent), delta(body.order), &mut scratch);
        let is_stable = made && factor.unstable_modes(symbolic) == Some(0);
        is_stable.then(|| Self::new(symbolic, factor))?
    }

    /// Packs a factor of this analysis; `None` if it is not finite.
    pub(super) fn new(symbolic: &SymbolicFactor, from: SingleFactor) -> Option<Self> {
        let SymbolicCholeskyRaw::Supernodal(analysis) = symbolic.symbolic.raw() else { return None };
        let (values, scale) = from.into_parts();
        let factor = supernodal::SupernodalLdltRef::new(analysis, &values);
        let n = scale.len();
        let mut packed = Self {
            blocks: Vec::new(),
            rows: Vec::new(),
            strips: Vec::with_capacity(values.len() / PANEL),
            steps: Vec::with_capacity(n),
            pivots: Vec::with_capacity(n),
            scale,
        };
        for s in 0..analysis.n_supernodes() {
            let node = factor.supernode(s);
            let (begin, entries) = (node.start(), node.val());
            let equation = |row: usize| match row.checked_sub(entries.ncols()) {
                Some(below) => node.pattern()[below],
                None => begin + row,
            };
            for first in (0..entries.ncols()).step_by(COLUMNS) {
                let end = entries.ncols().min(first + COLUMNS);
                let below = (end..entries.nrows()).map(equation);
                packed.push(first + begin, end - first, below, |row, column| {
                    entries[(first + row, first + column)]
                });
            }
        }
        packed.strips.shrink_to_fit();
        let is_finite = |values: &[f32]| values.iter().all(|value| value.is_finite());
        (is_finite(&packed.steps) && is_finite(&packed.pivots)).then_some(packed)
    }

    /// Most columns of a block.
    #[cfg(test)]
    pub(super) fn widest(&self) -> usize {
        self.blocks.iter().map(|block| block.columns).max().unwrap_or(0)
    }

    /// Adds a block with these equations below it. Its entries are numbered from its own first row and column.
    fn push(
        &mut self,
        begin: usize,
        columns: usize,
        below: impl Iterator<Item = usize>,
        entry: impl Fn(usize, usize) -> f32,
    ) {
        let before = self.rows.len();
        self.rows.extend(below.map(|row| row as u32));
        let height = columns + self.rows.len() - before;
        self.rows.resize(before + (height - columns).next_multiple_of(PANEL), self.scale.len() as u32);
        for column in 0..columns {
            let largest = (column + 1..height).map(|row| entry(row, column).abs()).fold(0.0, f32::max);
            // A NaN would be left out of a maximum.
            let is_finite = (column + 1..height).all(|row| entry(row, column).is_finite());
            self.steps.push(if is_finite { largest / LARGEST } else { f32::NAN });
            self.pivots.push(1.0 / entry(column, column));
        }
        let block = Block { begin, columns, strips: self.strips.len(), rows: [before, self.rows.len()] };
        let steps = &self.steps[begin..];
        let strip = |first_row: usize, end: usize, column: usize| -> Strip {
            std::array::from_fn(|row| {
                let row = first_row + row;
                let is_below = row > column && row < end && steps[column] > 0.0;
                if is_below { (entry(row, column) / steps[column]).round() as i16 } else { 0 }
            })
        };
        for panel in 0..block.panels() {
            let strips = (0..block.strips_of(panel)).map(|column| strip(PANEL * panel, columns, column));
            self.strips.extend(strips);
        }
        for first_row in (columns..height).step_by(PANEL) {
            self.strips.extend((0..columns).map(|column| strip(first_row, height, column)));
        }
        self.blocks.push(block);
    }

    /// Replaces the columns r by M^-1 r.
    pub(in crate::fem::solve) fn solve(&self, columns: &mut [f64], scratch: &mut Vec<f32>) {
        lanes::dispatch(Work { factor: self, columns, scratch });
    }

    /// The same for C columns, by rows of C numbers of which the last one is zero.
    #[inline(always)]
    fn solve_rows<S: Simd, const C: usize>(&self, x: &mut [[f32; C]]) {
        let mut weighted = [[0.0; C]; COLUMNS];
        for block in &self.blocks {
            self.eliminate::<S, C>(block, x, &mut weighted[..block.columns]);
        }
        let mut products = [[[0.0; PANEL]; C]; COLUMNS];
        for block in self.blocks.iter().rev() {
            self.substitute::<S, C>(block, x, &mut products[..block.columns]);
        }
    }

    /// Forward: x := L_BB^-1 x in the rows of a block, x -= L x_B below. `weighted` is scratch for s_j x_j.
    #[inline(always)]
    fn eliminate<S: Simd, const C: usize>(
        &self,
        block: &Block,
        x: &mut [[f32; C]],
        weighted: &mut [[f32; C]],
    ) {
        let steps = &self.steps[block.begin..][..block.columns];
        let mut strips = &self.strips[block.strips..];
        let own = &mut x[block.begin..][..block.columns];
        for panel in 0..block.panels() {
            let diagonal = block.diagonal(panel);
            let mut sums = [[0.0f32; PANEL]; C];
            for (row, value) in own[diagonal.clone()].iter().enumerate() {
                (0..C).for_each(|c| sums[c][row] = value[c]);
            }
            let (panel, rest) = strips.split_at(diagonal.end);
            strips = rest;
            let (left, triangle) = panel.split_at(diagonal.start);
            for (weight, strip) in weighted[..diagonal.start].iter().zip(left) {
                subtract::<S, C>(&mut sums, strip, weight);
            }
            for (row, (column, strip)) in diagonal.clone().zip(triangle).enumerate() {
                weighted[column] = std::array::from_fn(|c| steps[column] * sums[c][row]);
                subtract::<S, C>(&mut sums, strip, &weighted[column]);
            }
            for (row, value) in own[diagonal].iter_mut().enumerate() {
                *value = std::array::from_fn(|c| sums[c][row]);
            }
        }
        let panels = strips.chunks_exact(block.columns);
        for (rows, panel) in self.rows[block.rows[0]..block.rows[1]].chunks_exact(PANEL).zip(panels) {
            let mut sums = [[0.0f32; PANEL]; C];
            for (weight, strip) in weighted.iter().zip(panel) {
                subtract::<S, C>(&mut sums, strip, weight);
            }
            for (at, &row) in rows.iter().enumerate() {
                let value = &mut x[row as usize];
                (0..C).for_each(|c| value[c] += sums[c][at]);
            }
        }
    }

    /// Backward: x_B := L_BB^-T (D^-1 x_B - L^T x below). `products` is scratch for the partial sums of L^T x.
    #[inline(always)]
    fn substitute<S: Simd, const C: usize>(
        &self,
        block: &Block,
        x: &mut [[f32; C]],
        products: &mut [[[f32; PANEL]; C]],
    ) {
        let steps = &self.steps[block.begin..][..block.columns];
        let pivots = &self.pivots[block.begin..][..block.columns];
        products.fill([[0.0; PANEL]; C]);
        let panels = self.strips[block.strips + block.before(block.panels())..].chunks_exact(block.columns);
        for (rows, panel) in self.rows[block.rows[0]..block.rows[1]].chunks_exact(PANEL).zip(panels) {
            let mut values = [[0.0f32; PANEL]; C];
            for (at, &row) in rows.iter().enumerate() {
                let value = &x[row as usize];
                (0..C).for_each(|c| values[c][at] = value[c]);
            }
            for (product, strip) in products.iter_mut().zip(panel) {
                add_products::<S, C>(product, strip, &values);
            }
        }
        let own = &mut x[block.begin..][..block.columns];
        for panel in (0..block.panels()).rev() {
            let diagonal = block.diagonal(panel);
            let strips = &self.strips[block.strips + block.before(panel)..][..block.strips_of(panel)];
            let mut values = [[0.0f32; PANEL]; C];
            for (row, column) in diagonal.clone().enumerate() {
                (0..C).for_each(|c| values[c][row] = own[column][c] * pivots[column]);
            }
            for (row, column) in diagonal.clone().enumerate().rev() {
                add_products::<S, C>(&mut products[column], &strips[column], &values);
                for c in 0..C {
                    values[c][row] -= steps[column] * sum(&products[column][c]);
                }
            }
            for (product, strip) in products[..diagonal.start].iter_mut().zip(strips) {
                add_products::<S, C>(product, strip, &values);
            }
            for (row, value) in own[diagonal].iter_mut().enumerate() {
                *value = std::array::from_fn(|c| values[c][row]);
            }
        }
    }
}

/// a b + c, in one operation where the machine has it.
#[inline(always)]
fn fused<S: Simd>(a: f32, b: f32, c: f32) -> f32 {
    if S::F32_LANES > 1 { a.mul_add(b, c) } else { a * b + c }
}

/// In four partial sums, which do not wait for each other.
#[inline(always)]
fn sum(values: &[f32; PANEL]) -> f32 {
    let [a, b, c, d] =
        std::array::from_fn(|k| (values[k] + values[k + 4]) + (values[k + 8] + values[k + 12]));
    (a + b) + (c + d)
}

/// sums -= q w.
#[inline(always)]
fn subtract<S: Simd, const C: usize>(sums: &mut [[f32; PANEL]; C], strip: &Strip, weight: &[f32; C]) {
    let entries = strip.map(f32::from);
    for (sum, weight) in sums.iter_mut().zip(weight) {
        sum.iter_mut().zip(&entries).for_each(|(sum, entry)| *sum = fused::<S>(-entry, *weight, *sum));
    }
}

/// product += q x, in partial sums.
#[inline(always)]
fn add_products<S: Simd, const C: usize>(
    product: &mut [[f32; PANEL]; C],
    strip: &Strip,
    values: &[[f32; PANEL]; C],
) {
    let entries = strip.map(f32::from);
    for (product, values) in product.iter_mut().zip(values) {
        for ((sum, entry), value) in product.iter_mut().zip(&entries).zip(values) {
            *sum = fused::<S>(*entry, *value, *sum);
        }
    }
}

/// A solve.
struct Work<'w> {
    factor: &'w PackedFactor,
    columns: &'w mut [f64],
    scratch: &'w mut Vec<f32>,
}

impl WithSimd for Work<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        match self.columns.len() / self.factor.scale.len() {
            1 => self.solve::<S, 1>(),
            2 => self.solve::<S, 2>(),
            _ => self.solve::<S, RIGHT_SIDES>(),
        }
    }
}

impl Work<'_> {
    /// Columns to rows and back. They are scaled to a largest component of one, so that their size does not matter.
    #[inline(always)]
    fn solve<S: Simd, const C: usize>(self) {
        let Self { factor, columns, scratch } = self;
        let n = factor.scale.len();
        scratch.resize(C * (n + 1), 0.0);
        let (x, _) = scratch.as_chunks_mut::<C>();
        x[n] = [0.0; C];
        let mut sizes = [0.0f64; C];
        for (c, (column, size)) in columns.chunks(n).zip(&mut sizes).enumerate() {
            let scaled = || column.iter().zip(&factor.scale).map(|(value, scale)| value * scale);
            *size = scaled().fold(0.0f64, |most, value| most.max(value.abs()));
            let unit = if *size > 0.0 { 1.0 / *size } else { 0.0 };
            x.iter_mut().zip(scaled()).for_each(|(row, value)| row[c] = (value * unit) as f32);
        }
        factor.solve_rows::<S, C>(x);
        for (c, (column, size)) in columns.chunks_mut(n).zip(sizes).enumerate() {
            for ((value, row), scale) in column.iter_mut().zip(&*x).zip(&factor.scale) {
                *value = f64::from(row[c]) * scale * size;
            }
        }
    }
}
