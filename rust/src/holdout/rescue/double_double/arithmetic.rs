//! Numbers with twice the digits, hi + lo, as in Dekker (1971); and inner products of panels of eight rows.
//!
//! The sum of an inner product starts from an *anchor* larger than it will ever be. What a product adds to the sum is then
//! found exactly by one subtraction, the rest of the product by one fused multiply-add, and rests are summed apart: four
//! instructions a product, where the sums of Ogita, Rump and Oishi (SIAM J. Sci. Comput. 2005) take ten. The error is about
//! 1e-32 of the anchor, and these sums have bounds: a Gram matrix's are those of unit columns.

use pulp::Simd;

use crate::fit::panels::PANEL;

/// A number with twice the digits.
#[derive(Clone, Copy, Default)]
pub(super) struct Dd {
    pub hi: f64,
    pub lo: f64,
}

impl Dd {
    /// Of a sum whose first term is the larger.
    fn renormalised(hi: f64, lo: f64) -> Self {
        let sum = hi + lo;
        Self { hi: sum, lo: lo - (sum - hi) }
    }

    /// One over the square root, by Newton's correction of the plain one.
    pub fn inverse_root(self) -> Self {
        let guess = self.hi.sqrt().recip();
        let (square, error) = two_product(guess, guess);
        let (product, lost) = two_product(self.hi, square);
        let rest = (1.0 - product) - (lost + self.hi * error + self.lo * square);
        Self::renormalised(guess, 0.5 * guess * rest)
    }
}

/// Dekker's product: a fused multiply-add is a slow call where the compiler does not know of the instruction.
fn two_product(a: f64, b: f64) -> (f64, f64) {
    let split = |x: f64| {
        let big = 134_217_729.0 * x;
        let high = big - (big - x);
        (high, x - high)
    };
    let (product, (a, a_low), (b, b_low)) = (a * b, split(a), split(b));
    (product, ((a * b - product) + a * b_low + a_low * b) + a_low * b_low)
}

/// Vectors of numbers with twice the digits.
#[derive(Clone, Copy)]
pub(super) struct Wide<S: Simd> {
    pub hi: S::f64s,
    pub lo: S::f64s,
}

/// Everything is inlined by force: a call would leave the registers, and the instructions that the caller was compiled for.
impl<S: Simd> Wide<S> {
    #[inline(always)]
    pub fn splat(simd: S, value: Dd) -> Self {
        Self { hi: simd.splat_f64s(value.hi), lo: simd.splat_f64s(value.lo) }
    }

    #[inline(always)]
    fn renormalised(simd: S, hi: S::f64s, lo: S::f64s) -> Self {
        let sum = simd.add_f64s(hi, lo);
        Self { hi: sum, lo: simd.sub_f64s(lo, simd.sub_f64s(sum, hi)) }
    }

    #[inline(always)]
    pub fn plus(self, simd: S, other: Self) -> Self {
        let sum = simd.add_f64s(self.hi, other.hi);
        let back = simd.sub_f64s(sum, self.hi);
        let lost =
            simd.add_f64s(simd.sub_f64s(self.hi, simd.sub_f64s(sum, back)), simd.sub_f64s(other.hi, back));
        Self::renormalised(simd, sum, simd.add_f64s(lost, simd.add_f64s(self.lo, other.lo)))
    }

    #[inline(always)]
    pub fn minus(self, simd: S, other: Self) -> Self {
        self.plus(simd, Self { hi: simd.neg_f64s(other.hi), lo: simd.neg_f64s(other.lo) })
    }

    #[inline(always)]
    pub fn times(self, simd: S, other: Self) -> Self {
        let product = simd.mul_f64s(self.hi, other.hi);
        let error = simd.mul_add_f64s(self.hi, other.hi, simd.neg_f64s(product));
        let error = simd.mul_add_f64s(self.hi, other.lo, simd.mul_add_f64s(self.lo, other.hi, error));
        Self::renormalised(simd, product, error)
    }
}

/// Parts hi and lo of panels.
#[derive(Clone, Copy)]
pub(super) struct Parts<'a> {
    pub hi: &'a [f64],
    pub lo: &'a [f64],
}

impl<'a> Parts<'a> {
    pub fn part(self, range: std::ops::Range<usize>) -> Self {
        let lo = if self.lo.is_empty() { self.lo } else { &self.lo[range.clone()] };
        Self { hi: &self.hi[range], lo }
    }
}

/// Inner products of a panel's rows with rows `first..first + C` of another, over all of their columns. `V` vectors make a
/// panel; `anchors` has one for each of its rows. Without `LOW` the parts lo are all zero, and not read.
#[inline(always)]
pub(super) fn products<S: Simd, const LOW: bool, const V: usize, const C: usize>(
    simd: S,
    rows: Parts<'_>,
    factors: Parts<'_>,
    first: usize,
    anchors: &[f64; PANEL],
) -> [[Wide<S>; V]; C] {
    assert!(first + C <= PANEL);
    let zero = simd.splat_f64s(0.0);
    let anchors = &S::as_simd_f64s(anchors).0.as_chunks::<V>().0[0];
    let mut sums = [*anchors; C];
    let mut rests = [[zero; V]; C];
    let factors_hi = factors.hi.as_chunks::<PANEL>().0;
    let count = factors_hi.len();
    let rows_hi = &S::as_simd_f64s(rows.hi).0.as_chunks::<V>().0[..count];
    let (rows_lo, factors_lo) = if LOW {
        (&S::as_simd_f64s(rows.lo).0.as_chunks::<V>().0[..count], &factors.lo.as_chunks::<PANEL>().0[..count])
    } else {
        (rows_hi, factors_hi)
    };
    for t in 0..count {
        let (here, low) = (&rows_hi[t], &rows_lo[t]);
        for k in 0..C {
            let f = simd.splat_f64s(factors_hi[t][first + k]);
            for v in 0..V {
                let sum = simd.mul_add_f64s(here[v], f, sums[k][v]);
                let rest = simd.mul_add_f64s(here[v], f, simd.sub_f64s(sums[k][v], sum));
                sums[k][v] = sum;
                rests[k][v] = simd.add_f64s(rests[k][v], rest);
            }
            if LOW {
                let f_low = simd.splat_f64s(factors_lo[t][first + k]);
                for v in 0..V {
                    let cross = simd.mul_add_f64s(low[v], f, rests[k][v]);
                    rests[k][v] = simd.mul_add_f64s(here[v], f_low, cross);
                }
            }
        }
    }
    let mut totals = [[Wide { hi: zero, lo: zero }; V]; C];
    for k in 0..C {
        for v in 0..V {
            let sum = simd.sub_f64s(sums[k][v], anchors[v]);
            totals[k][v] = Wide::renormalised(simd, sum, rests[k][v]);
        }
    }
    totals
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_roots_have_twice_the_digits() {
        let third = Dd { hi: 9.0, lo: 0.0 }.inverse_root();
        assert_eq!(third.hi, 1.0 / 3.0);
        // 1 - 3 hi is exact in a fused multiply-add.
        assert!((third.lo - third.hi.mul_add(-3.0, 1.0) / 3.0).abs() < 1e-32);
        let nearly = Dd { hi: 1.0, lo: 2.0_f64.powi(-60) }.inverse_root();
        assert!((nearly.hi - 1.0 + nearly.lo + 2.0_f64.powi(-61)).abs() < 1e-32);
    }
}
