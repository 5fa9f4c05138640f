//! `Q^T Q - Q_K^T Q_K` kept between held-out sets, above `Q^T b - Q_K^T b_K`.
//!
//! Of training rows that are light beside those held out, these differences are far below the digits of their terms, as are
//! residuals: hence b in twice the digits, not e as in plain arithmetic.

use pulp::{Arch, Simd, WithSimd};

use super::arithmetic::{Parts, Wide, products};
use crate::error::Error;
use crate::fit::panels::PANEL;
use crate::pool::Pool;

/// Rows added at a time: of two panels their packed copies stay in the first-level cache.
const PACKED_ROWS: usize = 128;

/// Rows of a part of the whole, whose sum does not depend on the number of threads.
const PART_ROWS: usize = 1024;

/// The matrix and the right-hand sides below it.
#[derive(Clone, Default)]
pub struct DdGram {
    pub(super) order: usize,
    /// A panel holds `order` columns of eight.
    pub(super) hi: Vec<f64>,
    pub(super) lo: Vec<f64>,
    /// One a row, four times what its sums may reach: those of unit columns, of right-hand sides as a whole.
    pub(super) anchors: Vec<[f64; PANEL]>,
    /// The rows under way: a panel holds as many columns of eight as there are rows.
    terms: Vec<f64>,
}

impl DdGram {
    /// Nothing held out of a basis and its right-hand sides, both row-major.
    pub fn whole(
        basis: &[f64],
        order: usize,
        right: &[f64],
        responses: usize,
        pool: &Pool<'_>,
    ) -> Result<Self, Error> {
        let fetch =
            |i: usize| (&basis[i * order..(i + 1) * order], &right[i * responses..(i + 1) * responses]);
        let mut sum = Self::zeros(order, responses);
        for c in 0..responses {
            let size: f64 = right[c..].iter().step_by(responses).map(|b| b.abs()).sum();
            sum.anchors[(order + c) / PANEL][(order + c) % PANEL] = 4.0 * size;
        }
        let rows = basis.len() / order.max(1);
        let mut parts = vec![sum.clone(); rows.div_ceil(PART_ROWS)];
        pool.run(parts.iter_mut().enumerate(), Vec::new, |block, (k, part)| {
            block.clear();
            block.extend((k * PART_ROWS..rows).take(PART_ROWS));
            part.change(block, 1.0, fetch);
        })?;
        for part in &parts {
            let DdGram { hi, lo, .. } = &mut sum;
            Arch::new().dispatch(Add { hi, lo, other: Parts { hi: &part.hi, lo: &part.lo } });
        }
        Ok(sum)
    }

    fn zeros(order: usize, responses: usize) -> Self {
        let panels = (order + responses).div_ceil(PANEL);
        let zeros = vec![0.0; panels * order * PANEL];
        Self { order, hi: zeros.clone(), lo: zeros, anchors: vec![[4.0; PANEL]; panels], terms: Vec::new() }
    }

    /// Takes the other's place without giving up the own memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.order = other.order;
        self.hi.clone_from(&other.hi);
        self.lo.clone_from(&other.lo);
        self.anchors.clone_from(&other.anchors);
    }

    /// Holds rows out (sign -1) or takes them back in (1), each given by its entries and its right-hand sides.
    pub fn change<'a>(&mut self, rows: &[usize], sign: f64, fetch: impl Fn(usize) -> (&'a [f64], &'a [f64])) {
        for batch in rows.chunks(PACKED_ROWS) {
            self.pack(batch, &fetch);
            let Self { order, hi, lo, anchors, terms } = self;
            Arch::new().dispatch(Change { order: *order, count: batch.len(), hi, lo, anchors, terms, sign });
        }
    }

    fn pack<'a>(&mut self, rows: &[usize], fetch: impl Fn(usize) -> (&'a [f64], &'a [f64])) {
        let Self { order, anchors, terms, .. } = self;
        terms.clear();
        terms.resize(anchors.len() * rows.len() * PANEL, 0.0);
        for (k, &row) in rows.iter().enumerate() {
            let (head, border) = fetch(row);
            let mut place = |i: usize, x: f64| {
                terms[(i / PANEL * rows.len() + k) * PANEL + i % PANEL] = x;
            };
            head.iter().enumerate().for_each(|(i, x)| place(i, *x));
            border.iter().enumerate().for_each(|(c, x)| place(*order + c, *x));
        }
    }
}

struct Add<'a> {
    hi: &'a mut [f64],
    lo: &'a mut [f64],
    other: Parts<'a>,
}

impl WithSimd for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (hi, lo) = (S::as_mut_simd_f64s(self.hi).0, S::as_mut_simd_f64s(self.lo).0);
        let (other_hi, other_lo) = (S::as_simd_f64s(self.other.hi).0, S::as_simd_f64s(self.other.lo).0);
        for (((hi, lo), &other_hi), &other_lo) in hi.iter_mut().zip(lo).zip(other_hi).zip(other_lo) {
            let sum = Wide::<S> { hi: *hi, lo: *lo }.plus(simd, Wide { hi: other_hi, lo: other_lo });
            (*hi, *lo) = (sum.hi, sum.lo);
        }
    }
}

/// Adds `sign` times the products of packed rows to the lower triangle and the border.
struct Change<'a> {
    order: usize,
    count: usize,
    hi: &'a mut [f64],
    lo: &'a mut [f64],
    anchors: &'a [[f64; PANEL]],
    terms: &'a [f64],
    sign: f64,
}

impl WithSimd for Change<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // Sums, rests, a panel's rows and a factor must fit the registers.
        match S::F64_LANES {
            8 => self.run::<S, 1, 8>(simd),
            4 => self.run::<S, 2, 2>(simd),
            2 => self.run::<S, 4, 1>(simd),
            _ => self.run::<S, 8, 1>(simd),
        }
    }
}

impl Change<'_> {
    #[inline(always)]
    fn run<S: Simd, const V: usize, const C: usize>(mut self, simd: S) {
        for row in 0..self.anchors.len() {
            for column in 0..self.order.div_ceil(PANEL).min(row + 1) {
                self.tile::<S, V, C>(simd, row, column);
            }
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const V: usize, const C: usize>(&mut self, simd: S, row: usize, column: usize) {
        let length = self.count * PANEL;
        let panel = |k: usize| Parts { hi: &self.terms[k * length..(k + 1) * length], lo: &[] };
        let sign = simd.splat_f64s(self.sign);
        let width = PANEL.min(self.order - column * PANEL);
        for c in (0..width).step_by(C) {
            let sums = products::<S, false, V, C>(simd, panel(row), panel(column), c, &self.anchors[row]);
            for (k, sum) in sums.iter().enumerate().take(width - c) {
                let at = (row * self.order + column * PANEL + c + k) * PANEL;
                let hi = S::as_mut_simd_f64s(&mut self.hi[at..at + PANEL]).0;
                let lo = S::as_mut_simd_f64s(&mut self.lo[at..at + PANEL]).0;
                for ((hi, lo), sum) in hi.iter_mut().zip(lo).zip(sum) {
                    let signed = Wide { hi: simd.mul_f64s(sign, sum.hi), lo: simd.mul_f64s(sign, sum.lo) };
                    let total = Wide::<S> { hi: *hi, lo: *lo }.plus(simd, signed);
                    (*hi, *lo) = (total.hi, total.lo);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{bits, noise, pool};

    /// Integers beyond what plain numbers hold exactly: sums of their products, of more rows than a part has.
    #[test]
    fn entries_are_exact_sums_of_products() {
        for (order, responses) in [(1, 1), (7, 3), (9, 0), (16, 2)] {
            let rows = PART_ROWS + 70;
            let integers = |count: usize, seed: u64| -> Vec<i128> {
                noise(count, seed).iter().map(|x| (x * 1e12) as i128).collect()
            };
            let (basis, right) = (integers(rows * order, 1), integers(rows * responses, 2));
            // At the size of unit columns; powers of two cost no digit.
            let size = (-44.0_f64).exp2();
            let plain = |values: &[i128]| values.iter().map(|&x| x as f64 * size).collect::<Vec<f64>>();
            let (q, b) = (plain(&basis), plain(&right));
            let fetch = |i: usize| (&q[i * order..(i + 1) * order], &b[i * responses..(i + 1) * responses]);
            let [mut gram, other] =
                [1, 3].map(|threads| DdGram::whole(&q, order, &b, responses, &pool(threads)).unwrap());
            assert_eq!((bits(&gram.hi), bits(&gram.lo)), (bits(&other.hi), bits(&other.lo)));
            // Out and in again, but for two rows.
            let some: Vec<usize> = (3..200).collect();
            gram.change(&some, -1.0, fetch);
            gram.change(&some[..195], 1.0, fetch);
            let held = [198, 199];
            let entry = |i: usize, k: usize| match k.checked_sub(order) {
                None => basis[i * order + k],
                Some(c) => right[i * responses + c],
            };
            for k in 0..order + responses {
                for j in 0..order.min(k + 1) {
                    let training = (0..rows).filter(|i| !held.contains(i));
                    let sum: i128 = training.map(|i| entry(i, k) * entry(i, j)).sum();
                    let at = (k / PANEL * order + j) * PANEL + k % PANEL;
                    let [hi, lo] = [gram.hi[at], gram.lo[at]].map(|x| (x / size / size) as i128);
                    assert!((hi + lo - sum).abs() <= 1 << 20, "{order} {k} {j}: {}", hi + lo - sum);
                }
            }
        }
    }
}
