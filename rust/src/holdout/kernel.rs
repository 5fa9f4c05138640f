//! The kernel under every held-out pair: Cholesky factorisation of `C - X X^T`, with a border.
//!
//! A pair needs `I - Q_K^T Q_K` (primal) or `I - Q_K Q_K^T` (dual) formed, factored, and solved against the
//! residuals. All three are one recurrence. Write `W = [X | L]`, with `L` the factor under construction; then
//! the lower triangle of `L` is
//!
//! ```text
//! L_ij = (C_ij - sum_{t < terms + j} W_it W_jt) / L_jj
//! ```
//!
//! so the Gram matrix is never stored on its own. Rows below the first `order` ones (the *border*) follow the same
//! recurrence and come out as forward solves: a row `c` with terms `x` becomes `L^-1 (c - X x)`.
//!
//! Storage is in panels of eight rows: a panel holds its columns one after another, eight contiguous
//! numbers each, so that every load of the inner loop is contiguous and aligned whatever the vector width.

use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use crate::fit::panels::PANEL;
use crate::holdout::gram::Gram;

/// Panels of columns factored between two long updates: 64 columns of a few hundred terms stay in the second-level cache.
const BLOCK_PANELS: usize = 8;

/// Workspace of the bordered factorisation. Reused from pair to pair; grows, never shrinks.
#[derive(Default)]
pub struct Bordered {
    storage: Vec<f64>,
    skip: usize,
    shape: Shape,
    inverse_pivots: Vec<f64>,
    solution: Vec<f64>,
    /// Rows that came after the factorisation, and became forward solves: panels of `order` columns.
    carried: Vec<f64>,
}

#[derive(Clone, Copy, Default)]
struct Shape {
    order: usize,
    terms: usize,
    panels: usize,
}

impl Shape {
    fn stride(self) -> usize {
        (self.terms + self.order) * PANEL
    }
}

impl Bordered {
    /// Makes room for systems of up to these sizes, so that `start` allocates nothing.
    pub fn reserve(&mut self, order: usize, border: usize, terms: usize) {
        let panels = (order + border).div_ceil(PANEL);
        let needed = panels * (terms + order) * PANEL + PANEL;
        if self.storage.len() < needed {
            self.storage = vec![0.0; needed.max(self.storage.len() * 3 / 2)];
            self.skip = self.storage.as_ptr().align_offset(64).min(PANEL);
        }
        let rows = panels * PANEL;
        if self.solution.len() < rows {
            self.solution.resize(rows, 0.0);
            self.inverse_pivots.resize(rows, 0.0);
        }
    }

    /// Begins a system of `order` unknowns: `C` is the identity, its border zero; terms are for the caller to set.
    pub fn start(&mut self, order: usize, border: usize, terms: usize) {
        self.reserve(order, border, terms);
        self.shape = Shape { order, terms, panels: (order + border).div_ceil(PANEL) };
        let stride = self.shape.stride();
        for panel in 0..self.shape.panels {
            let at = self.skip + panel * stride;
            self.storage[at + terms * PANEL..at + stride].fill(0.0);
        }
        for j in 0..order {
            *self.entry(j, j) = 1.0;
        }
    }

    /// Begins a system from a matrix with its right-hand sides, and room for more border rows below these.
    pub fn start_from(&mut self, gram: &Gram, more: usize) {
        let (order, border) = gram.shape();
        self.reserve(order, border + more, 0);
        self.shape = Shape { order, terms: 0, panels: (order + border + more).div_ceil(PANEL) };
        let stride = self.shape.stride();
        for panel in 0..self.shape.panels {
            let target = &mut self.storage[self.skip + panel * stride..self.skip + (panel + 1) * stride];
            if panel < gram.count() {
                let source = gram.panel(panel);
                target[..source.len()].copy_from_slice(source);
            } else {
                target.fill(0.0);
            }
        }
    }

    /// Begins a system without terms: `C` is the identity less `rows(i)[columns[j]]`, its border zero.
    pub fn start_complement<'a>(
        &mut self,
        rows: impl Fn(usize) -> &'a [f64],
        columns: &[usize],
        border: usize,
    ) {
        let order = columns.len();
        self.reserve(order, border, 0);
        self.shape = Shape { order, terms: 0, panels: (order + border).div_ceil(PANEL) };
        let stride = self.shape.stride();
        for panel in 0..self.shape.panels {
            let first = panel * PANEL;
            let at = self.skip + panel * stride;
            let (entries, _) = self.storage[at..at + stride].as_chunks_mut::<PANEL>();
            let width = PANEL.min(order.saturating_sub(first));
            if width == 0 {
                entries.fill([0.0; PANEL]);
                continue;
            }
            // Lanes beyond the last row repeat it: all are as many, so that each column is one vector.
            let lines: [&[f64]; PANEL] = std::array::from_fn(|lane| rows(first + lane.min(width - 1)));
            for (entries, &column) in entries.iter_mut().zip(&columns[..first + width]) {
                entries.iter_mut().zip(&lines).for_each(|(entry, line)| *entry = -line[column]);
            }
            if width < PANEL {
                entries.iter_mut().for_each(|lanes| lanes[width..].fill(0.0));
            }
            (0..width).for_each(|lane| entries[first + lane][lane] += 1.0);
        }
    }

    /// Entry of `C`, for rows below `order + border` and columns below `order`.
    pub fn entry(&mut self, row: usize, column: usize) -> &mut f64 {
        let at = (self.shape.terms + column) * PANEL + row % PANEL;
        &mut self.storage[self.skip + row / PANEL * self.shape.stride() + at]
    }

    /// Sets all terms of one row.
    pub fn set_row(&mut self, row: usize, terms: &[f64]) {
        let at = self.skip + row / PANEL * self.shape.stride();
        let lanes = self.storage[at..].chunks_exact_mut(PANEL);
        for (lane, &term) in lanes.zip(terms) {
            lane[row % PANEL] = term;
        }
    }

    /// Zeroes the terms of rows from `first` on, the padding of the last panel included.
    pub fn clear_rows(&mut self, first: usize) {
        let stride = self.shape.stride();
        for row in first..self.shape.panels * PANEL {
            let at = self.skip + row / PANEL * stride;
            for t in 0..self.shape.terms {
                self.storage[at + t * PANEL + row % PANEL] = 0.0;
            }
        }
    }

    /// Factorises, and returns the smallest pivot. At a pivot that is not positive it stops: nothing else is
    /// then defined.
    pub fn factor(&mut self) -> f64 {
        let Self { storage, skip, shape, inverse_pivots, .. } = self;
        let storage = &mut storage[*skip..];
        Arch::new().dispatch(Factor { storage, shape: *shape, inverse_pivots })
    }

    /// Solves forward, `L^-1 x`, for rows that come after the factorisation.
    pub fn carry<'a>(&mut self, rows: impl ExactSizeIterator<Item = &'a [f64]>) {
        let Shape { order, .. } = self.shape;
        let panels = rows.len().div_ceil(PANEL);
        self.carried.clear();
        self.carried.resize(panels * order * PANEL, 0.0);
        for (k, row) in rows.enumerate() {
            let lanes = self.carried[k / PANEL * order * PANEL..].chunks_exact_mut(PANEL);
            lanes.zip(row).for_each(|(lane, x)| lane[k % PANEL] = *x);
        }
        let Self { storage, skip, shape, inverse_pivots, carried, .. } = self;
        let factor = &storage[*skip..];
        Arch::new().dispatch(Carry { factor, shape: *shape, inverse_pivots, carried });
    }

    /// Takes border rows, which are forward solves already, for what was carried.
    pub fn carry_border(&mut self, rows: Range<usize>) {
        let order = self.shape.order;
        let mut carried = std::mem::take(&mut self.carried);
        carried.clear();
        carried.resize(rows.len().div_ceil(PANEL) * order * PANEL, 0.0);
        for (k, row) in rows.enumerate() {
            let lanes = carried[k / PANEL * order * PANEL..].chunks_exact_mut(PANEL);
            lanes.zip(self.forward(row)).for_each(|(lane, u)| lane[k % PANEL] = u);
        }
        self.carried = carried;
    }

    /// What `carry` found: eight rows at a time, `order` columns of eight lanes.
    pub fn carried(&self) -> &[[f64; PANEL]] {
        self.carried.as_chunks().0
    }

    /// The forward solve of a border row.
    pub fn forward_row(&self, row: usize, out: &mut Vec<f64>) {
        out.clear();
        out.extend(self.forward(row));
    }

    /// Products of the entries of the forward solves of two border rows: those of a leading system come first.
    pub fn forward_products(&self, row: usize, other: usize) -> impl Iterator<Item = f64> {
        self.forward(row).zip(self.forward(other)).map(|(x, y)| x * y)
    }

    /// Pivots, in order.
    pub fn pivots(&self) -> impl Iterator<Item = f64> {
        self.inverse_pivots[..self.shape.order].iter().map(|x| (x * x).recip())
    }

    fn forward(&self, row: usize) -> impl Iterator<Item = f64> {
        let Shape { order, terms, .. } = self.shape;
        let row = order + row;
        let at = self.skip + row / PANEL * self.shape.stride() + terms * PANEL + row % PANEL;
        // With no unknowns the place may be past the end.
        self.storage.get(at..).unwrap_or(&[]).iter().step_by(PANEL).take(order).copied()
    }

    /// `L^T z = y` with y the forward solve of border row `row`: unknowns `from..order`.
    pub fn back_solve(&mut self, row: usize, from: usize) -> &[f64] {
        let order = self.shape.order;
        let mut solution = std::mem::take(&mut self.solution);
        solution.iter_mut().zip(self.forward(row)).for_each(|(z, y)| *z = y);
        self.solution = solution;
        self.back_substitute(from);
        &self.solution[from..order]
    }

    /// `L^T x`, to be added to `out`.
    pub fn add_transposed(&self, x: &[f64], out: &mut [f64]) {
        let factor = &self.storage[self.skip..];
        let Self { shape, inverse_pivots, .. } = self;
        Arch::new().dispatch(AddTransposed { factor, shape: *shape, inverse_pivots, x, out });
    }

    /// `L^T`, column-major.
    pub fn upper(&self) -> Vec<f64> {
        let Shape { order, terms, .. } = self.shape;
        let mut upper = vec![0.0; order * order];
        for (i, column) in upper.chunks_exact_mut(order.max(1)).enumerate() {
            let at = self.skip + i / PANEL * self.shape.stride() + terms * PANEL + i % PANEL;
            column[..i].iter_mut().zip(self.storage[at..].iter().step_by(PANEL)).for_each(|(u, l)| *u = *l);
            column[i] = self.inverse_pivots[i].recip();
        }
        upper
    }

    /// `L L^T z = right`, for a right-hand side that came after the factorisation.
    pub fn solve(&mut self, right: &[f64]) -> &[f64] {
        let order = self.shape.order;
        self.solution.fill(0.0);
        self.solution[..order].copy_from_slice(right);
        for j in 0..order {
            let y = self.solution[j] * self.inverse_pivots[j];
            self.each_below(j, |rest, column| rest.iter_mut().zip(column).for_each(|(r, l)| *r -= l * y));
            self.solution[j] = y;
        }
        self.back_substitute(0);
        &self.solution[..order]
    }

    fn back_substitute(&mut self, from: usize) {
        self.solution[self.shape.order..].fill(0.0);
        for j in (from..self.shape.order).rev() {
            let mut lanes = [0.0; PANEL];
            self.each_below(j, |known, column| {
                for ((lane, z), l) in lanes.iter_mut().zip(known).zip(column) {
                    *lane += *z * l;
                }
            });
            self.solution[j] = (self.solution[j] - lanes.iter().sum::<f64>()) * self.inverse_pivots[j];
        }
    }

    /// Visits column j of L below its diagonal, panel by panel, beside the same part of the solution.
    fn each_below(&mut self, j: usize, mut visit: impl FnMut(&mut [f64], &[f64])) {
        let Shape { terms, panels, .. } = self.shape;
        let own = j % PANEL + 1;
        for panel in j / PANEL..panels {
            let at = self.skip + panel * self.shape.stride() + (terms + j) * PANEL;
            // What stands above the diagonal of its own panel is not L's.
            let first = if panel == j / PANEL { own } else { 0 };
            let known = &mut self.solution[panel * PANEL + first..(panel + 1) * PANEL];
            visit(known, &self.storage[at + first..at + PANEL]);
        }
    }
}

struct Factor<'a> {
    storage: &'a mut [f64],
    shape: Shape,
    inverse_pivots: &'a mut [f64],
}

impl WithSimd for Factor<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        // Accumulators must fit the registers: 32 of them with AVX-512, 16 without.
        match S::F64_LANES {
            8 => self.run::<S, 1, 2, 8>(simd),
            4 => self.run::<S, 2, 1, 4>(simd),
            2 => self.run::<S, 4, 1, 2>(simd),
            _ => self.run::<S, 8, 1, 1>(simd),
        }
    }
}

impl Factor<'_> {
    /// `V` vectors make a panel; a tile is `R` panels by `C` columns.
    #[inline(always)]
    fn run<S: Simd, const V: usize, const R: usize, const C: usize>(mut self, simd: S) -> f64 {
        let Shape { order, terms, panels } = self.shape;
        let column_panels = order.div_ceil(PANEL);
        let mut smallest = f64::INFINITY;
        for first in (0..column_panels).step_by(BLOCK_PANELS) {
            let last = column_panels.min(first + BLOCK_PANELS);
            let done = terms + first * PANEL;
            for row in (first..panels).step_by(R) {
                for column in first..last.min(row + R) {
                    self.update::<S, V, R, C>(simd, row, column, 0, done);
                }
            }
            for column in first..last {
                for row in (column..panels).step_by(R) {
                    self.update::<S, V, R, C>(simd, row, column, done, terms + column * PANEL);
                }
                let (least, unit) = self.pivots(column);
                smallest = smallest.min(least);
                if smallest.is_nan() || smallest <= 0.0 {
                    return smallest.min(0.0);
                }
                for row in column + 1..panels {
                    self.solve::<S, V>(simd, row, column, &unit);
                }
            }
        }
        smallest
    }

    /// Subtracts the terms `from..to` from the tile at panels `row..row + R` and the columns of panel `column`.
    #[inline(always)]
    fn update<S: Simd, const V: usize, const R: usize, const C: usize>(
        &mut self,
        simd: S,
        row: usize,
        column: usize,
        from: usize,
        to: usize,
    ) {
        if from == to {
            return;
        }
        let stride = self.shape.stride();
        let width = PANEL.min(self.shape.order - column * PANEL);
        if R == 2 && row + 1 == self.shape.panels {
            return self.update::<S, V, 1, C>(simd, row, column, from, to);
        }
        for c in (0..width).step_by(C) {
            let factors = &self.storage[column * stride + from * PANEL..column * stride + to * PANEL];
            let rows: [&[S::f64s]; R] = std::array::from_fn(|r| {
                let at = (row + r) * stride;
                S::as_simd_f64s(&self.storage[at + from * PANEL..at + to * PANEL]).0
            });
            let sums = products::<S, V, R, C>(simd, rows, factors, c);
            for (k, sum) in sums.iter().enumerate().take(width - c) {
                for (r, sum) in sum.iter().enumerate() {
                    let at = (row + r) * stride + (self.shape.terms + column * PANEL + c + k) * PANEL;
                    let (target, _) = S::as_mut_simd_f64s(&mut self.storage[at..at + PANEL]);
                    for (t, &s) in target.iter_mut().zip(sum) {
                        *t = simd.sub_f64s(*t, s);
                    }
                }
            }
        }
    }

    /// Factorises the diagonal block of a panel, and carries the border rows that share the panel along. Its smallest pivot,
    /// and its columns divided by their diagonal entries.
    #[inline(always)]
    fn pivots(&mut self, column: usize) -> (f64, Unit) {
        let first = column * PANEL;
        let width = PANEL.min(self.shape.order - first);
        let at = column * self.shape.stride() + (self.shape.terms + first) * PANEL;
        let (block, _) = self.storage[at..at + width * PANEL].as_chunks_mut::<PANEL>();
        let mut unit = [[0.0; PANEL]; PANEL];
        let mut values = [1.0; PANEL];
        // Columns are divided by the roots of their pivots afterwards, all at once: from pivot to pivot it is a long way
        // as it is.
        for k in 0..width {
            // A copy, in registers: stores cannot touch it, so the lanes below are one vector.
            let pivot = block[k];
            values[k] = pivot[k];
            if pivot[k].is_nan() || pivot[k] <= 0.0 {
                return (0.0, unit);
            }
            let inverse = pivot[k].recip();
            unit[k] = pivot.map(|x| x * inverse);
            for (j, other) in block.iter_mut().enumerate().skip(k + 1) {
                *other = std::array::from_fn(|lane| other[lane] - pivot[lane] * unit[k][j]);
            }
        }
        let inverse_roots = values.map(|value: f64| value.sqrt().recip());
        self.inverse_pivots[first..first + width].copy_from_slice(&inverse_roots[..width]);
        for (column, inverse) in block.iter_mut().zip(inverse_roots) {
            column.iter_mut().for_each(|x| *x *= inverse);
        }
        (values[..width].iter().copied().fold(f64::INFINITY, f64::min), unit)
    }

    /// Finishes the columns of panel `column` in the panel `row` below it.
    #[inline(always)]
    fn solve<S: Simd, const V: usize>(&mut self, simd: S, row: usize, column: usize, unit: &Unit) {
        let first = column * PANEL;
        let width = PANEL.min(self.shape.order - first);
        let at = row * self.shape.stride() + (self.shape.terms + first) * PANEL;
        let (block, _) = S::as_mut_simd_f64s(&mut self.storage[at..at + width * PANEL]);
        substitute::<S, V>(simd, block, unit, &self.inverse_pivots[first..first + width]);
    }
}

/// Products of columns of L, eight at a time.
struct AddTransposed<'a> {
    factor: &'a [f64],
    shape: Shape,
    inverse_pivots: &'a [f64],
    x: &'a [f64],
    out: &'a mut [f64],
}

impl WithSimd for AddTransposed<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F64_LANES {
            8 => self.run::<S, 1>(simd),
            4 => self.run::<S, 2>(simd),
            2 => self.run::<S, 4>(simd),
            _ => self.run::<S, 8>(simd),
        }
    }
}

impl AddTransposed<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize>(self, simd: S) {
        let Self { factor, shape, inverse_pivots, x, out } = self;
        let x = &x[..shape.order];
        for (own, out) in out[..shape.order].chunks_mut(PANEL).enumerate() {
            let first = (shape.terms + own * PANEL) * PANEL;
            let mut sums = [[simd.splat_f64s(0.0); V]; PANEL];
            // The columns of which there are fewer are the last: no panel follows.
            for (panel, x) in x.chunks(PANEL).enumerate().skip(own + 1) {
                // Rows below those of L are not its own.
                let mut lanes = [0.0; PANEL];
                lanes[..x.len()].copy_from_slice(x);
                let (x, _) = S::as_simd_f64s(&lanes);
                let at = panel * shape.stride() + first;
                let (columns, _) = S::as_simd_f64s(&factor[at..at + PANEL * PANEL]);
                for k in 0..PANEL {
                    for v in 0..V {
                        sums[k][v] = simd.mul_add_f64s(columns[k * V + v], x[v], sums[k][v]);
                    }
                }
            }
            let at = own * shape.stride() + first;
            let (diagonal, x) = (factor[at..].as_chunks::<PANEL>().0, &x[own * PANEL..]);
            for (k, out) in out.iter_mut().enumerate() {
                let mut sum = x[k] * inverse_pivots[own * PANEL + k].recip();
                for part in sums[k] {
                    sum += simd.reduce_sum_f64s(part);
                }
                for (l, x) in diagonal[k].iter().zip(x).skip(k + 1) {
                    sum += l * x;
                }
                *out += sum;
            }
        }
    }
}

/// A diagonal block of L with columns divided by their diagonal entries: column k at k.
type Unit = [[f64; PANEL]; PANEL];

/// Forward substitution in panels of right-hand sides.
struct Carry<'a> {
    factor: &'a [f64],
    shape: Shape,
    inverse_pivots: &'a [f64],
    carried: &'a mut [f64],
}

impl WithSimd for Carry<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F64_LANES {
            8 => self.run::<S, 1, 8>(simd),
            4 => self.run::<S, 2, 4>(simd),
            2 => self.run::<S, 4, 2>(simd),
            _ => self.run::<S, 8, 1>(simd),
        }
    }
}

impl Carry<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize, const C: usize>(self, simd: S) {
        let order = self.shape.order;
        let stride = self.shape.stride();
        for panel in self.carried.chunks_exact_mut(order * PANEL) {
            for first in (0..order).step_by(PANEL) {
                let width = PANEL.min(order - first);
                let at = first / PANEL * stride + self.shape.terms * PANEL;
                let (done, rest) = panel.split_at_mut(first * PANEL);
                let known = S::as_simd_f64s(done).0;
                let block = S::as_mut_simd_f64s(&mut rest[..width * PANEL]).0;
                for c in (0..width).step_by(C) {
                    let factors = &self.factor[at..at + first * PANEL];
                    let sums = products::<S, V, 1, C>(simd, [known], factors, c);
                    for (target, sum) in block[c * V..].chunks_exact_mut(V).zip(&sums) {
                        target.iter_mut().zip(sum[0]).for_each(|(t, s)| *t = simd.sub_f64s(*t, s));
                    }
                }
                let diagonal = self.factor[at + first * PANEL..].as_chunks::<PANEL>().0;
                let inverse_pivots = &self.inverse_pivots[first..first + width];
                let mut unit = [[0.0; PANEL]; PANEL];
                for ((unit, column), inverse) in unit.iter_mut().zip(diagonal).zip(inverse_pivots) {
                    *unit = column.map(|x| x * inverse);
                }
                substitute::<S, V>(simd, block, &unit, inverse_pivots);
            }
        }
    }
}

/// Finishes the columns of a block of eight rows, given the factor's diagonal block beside it. Unscaled, a column waits for
/// one multiply-add of the column before it; all are scaled at the end.
#[inline(always)]
fn substitute<S: Simd, const V: usize>(simd: S, block: &mut [S::f64s], unit: &Unit, inverse_pivots: &[f64]) {
    let (columns, _) = block.as_chunks_mut::<V>();
    match columns.first_chunk_mut::<PANEL>() {
        // A number of columns that the compiler knows stays in registers.
        Some(columns) => {
            let mut known = *columns;
            eliminate(simd, &mut known, unit, inverse_pivots);
            *columns = known;
        }
        None => eliminate(simd, columns, unit, inverse_pivots),
    }
}

#[inline(always)]
fn eliminate<S: Simd, const V: usize>(
    simd: S,
    columns: &mut [[S::f64s; V]],
    unit: &Unit,
    inverse_pivots: &[f64],
) {
    for k in 0..columns.len().min(PANEL) {
        let (done, rest) = columns.split_at_mut(k + 1);
        let current = done[k];
        for (other, factor) in rest.iter_mut().zip(&unit[k][k + 1..]) {
            let factor = simd.splat_f64s(-factor);
            for v in 0..V {
                other[v] = simd.mul_add_f64s(current[v], factor, other[v]);
            }
        }
    }
    for (column, inverse) in columns.iter_mut().zip(inverse_pivots) {
        let inverse = simd.splat_f64s(*inverse);
        column.iter_mut().for_each(|x| *x = simd.mul_f64s(*x, inverse));
    }
}

/// Inner products of the rows of `R` panels with rows `first..first + C` of another panel, over all of their columns.
#[inline(always)]
pub(crate) fn products<S: Simd, const V: usize, const R: usize, const C: usize>(
    simd: S,
    rows: [&[S::f64s]; R],
    factors: &[f64],
    first: usize,
) -> [[[S::f64s; V]; R]; C] {
    // What the compiler knows here it need not check in the loop.
    assert!(first + C <= PANEL);
    let (factors, _) = factors.as_chunks::<PANEL>();
    let rows: [&[[S::f64s; V]]; R] = rows.map(|row| &row.as_chunks::<V>().0[..factors.len()]);
    let mut sums = [[[simd.splat_f64s(0.0); V]; R]; C];
    for (t, factor) in factors.iter().enumerate() {
        let here: [[S::f64s; V]; R] = std::array::from_fn(|r| rows[r][t]);
        for (k, sum) in sums.iter_mut().enumerate() {
            let f = simd.splat_f64s(factor[first + k]);
            for r in 0..R {
                for v in 0..V {
                    sum[r][v] = simd.mul_add_f64s(here[r][v], f, sum[r][v]);
                }
            }
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pseudo-random numbers in -1..1, small enough in all that `I - X X^T` stays positive definite.
    fn noise(count: usize, seed: u64, size: f64) -> Vec<f64> {
        let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1u64 << 53) as f64 * 2.0 - 1.0
        };
        (0..count).map(|_| next() * size).collect()
    }

    /// `L L^T z = right` holds for the matrix that the terms define, at sizes on each side of every panel.
    #[test]
    fn solves_what_it_factors() {
        let mut system = Bordered::default();
        for order in [1, 2, 7, 8, 9, 16, 31, 63, 64, 65, 130, 200] {
            for terms in [0, 1, 5, 40] {
                let size = 0.7 / ((order * terms.max(1)) as f64).sqrt();
                let x = noise(order * terms, (order * 1000 + terms) as u64, size);
                let right = noise(order, 7, 1.0);
                system.start(order, 1, terms);
                set_terms(&mut system, &x, order);
                for (j, value) in right.iter().enumerate() {
                    *system.entry(order, j) = *value;
                }
                let smallest = system.factor();
                assert!(smallest > 0.0 && smallest <= 1.0);
                let z = system.back_solve(0, 0).to_vec();
                let mut forward = Vec::new();
                system.forward_row(0, &mut forward);
                let mut transposed: Vec<f64> = forward.iter().map(|y| 0.5 - y).collect();
                system.add_transposed(&z, &mut transposed);
                assert!(transposed.iter().all(|x| (x - 0.5).abs() < 1e-13));
                system.carry([&right[..], &x[..order.min(x.len())]].into_iter());
                let carried: Vec<f64> = system.carried().iter().map(|lanes| lanes[0]).collect();
                assert!(carried.iter().zip(&forward).all(|(a, b)| (a - b).abs() < 1e-13));
                system.carry_border(0..1);
                assert!(system.carried().iter().zip(&forward).all(|(lanes, y)| lanes[0] == *y));
                assert_eq!(system.carried().len(), order);
                let again = system.solve(&right);
                assert!(z.iter().zip(again).all(|(a, b)| (a - b).abs() < 1e-13));
                for i in 0..order {
                    let dot = |t: usize| (0..order).map(|j| x[t * order + j] * z[j]).sum::<f64>();
                    let product = z[i] - (0..terms).map(|t| x[t * order + i] * dot(t)).sum::<f64>();
                    assert!((product - right[i]).abs() < 1e-12, "order {order} terms {terms} row {i}");
                }
            }
        }
    }

    /// With rows below those of L in its last panel, which are not its own.
    #[test]
    fn products_with_the_transposed_factor_are_added() {
        let mut system = Bordered::default();
        for order in [1, 2, 7, 8, 9, 16, 31, 65] {
            for terms in [0, 5] {
                let size = 0.7 / ((order * terms.max(1)) as f64).sqrt();
                system.start(order, 2, terms);
                set_terms(&mut system, &noise(order * terms, order as u64, size), order);
                for (j, value) in noise(order, 7, 1.0).iter().enumerate() {
                    *system.entry(order, j) = 1e3 * value;
                }
                for j in 0..order {
                    (0..j).for_each(|i| *system.entry(j, i) = 0.01 * (i as f64 - j as f64).sin());
                }
                system.factor();
                let (x, mut out) = (noise(order, 3, 1.0), vec![1.0; order]);
                system.add_transposed(&x, &mut out);
                let upper = system.upper();
                for (j, out) in out.iter().enumerate() {
                    let product: f64 = (j..order).map(|i| upper[i * order + j] * x[i]).sum();
                    assert!((out - 1.0 - product).abs() < 1e-13, "{order} {terms} {j}");
                }
            }
        }
    }

    /// A matrix with its right-hand side, factored as it stands, equals the one that is made of terms.
    #[test]
    fn terms_and_their_gram_matrix_agree() {
        let (order, terms) = (13, 6);
        let x = noise(order * terms, 3, 0.1);
        let mut gram = Gram::default();
        gram.start(order, 1);
        let rows: Vec<usize> = (0..terms).collect();
        gram.change(&rows, -1.0, |t| (&x[t * order..(t + 1) * order], &[1.0]));
        let mut systems = [Bordered::default(), Bordered::default()];
        systems[0].start(order, 3, terms);
        set_terms(&mut systems[0], &x, order);
        (0..terms).for_each(|t| {
            systems[0].storage[systems[0].skip + systems[0].shape.stride() + t * PANEL + 5] = 1.0
        });
        systems[1].start_from(&gram, 2);
        let pivots = systems.each_mut().map(Bordered::factor);
        assert!((pivots[0] - pivots[1]).abs() < 1e-14);
        let forward = systems.each_ref().map(|system| system.forward_products(0, 0).sum::<f64>());
        assert!((forward[0] - forward[1]).abs() < 1e-13 && forward[0] > 0.0);
    }

    /// Sets the terms of all rows from those of term after term, and clears the border's.
    fn set_terms(system: &mut Bordered, x: &[f64], order: usize) {
        for i in 0..order {
            let terms: Vec<f64> = x.iter().skip(i).step_by(order).copied().collect();
            system.set_row(i, &terms);
        }
        system.clear_rows(order);
    }

    #[test]
    fn a_lost_direction_is_a_pivot_of_zero() {
        let mut system = Bordered::default();
        for order in [1, 4, 20] {
            system.start(order, 1, 1);
            let mut unit = vec![0.0; order];
            unit[order - 1] = 1.0;
            set_terms(&mut system, &unit, order);
            assert_eq!(system.factor(), 0.0);
        }
    }
}
