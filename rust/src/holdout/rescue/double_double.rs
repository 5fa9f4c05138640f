//! Twice the digits, for pairs close to rank loss: `I - Q_K^T Q_K` in double-double arithmetic, and its factor.
//!
//! M squares singular values, so that in plain arithmetic predictions lose 1 / lambda_min(M): twice the digits that a refit
//! of the training rows loses. With twice the digits the closed form is as accurate as the refit, and its cost does not
//! depend on the number of training rows. Q is orthonormal to rounding only, so `Q^T Q`, computed once, replaces I.
//!
//! A number is an unevaluated sum of two, hi + lo, as in Dekker (1971); sums of products are those of Ogita, Rump and Oishi,
//! "Accurate sum and dot product" (SIAM J. Sci. Comput. 2005). Matrices are pairs of row-major squares, of which only the lower
//! triangle counts.

use pulp::{Arch, Simd, WithSimd};

use crate::error::Error;
use crate::pool::Pool;

/// Inner products that share a factor, and hide each other's latency.
const GROUP: usize = 4;

/// A number with twice the digits.
#[derive(Clone, Copy, Default)]
struct Dd {
    hi: f64,
    lo: f64,
}

impl Dd {
    fn new(hi: f64) -> Self {
        Self { hi, lo: 0.0 }
    }

    /// Of a sum whose first term is the larger.
    #[inline(always)]
    fn renormalised(hi: f64, lo: f64) -> Self {
        let sum = hi + lo;
        Self { hi: sum, lo: lo - (sum - hi) }
    }

    #[inline(always)]
    fn plus(self, other: Self) -> Self {
        let (sum, error) = two_sum(self.hi, other.hi);
        Self::renormalised(sum, error + self.lo + other.lo)
    }

    #[inline(always)]
    fn minus(self, other: Self) -> Self {
        self.plus(Self { hi: -other.hi, lo: -other.lo })
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        let (product, error) = two_product(self.hi, other.hi);
        Self::renormalised(product, error + (self.lo * other.hi + self.hi * other.lo))
    }

    /// Newton's correction of a plain reciprocal.
    #[inline(always)]
    fn reciprocal(self) -> Self {
        let guess = Self::new(self.hi.recip());
        let rest = Self::new(1.0).minus(self.times(guess));
        guess.plus(rest.times(guess))
    }

    #[inline(always)]
    fn root(self) -> Self {
        let guess = Self::new(self.hi.sqrt());
        let rest = self.minus(guess.times(guess));
        guess.plus(Self::new(0.5 * rest.hi / guess.hi))
    }
}

#[inline(always)]
fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let back = sum - a;
    (sum, (a - (sum - back)) + (b - back))
}

/// Dekker's product: a fused multiply-add is a slow call where the compiler does not know of the instruction.
#[inline(always)]
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let split = |x: f64| {
        let big = 134_217_729.0 * x;
        let high = big - (big - x);
        (high, x - high)
    };
    let (product, (a, a_low), (b, b_low)) = (a * b, split(a), split(b));
    (product, ((a * b - product) + a * b_low + a_low * b) + a_low * b_low)
}

/// Parts hi and lo of many numbers.
#[derive(Clone, Default)]
pub struct DdMatrix {
    hi: Vec<f64>,
    lo: Vec<f64>,
}

impl DdMatrix {
    fn zeros(count: usize) -> Self {
        Self { hi: vec![0.0; count], lo: vec![0.0; count] }
    }

    fn get(&self, i: usize) -> Dd {
        Dd { hi: self.hi[i], lo: self.lo[i] }
    }

    fn set(&mut self, i: usize, value: Dd) {
        (self.hi[i], self.lo[i]) = (value.hi, value.lo);
    }

    fn add(&mut self, other: &Self) {
        (0..self.hi.len()).for_each(|i| self.set(i, self.get(i).plus(other.get(i))));
    }

    fn part(&self, first: usize, count: usize) -> Pair<'_> {
        (&self.hi[first..first + count], &self.lo[first..first + count])
    }

    fn copy(&mut self, other: Pair<'_>) {
        other.0.clone_into(&mut self.hi);
        other.1.clone_into(&mut self.lo);
    }
}

/// Numbers with twice the digits, side by side.
type Pair<'a> = (&'a [f64], &'a [f64]);

/// Adds one vector to N inner products: to the sums, and to the errors of sums and products. Everything is inlined by
/// force: a call would leave the registers, and the instructions that the caller was compiled for.
#[inline(always)]
fn accumulate<S: Simd, const LOW: bool>(
    simd: S,
    (a, a_lo): (S::f64s, S::f64s),
    (b, b_lo): (S::f64s, S::f64s),
    (sum, error): (S::f64s, S::f64s),
) -> (S::f64s, S::f64s) {
    let product = simd.mul_f64s(a, b);
    let mut small = simd.mul_add_f64s(a, b, simd.neg_f64s(product));
    if LOW {
        small = simd.mul_add_f64s(a, b_lo, simd.mul_add_f64s(a_lo, b, small));
    }
    let total = simd.add_f64s(sum, product);
    let back = simd.sub_f64s(total, sum);
    let lost = simd.add_f64s(simd.sub_f64s(sum, simd.sub_f64s(total, back)), simd.sub_f64s(product, back));
    (total, simd.add_f64s(error, simd.add_f64s(lost, small)))
}

/// Inner products of `a` with each of `b`. Without `LOW` the parts lo are all zero.
#[inline(always)]
fn dots<S: Simd, const LOW: bool, const N: usize>(simd: S, a: Pair<'_>, b: [Pair<'_>; N]) -> [Dd; N] {
    let zero = simd.splat_f64s(0.0);
    let mut sums = [(zero, zero); N];
    let lanes = S::F64_LANES;
    let whole = a.0.len() - a.0.len() % lanes;
    let (a_hi, a_lo) = (S::as_simd_f64s(a.0).0, S::as_simd_f64s(a.1).0);
    let mut b_hi = [a_hi; N];
    let mut b_lo = [a_lo; N];
    for k in 0..N {
        b_hi[k] = &S::as_simd_f64s(b[k].0).0[..a_hi.len()];
        b_lo[k] = S::as_simd_f64s(b[k].1).0;
        if LOW {
            b_lo[k] = &b_lo[k][..a_hi.len()];
        }
    }
    for t in 0..a_hi.len() {
        let left = (a_hi[t], if LOW { a_lo[t] } else { zero });
        for k in 0..N {
            let right = (b_hi[k][t], if LOW { b_lo[k][t] } else { zero });
            sums[k] = accumulate::<S, LOW>(simd, left, right, sums[k]);
        }
    }
    if whole < a.0.len() {
        let low = |x: &[f64]| if LOW { simd.partial_load_f64s(&x[whole..]) } else { zero };
        let left = (simd.partial_load_f64s(&a.0[whole..]), low(a.1));
        for k in 0..N {
            let right = (simd.partial_load_f64s(&b[k].0[whole..]), low(b[k].1));
            sums[k] = accumulate::<S, LOW>(simd, left, right, sums[k]);
        }
    }
    let mut totals = [Dd::default(); N];
    for k in 0..N {
        let (mut hi, mut lo) = ([0.0; 8], [0.0; 8]);
        simd.partial_store_f64s(&mut hi[..lanes], sums[k].0);
        simd.partial_store_f64s(&mut lo[..lanes], sums[k].1);
        totals[k] = total(hi, lo);
    }
    totals
}

/// Sum of eight numbers, in a tree: a chain would take longer than the products.
#[inline(always)]
fn total(mut hi: [f64; 8], lo: [f64; 8]) -> Dd {
    let mut low: f64 = lo.iter().sum();
    for half in [4, 2, 1] {
        for k in 0..half {
            let (sum, error) = two_sum(hi[k], hi[k + half]);
            hi[k] = sum;
            low += error;
        }
    }
    Dd::renormalised(hi[0], low)
}

/// Columns of rows, one after another.
fn transpose<'a>(rows: impl ExactSizeIterator<Item = &'a [f64]>, order: usize, columns: &mut Vec<f64>) {
    let count = rows.len();
    columns.resize(count * order, 0.0);
    for (k, row) in rows.enumerate() {
        columns[k..].iter_mut().step_by(count).zip(row).for_each(|(to, x)| *to = *x);
    }
}

/// Adds the inner products of columns, times a sign, to the lower triangle of a matrix.
fn add_products(target: &mut DdMatrix, columns: &[f64], order: usize, sign: f64) {
    Arch::new().dispatch(AddProducts { target, columns, order, sign });
}

struct AddProducts<'a> {
    target: &'a mut DdMatrix,
    columns: &'a [f64],
    order: usize,
    sign: f64,
}

impl WithSimd for AddProducts<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { target, columns, order, sign } = self;
        let count = columns.len() / order.max(1);
        let column = |j: usize| (&columns[j * count..(j + 1) * count], &columns[..0]);
        for i in 0..order {
            for first in (0..=i).step_by(GROUP) {
                // What lies above the diagonal is computed and not used.
                let others = std::array::from_fn(|k| column((first + k).min(order - 1)));
                let products = dots::<S, false, GROUP>(simd, column(i), others);
                for (k, Dd { hi, lo }) in products.into_iter().enumerate().take(i + 1 - first) {
                    let at = i * order + first + k;
                    target.set(at, target.get(at).plus(Dd { hi: sign * hi, lo: sign * lo }));
                }
            }
        }
    }
}

/// `Q^T Q - Q_K^T Q_K` above `Q^T b - Q_K^T b_K`. Of training rows that are light beside those held out, these differences
/// are far below the digits of their terms, as are residuals: hence b in twice the digits, not e as in plain arithmetic.
#[derive(Clone, Default)]
pub struct DdGram {
    order: usize,
    matrix: DdMatrix,
    /// Responses x order.
    right: DdMatrix,
    columns: Vec<f64>,
    responses: Vec<f64>,
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
        const GRAM_ROWS: usize = 1024;
        let fetch =
            |i: usize| (&basis[i * order..(i + 1) * order], &right[i * responses..(i + 1) * responses]);
        let rows = basis.len() / order.max(1);
        let mut parts = vec![Self::zeros(order, responses); rows.div_ceil(GRAM_ROWS)];
        pool.run(parts.iter_mut().enumerate(), Vec::new, |block, (k, part)| {
            block.clear();
            block.extend((k * GRAM_ROWS..rows).take(GRAM_ROWS));
            part.change(block, 1.0, fetch);
        })?;
        let mut sum = Self::zeros(order, responses);
        for part in &parts {
            sum.matrix.add(&part.matrix);
            sum.right.add(&part.right);
        }
        Ok(sum)
    }

    fn zeros(order: usize, responses: usize) -> Self {
        Self {
            order,
            matrix: DdMatrix::zeros(order * order),
            right: DdMatrix::zeros(order * responses),
            ..Self::default()
        }
    }

    /// Takes the other's place without giving up the own memory.
    pub fn copy_from(&mut self, other: &Self) {
        self.order = other.order;
        self.matrix.copy((&other.matrix.hi, &other.matrix.lo));
        self.right.copy((&other.right.hi, &other.right.lo));
    }

    /// Holds rows out (sign -1) or takes them back in (1), each given by its entries and its right-hand sides.
    pub fn change<'a>(&mut self, rows: &[usize], sign: f64, fetch: impl Fn(usize) -> (&'a [f64], &'a [f64])) {
        let Self { order, matrix, right, columns, responses } = self;
        if rows.is_empty() || *order == 0 {
            return;
        }
        transpose(rows.iter().map(|&i| fetch(i).0), *order, columns);
        transpose(rows.iter().map(|&i| fetch(i).1), right.hi.len() / *order, responses);
        add_products(matrix, columns, *order, sign);
        for (c, b) in responses.chunks_exact(rows.len()).enumerate() {
            for (j, column) in columns.chunks_exact(rows.len()).enumerate() {
                let Dd { hi, lo } = Arch::new().dispatch(Dot { a: column, b });
                let at = c * *order + j;
                right.set(at, right.get(at).plus(Dd { hi: sign * hi, lo: sign * lo }));
            }
        }
    }
}

/// The Cholesky factor of a [`DdGram`], and forward solves.
#[derive(Default)]
pub struct DdFactor {
    order: usize,
    lower: DdMatrix,
    inverse_pivots: DdMatrix,
    /// `L^-1 (Q^T b - Q_K^T b_K)`, responses x order.
    right: DdMatrix,
    row: DdMatrix,
}

impl DdFactor {
    /// Factors; returns the smallest pivot, or zero where one is not positive.
    pub fn factor(&mut self, gram: &DdGram) -> f64 {
        let order = gram.order;
        self.order = order;
        self.lower.copy((&gram.matrix.hi, &gram.matrix.lo));
        self.inverse_pivots = DdMatrix::zeros(order);
        let Self { lower, inverse_pivots, right, row, .. } = self;
        let smallest = Arch::new().dispatch(Cholesky { lower, inverse_pivots, order });
        if smallest > 0.0 {
            right.copy((&gram.right.hi, &gram.right.lo));
            for c in 0..right.hi.len() / order.max(1) {
                let part = c * order..(c + 1) * order;
                row.copy((&right.hi[part.clone()], &right.lo[part.clone()]));
                Arch::new().dispatch(Substitute { lower, inverse_pivots, x: row });
                right.hi[part.clone()].copy_from_slice(&row.hi);
                right.lo[part].copy_from_slice(&row.lo);
            }
        }
        smallest
    }

    /// `L^T`, column-major, in plain numbers.
    pub fn upper(&self) -> Vec<f64> {
        let order = self.order;
        let mut upper = vec![0.0; order * order];
        for (i, column) in upper.chunks_exact_mut(order.max(1)).enumerate() {
            column[..=i].copy_from_slice(&self.lower.hi[i * order..=i * order + i]);
        }
        upper
    }

    /// `L^-1 (Q^T b - Q_K^T b_K)` of a response, in plain numbers.
    pub fn projection(&self, response: usize) -> &[f64] {
        &self.right.hi[response * self.order..(response + 1) * self.order]
    }

    /// `L^-1 x` of a plain row.
    pub fn forward(&mut self, row: &[f64]) -> &[f64] {
        let Self { lower, inverse_pivots, row: x, .. } = self;
        x.hi.clear();
        x.hi.extend_from_slice(row);
        x.lo.clear();
        x.lo.resize(row.len(), 0.0);
        Arch::new().dispatch(Substitute { lower, inverse_pivots, x });
        &self.row.hi
    }
}

/// One inner product of plain numbers.
struct Dot<'a> {
    a: &'a [f64],
    b: &'a [f64],
}

impl WithSimd for Dot<'_> {
    type Output = Dd;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Dd {
        let [product] = dots::<S, false, 1>(simd, (self.a, &[]), [(self.b, &[])]);
        product
    }
}

/// Turns a lower triangle into its factor; returns the smallest pivot.
struct Cholesky<'a> {
    lower: &'a mut DdMatrix,
    inverse_pivots: &'a mut DdMatrix,
    order: usize,
}

impl WithSimd for Cholesky<'_> {
    type Output = f64;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f64 {
        let Self { lower, inverse_pivots, order } = self;
        let mut smallest = f64::INFINITY;
        for first in (0..order).step_by(GROUP) {
            let last = order.min(first + GROUP);
            for j in 0..first {
                // The group's rows have the part of row j in common.
                let rows = std::array::from_fn(|k| lower.part((first + k).min(last - 1) * order, j));
                let known = dots::<S, true, GROUP>(simd, lower.part(j * order, j), rows);
                for (i, known) in (first..last).zip(known) {
                    let value = lower.get(i * order + j).minus(known).times(inverse_pivots.get(j));
                    lower.set(i * order + j, value);
                }
            }
            for i in first..last {
                for j in first..i {
                    let [known] =
                        dots::<S, true, 1>(simd, lower.part(j * order, j), [lower.part(i * order, j)]);
                    let value = lower.get(i * order + j).minus(known).times(inverse_pivots.get(j));
                    lower.set(i * order + j, value);
                }
                let row = lower.part(i * order, i);
                let [known] = dots::<S, true, 1>(simd, row, [row]);
                let pivot = lower.get(i * order + i).minus(known);
                smallest = smallest.min(pivot.hi);
                if smallest.is_nan() || smallest <= 0.0 {
                    return 0.0;
                }
                let root = pivot.root();
                lower.set(i * order + i, root);
                inverse_pivots.set(i, root.reciprocal());
            }
        }
        smallest
    }
}

/// `x <- L^-1 x`.
struct Substitute<'a> {
    lower: &'a DdMatrix,
    inverse_pivots: &'a DdMatrix,
    x: &'a mut DdMatrix,
}

impl WithSimd for Substitute<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { lower, inverse_pivots, x } = self;
        let order = x.hi.len();
        for i in 0..order {
            let [known] = dots::<S, true, 1>(simd, lower.part(i * order, i), [x.part(0, i)]);
            x.set(i, x.get(i).minus(known).times(inverse_pivots.get(i)));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;

    /// Columns that differ by 1e-12 of their length: their Gram matrix is singular to plain arithmetic.
    #[test]
    fn the_factor_keeps_what_plain_numbers_lose() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(2, &flag);
        for (rows, order) in [(5, 2), (40, 9), (3000, 21)] {
            let entry = |i: usize, j: usize| {
                let base = ((i * 7919) % 101) as f64 / 128.0;
                base + ((i * (j + 2)) % 13) as f64 * (-40.0 * f64::from(u8::from(j > 0))).exp2()
            };
            let basis: Vec<f64> =
                (0..rows).flat_map(|i| (0..order.min(2)).map(move |j| entry(i, j))).collect();
            let order = order.min(2);
            let right = vec![1.0; rows];
            let mut gram = DdGram::whole(&basis, order, &right, 1, &pool).unwrap();
            let fetch = |i: usize| (&basis[i * order..(i + 1) * order], &[1.0][..]);
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
            assert!((factor.forward(&[0.0, 1.0])[1] * upper[3] - 1.0).abs() < 1e-12);
            // The right-hand side was that of row 0 too; what is left is the sum of the other rows, exactly.
            let sum: f64 = column(0).map(|(a, _)| a).sum();
            assert!((factor.projection(0)[0] * upper[0] / sum - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn products_and_roots_have_twice_the_digits() {
        let third = Dd::new(3.0).reciprocal();
        let one = third.times(Dd::new(3.0)).minus(Dd::new(1.0));
        assert!(one.hi.abs() < 1e-31);
        let root = Dd::new(2.0).root();
        assert!(root.times(root).minus(Dd::new(2.0)).hi.abs() < 1e-30);
    }
}
