//! Blocks of rows in panels of eight, and what CholeskyQR does with them: Gram matrices, and rows solved with a triangle.
//!
//! A panel holds its columns one after another, eight contiguous numbers each, one a row. Every sum runs in an order of its
//! own entry, so that no bit of leading columns depends on how many follow.

use pulp::{Arch, Simd, WithSimd};

use crate::error::Error;
use crate::pool::Pool;

/// Rows of a panel.
pub(crate) const PANEL: usize = 8;

/// Rows of a block: some dozens of its columns stay in the first-level cache.
pub(super) const BLOCK: usize = 128;

/// A panel's column.
pub(super) type Lanes = [f64; PANEL];

/// Rows `first..`, each with a weight, in panels of scaled columns; those beyond the `total` stay zero.
pub(super) fn pack<'a>(
    row: impl Fn(usize) -> (&'a [f64], f64),
    total: usize,
    scales: &[f64],
    first: usize,
    panels: &mut [Lanes],
) {
    for (first, panel) in (first..total).step_by(PANEL).zip(panels.chunks_exact_mut(scales.len())) {
        let there = PANEL.min(total - first);
        // Rows beyond the last repeat it, with no weight.
        let rows: [_; PANEL] = std::array::from_fn(|lane| row(first + lane.min(there - 1)));
        let weights = std::array::from_fn(|lane| if lane < there { rows[lane].1 } else { 0.0 });
        let rows = rows.map(|(row, _)| &row[..scales.len()]);
        Arch::new().dispatch(Pack { rows, weights, scales, panel });
    }
}

/// The rows that panels of some columns hold, one after another; the last panel may hold more.
pub(super) fn unpack(panels: &[Lanes], columns: usize, rows: &mut [f64]) {
    Arch::new().dispatch(Unpack { panels, columns, rows });
}

/// Adds `X^T Y` to `sums` (column-major) for panels of X, of some columns, and panels of Y, of a width.
pub(super) fn add_products(
    panels: &[Lanes],
    columns: usize,
    right: &[Lanes],
    width: usize,
    sums: &mut [f64],
) {
    Arch::new().dispatch(AddProducts { panels, columns, right, width, sums });
}

/// Adds the lower triangle of `X^T X` to `gram` (columns x columns, column-major), for whole panels of X.
pub(super) fn add_gram(panels: &[Lanes], columns: usize, gram: &mut [f64]) {
    Arch::new().dispatch(AddGram { panels, columns, gram });
}

/// `X <- X L^-T` for panels of some columns, with L the leading lower triangle of a column-major matrix of `order` rows.
pub(super) fn solve(lower: &[f64], order: usize, columns: usize, panels: &mut [Lanes]) {
    if columns > 0 {
        let inverses = lower.iter().step_by(order + 1).take(columns).map(|pivot| pivot.recip()).collect();
        Arch::new().dispatch(Solve { lower, order, columns, inverses, panels });
    }
}

/// The Cholesky factor of a matrix of which the lower triangle is given, with zeros above; none at a pivot that is not
/// positive.
pub(super) fn cholesky(mut a: Vec<f64>, order: usize, pool: &Pool<'_>) -> Result<Option<Vec<f64>>, Error> {
    let mut panel = vec![[0.0; PANEL]; order];
    for first in (0..order).step_by(PANEL) {
        pool.proceed()?;
        let width = PANEL.min(order - first);
        for (k, lanes) in panel[..first + width].iter_mut().enumerate() {
            *lanes = std::array::from_fn(|lane| if lane < width { a[k * order + first + lane] } else { 0.0 });
        }
        let (left, own) = panel[..first + width].split_at_mut(first);
        solve(&a, order, first, left);
        for lanes in &*left {
            for (column, &factor) in own.iter_mut().zip(lanes) {
                column.iter_mut().zip(lanes).for_each(|(x, lane)| *x -= lane * factor);
            }
        }
        for k in 0..width {
            let square = own[k][k];
            if square.is_nan() || square <= 0.0 {
                return Ok(None);
            }
            let pivot = square.sqrt();
            let column = own[k].map(|x| x / pivot);
            own[k] = column;
            own[k][k] = pivot;
            for (other, factor) in own.iter_mut().zip(column).skip(k + 1) {
                other.iter_mut().zip(column).for_each(|(x, lane)| *x -= lane * factor);
            }
        }
        for (k, lanes) in panel[..first + width].iter().enumerate() {
            let from = k.saturating_sub(first);
            a[k * order + first + from..k * order + first + width].copy_from_slice(&lanes[from..width]);
        }
    }
    for (j, column) in a.chunks_exact_mut(order.max(1)).enumerate() {
        column[..j].fill(0.0);
    }
    Ok(Some(a))
}

struct Pack<'a> {
    rows: [&'a [f64]; PANEL],
    weights: Lanes,
    scales: &'a [f64],
    panel: &'a mut [Lanes],
}

impl WithSimd for Pack<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { rows, weights, scales, panel } = self;
        let (squares, rest) = panel.as_chunks_mut::<PANEL>();
        let whole = PANEL * squares.len();
        for (j, square) in (0..whole).step_by(PANEL).zip(squares) {
            let scales = &scales[j..j + PANEL];
            *square = transposed(&std::array::from_fn(|lane| {
                let row = &rows[lane][j..j + PANEL];
                std::array::from_fn(|k| row[k] * scales[k] * weights[lane])
            }));
        }
        for (j, lanes) in (whole..).zip(rest) {
            *lanes = std::array::from_fn(|lane| rows[lane][j] * scales[j] * weights[lane]);
        }
    }
}

struct Unpack<'a> {
    panels: &'a [Lanes],
    columns: usize,
    rows: &'a mut [f64],
}

impl WithSimd for Unpack<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { panels, columns, rows } = self;
        for (panel, rows) in panels.chunks_exact(columns).zip(rows.chunks_mut(PANEL * columns)) {
            let (squares, rest) = panel.as_chunks::<PANEL>();
            let whole = PANEL * squares.len();
            for (j, square) in (0..whole).step_by(PANEL).zip(squares) {
                for (row, part) in rows.chunks_exact_mut(columns).zip(transposed(square)) {
                    row[j..j + PANEL].copy_from_slice(&part);
                }
            }
            for (lane, row) in rows.chunks_exact_mut(columns).enumerate() {
                row[whole..].iter_mut().zip(rest).for_each(|(x, lanes)| *x = lanes[lane]);
            }
        }
    }
}

#[inline(always)]
fn transposed(square: &[Lanes; PANEL]) -> [Lanes; PANEL] {
    std::array::from_fn(|j| std::array::from_fn(|i| square[i][j]))
}

struct AddProducts<'a> {
    panels: &'a [Lanes],
    columns: usize,
    right: &'a [Lanes],
    width: usize,
    sums: &'a mut [f64],
}

impl WithSimd for AddProducts<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { panels, columns, right, width, sums } = self;
        for (c, sums) in sums.chunks_exact_mut(columns).enumerate() {
            for (j, sum) in sums.iter_mut().enumerate() {
                let mut lanes = [0.0; PANEL];
                for (panel, right) in panels.chunks_exact(columns).zip(right.chunks_exact(width)) {
                    let (x, y) = (panel[j], right[c]);
                    lanes = std::array::from_fn(|lane| lanes[lane] + x[lane] * y[lane]);
                }
                *sum += lanes.iter().sum::<f64>();
            }
        }
    }
}

/// Columns of a Gram matrix that stay in the cache while all others pass by.
const GROUP: usize = 24;

/// Rows and columns of entries of a Gram matrix that are summed at once.
const TILE: usize = 3;

struct AddGram<'a> {
    panels: &'a [Lanes],
    columns: usize,
    gram: &'a mut [f64],
}

impl WithSimd for AddGram<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let columns = self.columns;
        for group in (0..columns).step_by(GROUP) {
            let end = columns.min(group + GROUP);
            for j in (0..end).step_by(TILE) {
                // Rows above the diagonal are nobody's; tiles start where they would without the columns that follow.
                for i in (group..end).step_by(TILE).filter(|i| i + TILE > j) {
                    let sums = tile(simd, self.panels, columns, i, j);
                    for (b, sums) in sums.iter().enumerate().take(columns - j) {
                        for (a, &sum) in sums.iter().enumerate().take(end - i) {
                            if i + a >= j + b {
                                self.gram[(j + b) * columns + i + a] += sum;
                            }
                        }
                    }
                }
            }
        }
    }
}

/// Inner products of the columns from `i` on with those from `j` on; columns beyond the last repeat it.
#[inline(always)]
fn tile<S: Simd>(simd: S, panels: &[Lanes], columns: usize, i: usize, j: usize) -> [[f64; TILE]; TILE] {
    let mut sums = [[simd.splat_f64s(0.0); TILE]; TILE];
    let rows: [usize; TILE] = std::array::from_fn(|a| (i + a).min(columns - 1));
    let others: [usize; TILE] = std::array::from_fn(|b| (j + b).min(columns - 1));
    for panel in panels.chunks_exact(columns) {
        let left = rows.map(|row| S::as_simd_f64s(&panel[row]).0);
        let right = others.map(|other| S::as_simd_f64s(&panel[other]).0);
        for v in 0..PANEL / S::F64_LANES {
            for b in 0..TILE {
                for a in 0..TILE {
                    sums[b][a] = simd.mul_add_f64s(left[a][v], right[b][v], sums[b][a]);
                }
            }
        }
    }
    let mut totals = [[0.0; TILE]; TILE];
    for (totals, sums) in totals.iter_mut().zip(sums) {
        for (total, sum) in totals.iter_mut().zip(sums) {
            *total = simd.reduce_sum_f64s(sum);
        }
    }
    totals
}

struct Solve<'a> {
    lower: &'a [f64],
    order: usize,
    columns: usize,
    /// One over each pivot: a product takes a fraction of a quotient's time, and columns wait for one another.
    inverses: Vec<f64>,
    panels: &'a mut [Lanes],
}

impl WithSimd for Solve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Panels and columns at once, as many as the registers hold sums of.
        match S::F64_LANES {
            8 => self.run::<S, 1, 4, 4>(simd),
            4 => self.run::<S, 2, 2, 2>(simd),
            2 => self.run::<S, 4, 1, 2>(simd),
            _ => self.run::<S, 8, 1, 1>(simd),
        }
    }
}

impl Solve<'_> {
    /// `V` vectors make a panel's column.
    #[inline(always)]
    fn run<S: Simd, const V: usize, const R: usize, const C: usize>(mut self, simd: S) {
        let panels = std::mem::take(&mut self.panels);
        let (together, alone) = panels.split_at_mut(panels.len() / (R * self.columns) * R * self.columns);
        for panels in together.chunks_exact_mut(R * self.columns) {
            self.solve::<S, V, R, C>(simd, panels);
        }
        for panel in alone.chunks_exact_mut(self.columns) {
            self.solve::<S, V, 1, C>(simd, panel);
        }
    }

    /// Solves `R` panels side by side.
    #[inline(always)]
    fn solve<S: Simd, const V: usize, const R: usize, const C: usize>(&self, simd: S, panels: &mut [Lanes]) {
        let columns = self.columns;
        for first in (0..columns).step_by(C) {
            let mut sums = [[[simd.splat_f64s(0.0); V]; R]; C];
            for (k, factors) in self.lower[first..].chunks(self.order).take(first).enumerate() {
                let x = std::array::from_fn(|r| vectors::<S, V>(&panels[r * columns + k]));
                add::<S, V, R, C>(simd, &mut sums, x, leading(factors));
            }
            for k in first..columns.min(first + C) {
                let inverse = simd.splat_f64s(self.inverses[k]);
                let mut x = std::array::from_fn(|r| vectors::<S, V>(&panels[r * columns + k]));
                for (r, x) in x.iter_mut().enumerate() {
                    for v in 0..V {
                        x[v] = simd.mul_f64s(simd.sub_f64s(x[v], sums[0][r][v]), inverse);
                    }
                    S::as_mut_simd_f64s(&mut panels[r * columns + k]).0.copy_from_slice(x);
                }
                add::<S, V, R, C>(simd, &mut sums, x, leading(&self.lower[k * self.order + k..]));
                // The next column's sum always comes first: which one a number tells would be looked up in memory.
                sums = std::array::from_fn(|c| sums[(c + 1).min(C - 1)]);
            }
        }
    }
}

/// The first numbers; at the triangle's end, where there are fewer, the last goes into sums that nobody reads.
#[inline(always)]
fn leading<const C: usize>(row: &[f64]) -> [f64; C] {
    match row.first_chunk() {
        Some(numbers) => *numbers,
        None => std::array::from_fn(|c| row[c.min(row.len() - 1)]),
    }
}

/// Adds the products of panels' columns with factors to a sum each.
#[inline(always)]
fn add<S: Simd, const V: usize, const R: usize, const C: usize>(
    simd: S,
    sums: &mut [[[S::f64s; V]; R]; C],
    x: [[S::f64s; V]; R],
    factors: [f64; C],
) {
    for c in 0..C {
        let factor = simd.splat_f64s(factors[c]);
        for r in 0..R {
            for v in 0..V {
                sums[c][r][v] = simd.mul_add_f64s(x[r][v], factor, sums[c][r][v]);
            }
        }
    }
}

#[inline(always)]
fn vectors<S: Simd, const V: usize>(lanes: &Lanes) -> [S::f64s; V] {
    let (vectors, _) = S::as_simd_f64s(lanes);
    std::array::from_fn(|v| vectors[v])
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    fn factored(a: Vec<f64>, order: usize) -> Option<Vec<f64>> {
        cholesky(a, order, &Pool::new(1, &AtomicBool::new(false))).unwrap()
    }

    fn noise(count: usize) -> Vec<f64> {
        (0..count).map(|i| ((i * 7919 + i * i % 977) % 1000) as f64 / 500.0 - 1.0).collect()
    }

    /// A matrix of whole panels, row by row.
    fn panels(rows: &[f64], columns: usize) -> Vec<Lanes> {
        let entry = |row: usize, j: usize| rows[row * columns + j];
        let count = rows.len() / columns;
        (0..count / PANEL * columns)
            .map(|k| std::array::from_fn(|lane| entry(k / columns * PANEL + lane, k % columns)))
            .collect()
    }

    fn gram(rows: &[f64], columns: usize) -> Vec<f64> {
        let mut gram = vec![0.0; columns * columns];
        add_gram(&panels(rows, columns), columns, &mut gram);
        gram
    }

    #[test]
    fn a_gram_matrix_has_inner_products_below_its_diagonal() {
        for columns in [1, 2, 3, 4, 23, 25, 50] {
            let rows = noise(16 * columns);
            let found = gram(&rows, columns);
            for (k, x) in found.iter().enumerate() {
                let (i, j) = (k % columns, k / columns);
                let exact: f64 = rows.chunks(columns).map(|row| row[i] * row[j]).sum();
                assert!(if i < j { *x == 0.0 } else { (x - exact).abs() < 1e-13 }, "{i} {j} of {columns}");
            }
        }
    }

    #[test]
    fn a_cholesky_factor_times_its_transpose_is_the_matrix() {
        for order in [1, 2, 7, 8, 9, 16, 30] {
            let mut a = gram(&noise(64 * order), order);
            (0..order).for_each(|j| a[j * order + j] += 1.0);
            let lower = factored(a.clone(), order).unwrap();
            for j in 0..order {
                for i in 0..order {
                    let sum: f64 = (0..=i.min(j)).map(|k| lower[k * order + i] * lower[k * order + j]).sum();
                    assert!(i < j || (sum - a[j * order + i]).abs() < 1e-12, "{i} {j} of {order}");
                    assert!(i >= j || lower[j * order + i] == 0.0);
                }
            }
        }
        assert_eq!(factored(vec![4.0, 2.0, 0.0, 1.0], 2), None);
        assert_eq!(factored(vec![f64::NAN], 1), None);
    }

    #[test]
    fn solved_rows_times_the_triangle_are_the_rows() {
        for columns in [1, 3, 4, 5, 8, 13] {
            // Of a larger triangle, the leading one.
            let order = columns + 2;
            let lower: Vec<f64> = noise(order * order)
                .iter()
                .enumerate()
                .map(|(k, x)| if k % (order + 1) == 0 { 3.0 } else { *x })
                .collect();
            let rows = noise(24 * columns);
            let mut x = panels(&rows, columns);
            solve(&lower, order, columns, &mut x);
            for (row, right) in rows.chunks(columns).enumerate() {
                let x = |k: usize| x[row / PANEL * columns + k][row % PANEL];
                for (j, right) in right.iter().enumerate() {
                    let product: f64 = (0..=j).map(|k| x(k) * lower[k * order + j]).sum();
                    assert!((product - right).abs() < 1e-12, "{row} {j} of {columns}");
                }
            }
        }
    }
}
