//! The Cholesky factor of a [`DdGram`], panel by panel: each is carried through those before it, then through itself. Rows
//! that come later are carried likewise, and become forward solves.

use pulp::{Arch, Simd, WithSimd};

use super::arithmetic::{Dd, Parts, Wide, products};
use super::gram::DdGram;
use crate::fit::panels::PANEL;

/// Forward solves are anchored at this times a row's entries: four times the inverse root of the least eigenvalue at which
/// twice the digits are of use.
const GROWTH: f64 = (1_u64 << 22) as f64;

/// The factor, the forward solves of the right-hand sides, and those of other rows.
#[derive(Default)]
pub struct DdFactor {
    order: usize,
    hi: Vec<f64>,
    lo: Vec<f64>,
    inverse_pivots: Vec<Dd>,
    carried: Vec<f64>,
    carried_lo: Vec<f64>,
}

impl DdFactor {
    /// Factors; returns the smallest pivot, or zero where one is not positive.
    pub fn factor(&mut self, gram: &DdGram) -> f64 {
        let order = gram.order;
        self.order = order;
        self.hi.clone_from(&gram.hi);
        self.lo.clone_from(&gram.lo);
        self.inverse_pivots.clear();
        let Self { hi, lo, inverse_pivots, .. } = self;
        Arch::new().dispatch(Factor { order, hi, lo, anchors: &gram.anchors, inverse_pivots })
    }

    /// `L^T`, column-major, in plain numbers.
    pub fn upper(&self) -> Vec<f64> {
        let order = self.order;
        let mut upper = vec![0.0; order * order];
        for (i, column) in upper.chunks_exact_mut(order.max(1)).enumerate() {
            column[..=i].iter_mut().zip(self.row(i)).for_each(|(u, l)| *u = l);
        }
        upper
    }

    /// `L^-1 (Q^T b - Q_K^T b_K)` of a response, in plain numbers.
    pub fn projection(&self, response: usize) -> Vec<f64> {
        self.row(self.order + response).collect()
    }

    fn row(&self, i: usize) -> impl Iterator<Item = f64> {
        self.hi[(i / PANEL * self.order * PANEL + i % PANEL).min(self.hi.len())..]
            .iter()
            .step_by(PANEL)
            .take(self.order)
            .copied()
    }

    /// `L^-1 x` of up to eight plain rows, in plain numbers: `order` columns of eight lanes.
    pub fn forward(&mut self, rows: &[&[f64]]) -> &[[f64; PANEL]] {
        let Self { order, hi, lo, inverse_pivots, carried, carried_lo } = self;
        for part in [&mut *carried, carried_lo] {
            part.clear();
            part.resize(*order * PANEL, 0.0);
        }
        let mut anchors = [0.0; PANEL];
        for (lane, (row, anchor)) in rows.iter().zip(&mut anchors).enumerate() {
            carried[lane..].iter_mut().step_by(PANEL).zip(*row).for_each(|(to, x)| *to = *x);
            *anchor = GROWTH * row.iter().map(|x| x.abs()).sum::<f64>();
        }
        let panel = Panel { hi: carried, lo: carried_lo, anchors: &anchors };
        let factor = Parts { hi, lo };
        Arch::new().dispatch(Carry { order: *order, factor, inverse_pivots, panel });
        self.carried.as_chunks().0
    }
}

/// Turns a matrix into its factor; returns the smallest pivot.
struct Factor<'a> {
    order: usize,
    hi: &'a mut [f64],
    lo: &'a mut [f64],
    anchors: &'a [[f64; PANEL]],
    inverse_pivots: &'a mut Vec<Dd>,
}

impl WithSimd for Factor<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        match S::F64_LANES {
            8 => self.run::<S, 1, 8>(simd),
            4 => self.run::<S, 2, 2>(simd),
            2 => self.run::<S, 4, 1>(simd),
            _ => self.run::<S, 8, 1>(simd),
        }
    }
}

impl Factor<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize, const C: usize>(self, simd: S) -> f64 {
        let Self { order, hi, lo, anchors, inverse_pivots } = self;
        let stride = order * PANEL;
        let mut smallest = f64::INFINITY;
        for (index, anchors) in anchors.iter().enumerate() {
            let (before_hi, rest_hi) = hi.split_at_mut(index * stride);
            let (before_lo, rest_lo) = lo.split_at_mut(index * stride);
            let mut panel = Panel { hi: &mut rest_hi[..stride], lo: &mut rest_lo[..stride], anchors };
            let before = Parts { hi: before_hi, lo: before_lo };
            let first = (index * PANEL).min(order);
            panel.carry::<S, V, C>(simd, before, &inverse_pivots[..first]);
            let width = PANEL.min(order - first);
            panel.subtract::<S, V, C>(simd, None, first, width);
            for k in first..first + width {
                let at = k * PANEL + k - first;
                let pivot = Dd { hi: panel.hi[at], lo: panel.lo[at] };
                smallest = smallest.min(pivot.hi);
                if smallest.is_nan() || smallest <= 0.0 {
                    return 0.0;
                }
                inverse_pivots.push(pivot.inverse_root());
                panel.scale::<S>(simd, k, inverse_pivots[k]);
                for j in k + 1..first + width {
                    let at = k * PANEL + j - first;
                    let factor = Dd { hi: panel.hi[at], lo: panel.lo[at] };
                    panel.subtract_column::<S>(simd, j, k, factor);
                }
            }
        }
        smallest
    }
}

struct Carry<'a> {
    order: usize,
    factor: Parts<'a>,
    inverse_pivots: &'a [Dd],
    panel: Panel<'a>,
}

impl WithSimd for Carry<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { order, factor, inverse_pivots, mut panel } = self;
        debug_assert_eq!(order, inverse_pivots.len());
        match S::F64_LANES {
            8 => panel.carry::<S, 1, 8>(simd, factor, inverse_pivots),
            4 => panel.carry::<S, 2, 2>(simd, factor, inverse_pivots),
            2 => panel.carry::<S, 4, 1>(simd, factor, inverse_pivots),
            _ => panel.carry::<S, 8, 1>(simd, factor, inverse_pivots),
        }
    }
}

/// Eight rows that become forward solves.
struct Panel<'a> {
    hi: &'a mut [f64],
    lo: &'a mut [f64],
    anchors: &'a [f64; PANEL],
}

impl Panel<'_> {
    /// Solves for the unknowns whose pivots are given, with their panels of the factor.
    #[inline(always)]
    fn carry<S: Simd, const V: usize, const C: usize>(
        &mut self,
        simd: S,
        factor: Parts<'_>,
        inverse_pivots: &[Dd],
    ) {
        let stride = self.hi.len();
        for (index, inverses) in inverse_pivots.chunks(PANEL).enumerate() {
            let first = index * PANEL;
            let diagonal = factor.part(index * stride..(index + 1) * stride);
            self.subtract::<S, V, C>(simd, Some(diagonal.part(0..first * PANEL)), first, inverses.len());
            for (k, &inverse) in inverses.iter().enumerate() {
                self.scale::<S>(simd, first + k, inverse);
                for j in k + 1..inverses.len() {
                    let at = (first + k) * PANEL + j;
                    let factor = Dd { hi: diagonal.hi[at], lo: diagonal.lo[at] };
                    self.subtract_column::<S>(simd, first + j, first + k, factor);
                }
            }
        }
    }

    /// Subtracts the inner products of what is solved with rows of another panel, or its own, from `width` columns.
    #[inline(always)]
    fn subtract<S: Simd, const V: usize, const C: usize>(
        &mut self,
        simd: S,
        factors: Option<Parts<'_>>,
        first: usize,
        width: usize,
    ) {
        let (known_hi, rest_hi) = self.hi.split_at_mut(first * PANEL);
        let (known_lo, rest_lo) = self.lo.split_at_mut(first * PANEL);
        let known = Parts { hi: known_hi, lo: known_lo };
        let factors = factors.unwrap_or(known);
        for c in (0..width).step_by(C) {
            let sums = products::<S, true, V, C>(simd, known, factors, c, self.anchors);
            for (k, sum) in sums.iter().enumerate().take(width - c) {
                let at = (c + k) * PANEL;
                let hi = S::as_mut_simd_f64s(&mut rest_hi[at..at + PANEL]).0;
                let lo = S::as_mut_simd_f64s(&mut rest_lo[at..at + PANEL]).0;
                for ((hi, lo), &sum) in hi.iter_mut().zip(lo).zip(sum) {
                    let left = Wide::<S> { hi: *hi, lo: *lo }.minus(simd, sum);
                    (*hi, *lo) = (left.hi, left.lo);
                }
            }
        }
    }

    /// Multiplies a column.
    #[inline(always)]
    fn scale<S: Simd>(&mut self, simd: S, column: usize, factor: Dd) {
        let factor = Wide::splat(simd, factor);
        let range = column * PANEL..(column + 1) * PANEL;
        let hi = S::as_mut_simd_f64s(&mut self.hi[range.clone()]).0;
        let lo = S::as_mut_simd_f64s(&mut self.lo[range]).0;
        for (hi, lo) in hi.iter_mut().zip(lo) {
            let scaled = Wide::<S> { hi: *hi, lo: *lo }.times(simd, factor);
            (*hi, *lo) = (scaled.hi, scaled.lo);
        }
    }

    /// Subtracts a multiple of an earlier column from one.
    #[inline(always)]
    fn subtract_column<S: Simd>(&mut self, simd: S, column: usize, earlier: usize, factor: Dd) {
        let factor = Wide::splat(simd, factor);
        let (before_hi, rest_hi) = self.hi.split_at_mut(column * PANEL);
        let (before_lo, rest_lo) = self.lo.split_at_mut(column * PANEL);
        let range = earlier * PANEL..(earlier + 1) * PANEL;
        let from_hi = S::as_simd_f64s(&before_hi[range.clone()]).0;
        let from_lo = S::as_simd_f64s(&before_lo[range]).0;
        let hi = S::as_mut_simd_f64s(&mut rest_hi[..PANEL]).0;
        let lo = S::as_mut_simd_f64s(&mut rest_lo[..PANEL]).0;
        for (((hi, lo), &from_hi), &from_lo) in hi.iter_mut().zip(lo).zip(from_hi).zip(from_lo) {
            let product = Wide::<S> { hi: from_hi, lo: from_lo }.times(simd, factor);
            let left = Wide::<S> { hi: *hi, lo: *lo }.minus(simd, product);
            (*hi, *lo) = (left.hi, left.lo);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::pool::Pool;

    /// Columns that differ by 1e-12 of their length: their Gram matrix is singular to plain arithmetic.
    #[test]
    fn the_factor_keeps_what_plain_numbers_lose() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(2, &flag);
        for rows in [5, 40, 3000] {
            let entry = |i: usize, j: usize| {
                let base = ((i * 7919) % 101) as f64 / 128.0;
                // A power of two, so that entries stay exact, and columns of about unit length.
                let size = (-(rows as f64).log2() / 2.0).floor().exp2();
                (base + ((i * (j + 2)) % 13) as f64 * (-40.0 * f64::from(u8::from(j > 0))).exp2()) * size
            };
            let basis: Vec<f64> = (0..rows).flat_map(|i| (0..2).map(move |j| entry(i, j))).collect();
            let right = vec![1.0; rows];
            let mut gram = DdGram::whole(&basis, 2, &right, 1, &pool).unwrap();
            let fetch = |i: usize| (&basis[i * 2..(i + 1) * 2], &[1.0][..]);
            gram.change(&[0, 1, 2], -1.0, fetch);
            gram.change(&[1, 2], 1.0, fetch);
            let mut factor = DdFactor::default();
            assert!(factor.factor(&gram) > 0.0);
            // Exactly: the second pivot is the squared distance of the second column to the first.
            let column = |j: usize| (1..rows).map(move |i| (entry(i, 0), entry(i, j)));
            let length: f64 = column(0).map(|(a, _)| a * a).sum();
            let slope: f64 = column(1).map(|(a, b)| a * (b - a)).sum::<f64>() / length;
            let distance: f64 = column(1).map(|(a, b)| ((b - a) - slope * a).powi(2)).sum();
            let upper = factor.upper();
            assert!((upper[3] / distance.sqrt() - 1.0).abs() < 1e-6);
            assert!((factor.forward(&[&[0.0, 1.0]])[1][0] * upper[3] - 1.0).abs() < 1e-12);
            // The right-hand side was that of row 0 too; what is left is the sum of the other rows, exactly.
            let sum: f64 = column(0).map(|(a, _)| a).sum();
            assert!((factor.projection(0)[0] * upper[0] / sum - 1.0).abs() < 1e-12);
        }
    }

    /// On either side of every panel, the forward solves are those of the factor, of right-hand sides and of later rows.
    #[test]
    fn forward_solves_are_those_of_the_factor() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(1, &flag);
        for (order, responses) in [(1, 1), (7, 1), (8, 2), (9, 8), (23, 3), (64, 1)] {
            let value = |i: usize, j: usize| 0.1 * (((i * 37 + j * 101) as f64).sin() * 43_758.5).fract();
            let rows = 2 * order + 5;
            let basis: Vec<f64> = (0..rows * order).map(|k| value(k / order, k % order)).collect();
            let right: Vec<f64> = (0..rows * responses).map(|k| value(k, 3)).collect();
            let mut gram = DdGram::whole(&basis, order, &right, responses, &pool).unwrap();
            gram.change(&[1], -1.0, |i| {
                (&basis[i * order..(i + 1) * order], &right[i * responses..(i + 1) * responses])
            });
            let mut factor = DdFactor::default();
            assert!(factor.factor(&gram) > 0.0);
            let upper = factor.upper();
            let times_lower = |x: &[f64], i: usize| (0..=i).map(|j| upper[i * order + j] * x[j]).sum::<f64>();
            for c in 0..responses {
                let solved = factor.projection(c);
                for j in 0..order {
                    let kept = (0..rows).filter(|&i| i != 1);
                    let sum: f64 = kept.map(|i| basis[i * order + j] * right[i * responses + c]).sum();
                    assert!((times_lower(&solved, j) - sum).abs() < 1e-13, "order {order}");
                }
            }
            let later: Vec<&[f64]> = basis.chunks(order).take(5).collect();
            let solved = factor.forward(&later).to_vec();
            for (lane, row) in later.iter().enumerate() {
                let x: Vec<f64> = solved.iter().map(|u| u[lane]).collect();
                (0..order).for_each(|j| assert!((times_lower(&x, j) - row[j]).abs() < 1e-13));
            }
        }
    }
}
