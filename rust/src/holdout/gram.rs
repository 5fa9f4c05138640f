//! `I - Q_K^T Q_K` kept between held-out sets: neighbouring data share most of what they hold out.
//!
//! A set of rows is turned into the next by adding and removing the few rows in which they differ, at p^2/2 multiply-adds
//! a row, instead of p^2/2 for every row of the set. Below the p rows of the matrix stand the right-hand sides `-Q_K^T e_K`,
//! which are sums over the same rows. What a row's arrival rounds its leaving mostly undoes: over
//! thousands of steps no error was seen to grow.
//!
//! Storage is in the panels of [`crate::holdout::kernel`], so that a factorisation starts from a copy.

use pulp::{Arch, Simd, WithSimd};

use crate::fit::panels::PANEL;
use crate::holdout::kernel::products;

/// Rows added at a time: their packed copy, of a few hundred columns, stays in the second-level cache. Of a power of two,
/// panels would lie in the same places of the cache.
const PACKED_ROWS: usize = 60;

/// The matrix and the right-hand sides below it.
#[derive(Clone, Default)]
pub struct Gram {
    order: usize,
    border: usize,
    /// A panel holds `order` columns of eight.
    panels: Vec<f64>,
    /// The rows under way: a panel holds as many columns of eight as there are rows.
    terms: Vec<f64>,
}

impl Gram {
    /// Nothing held out: the identity, above right-hand sides of zero.
    pub fn start(&mut self, order: usize, border: usize) {
        (self.order, self.border) = (order, border);
        let rows = (order + self.border).next_multiple_of(PANEL);
        self.panels.clear();
        self.panels.resize(rows * order, 0.0);
        for j in 0..order {
            *self.entry(j, j) = 1.0;
        }
    }

    /// No matrix: many are never needed, and zeros of hundreds of columns take longer than small sets.
    pub fn clear(&mut self) {
        (self.order, self.border) = (0, 0);
        self.panels.clear();
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.panels.is_empty()
    }

    fn entry(&mut self, row: usize, column: usize) -> &mut f64 {
        &mut self.panels[(row / PANEL * self.order + column) * PANEL + row % PANEL]
    }

    /// Takes the other's place without giving up the own memory.
    pub fn copy_from(&mut self, other: &Self) {
        (self.order, self.border) = (other.order, other.border);
        self.panels.clone_from(&other.panels);
    }

    /// Unknowns and right-hand sides.
    pub fn shape(&self) -> (usize, usize) {
        (self.order, self.border)
    }

    /// Columns of a panel that belong to the lower triangle, eight numbers each.
    pub(crate) fn panel(&self, panel: usize) -> &[f64] {
        let at = panel * self.order * PANEL;
        &self.panels[at..at + self.order.min((panel + 1) * PANEL) * PANEL]
    }

    /// Number of panels.
    pub(crate) fn count(&self) -> usize {
        self.panels.len() / (self.order * PANEL).max(1)
    }

    /// Holds rows out (sign -1) or takes them back in (1), each given by its entries and its right-hand sides.
    pub fn change<'a>(&mut self, rows: &[usize], sign: f64, fetch: impl Fn(usize) -> (&'a [f64], &'a [f64])) {
        if self.order == 0 {
            return;
        }
        for batch in rows.chunks(PACKED_ROWS) {
            self.pack(batch, &fetch);
            let (panels, terms) = (&mut self.panels[..], &self.terms[..]);
            Arch::new().dispatch(Change { order: self.order, count: batch.len(), panels, terms, sign });
        }
    }

    fn pack<'a>(&mut self, rows: &[usize], fetch: impl Fn(usize) -> (&'a [f64], &'a [f64])) {
        let (order, length) = (self.order, rows.len());
        touch(rows.iter().map(|&row| fetch(row).0));
        self.terms.resize(self.count() * length * PANEL, 0.0);
        let (lines, _) = self.terms.as_chunks_mut::<PANEL>();
        for (k, &row) in rows.iter().enumerate() {
            let (head, border) = fetch(row);
            let (whole, rest) = head.as_chunks::<PANEL>();
            for (line, lanes) in lines[k..].iter_mut().step_by(length).zip(whole) {
                *line = *lanes;
            }
            let mut entries = rest.iter().chain(border);
            for line in lines[k..].iter_mut().step_by(length).skip(order / PANEL) {
                *line = std::array::from_fn(|_| entries.next().copied().unwrap_or(0.0));
            }
        }
    }
}

/// Reads a number of every cache line of some rows, far apart in memory: asked for together, they arrive together.
pub(crate) fn touch<'a>(rows: impl Iterator<Item = &'a [f64]>) {
    std::hint::black_box(
        rows.flat_map(|row| row.iter().step_by(PANEL)).fold(0, |bits, x| bits ^ x.to_bits()),
    );
}

/// Adds `sign` times the products of packed rows to the lower triangle and the border.
struct Change<'a> {
    order: usize,
    count: usize,
    panels: &'a mut [f64],
    terms: &'a [f64],
    sign: f64,
}

impl WithSimd for Change<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        match S::F64_LANES {
            8 => self.run::<S, 1, 2, 8>(simd),
            4 => self.run::<S, 2, 1, 4>(simd),
            2 => self.run::<S, 4, 1, 2>(simd),
            _ => self.run::<S, 8, 1, 1>(simd),
        }
    }
}

impl Change<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize, const R: usize, const C: usize>(mut self, simd: S) {
        let panels = self.terms.len() / (self.count * PANEL);
        let column_panels = self.order.div_ceil(PANEL);
        for row in (0..panels).step_by(R) {
            for column in 0..column_panels.min(row + R) {
                if row + R <= panels {
                    self.tile::<S, V, R, C>(simd, row, column);
                } else {
                    self.tile::<S, V, 1, C>(simd, row, column);
                }
            }
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const V: usize, const R: usize, const C: usize>(
        &mut self,
        simd: S,
        row: usize,
        column: usize,
    ) {
        let length = self.count * PANEL;
        let width = PANEL.min(self.order - column * PANEL);
        let sign = simd.splat_f64s(self.sign);
        let rows: [&[S::f64s]; R] = std::array::from_fn(|r| {
            S::as_simd_f64s(&self.terms[(row + r) * length..(row + r + 1) * length]).0
        });
        let factors = &self.terms[column * length..(column + 1) * length];
        for c in (0..width).step_by(C) {
            let sums = products::<S, V, R, C>(simd, rows, factors, c);
            for (k, sum) in sums.iter().enumerate().take(width - c) {
                for (r, sum) in sum.iter().enumerate() {
                    let at = ((row + r) * self.order + column * PANEL + c + k) * PANEL;
                    let (target, _) = S::as_mut_simd_f64s(&mut self.panels[at..at + PANEL]);
                    for (t, &s) in target.iter_mut().zip(sum) {
                        *t = simd.mul_add_f64s(s, sign, *t);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_held_out_and_restored_leave_what_is_held_out() {
        for (order, responses) in [(1, 1), (7, 2), (8, 1), (13, 3), (40, 1)] {
            let value = |i: usize, j: usize| ((i * 31 + j * 17) % 23) as f64 / 100.0 - 0.1;
            let width = order + responses;
            let rows: Vec<Vec<f64>> = (0..150).map(|i| (0..width).map(|j| value(i, j)).collect()).collect();
            let fetch = |i: usize| rows[i].split_at(order);
            let mut gram = Gram::default();
            gram.start(order, responses);
            let all: Vec<usize> = (0..150).collect();
            gram.change(&all, -1.0, fetch);
            gram.change(&all[..70], 1.0, fetch);
            for i in 0..width {
                for j in 0..order.min(i + 1) {
                    let base = f64::from(i == j);
                    let sum: f64 = rows[70..].iter().map(|row| row[i] * row[j]).sum();
                    assert!((*gram.entry(i, j) - (base - sum)).abs() < 1e-13);
                }
            }
        }
    }
}
