//! Whether the least singular value of a triangle stands out of the rounding of the largest, at the price of a few
//! triangular solves.
//!
//! Steps of the power method from a vector of signs: on `R^T R` for the largest, on its inverse for the least. Each finds
//! its singular value from within, so that a ratio which is too small settles the matter at once. If a share of s of the
//! start's squared length is along the extreme direction, the k-th step finds the extreme singular value to a factor of
//! `s^(-1 / 4k)`; and how much it still gained tells how much is missing. That is enough to tell rank from its loss except near
//! the border.

use pulp::Arch;

use crate::fit::linalg::dot;

/// Beyond so many steps nothing is settled.
const MOST_STEPS: usize = 48;

/// From so many steps on the last one's gain tells what is missing: less than this many times as much. In a dense spectrum
/// it is as many as there were steps.
const STEADY_STEPS: usize = 10;
const MISSING: f64 = 60.0;

/// The start has at least this share of its length, squared, along an extreme direction: a hundredth of a fair one's.
const SHARE: f64 = 0.01;

/// The rounding of the ratio, with plenty to spare.
const ROUNDING: f64 = 0.01;

/// An upper triangle, column-major, without a zero on its diagonal.
pub(crate) struct Extremes<'a> {
    triangle: &'a [f64],
    stride: usize,
    /// The columns at hand one after another, in units of their largest entry: its fourth power may be beyond the range of
    /// numbers.
    scaled: Vec<f64>,
}

impl<'a> Extremes<'a> {
    /// Columns are `stride` apart.
    pub fn new(triangle: &'a [f64], stride: usize) -> Self {
        Self { triangle, stride, scaled: Vec::new() }
    }

    /// Whether of the first `count` columns the least singular value is more than a fraction of the largest, if a few steps
    /// can tell.
    pub fn stands_out(&mut self, count: usize, fraction: f64) -> Option<bool> {
        let Self { triangle, stride, scaled } = self;
        let entries = || (0..count).flat_map(|j| &triangle[j * *stride..=j * *stride + j]);
        let size = entries().fold(0.0, |size: f64, r| size.max(r.abs()));
        scaled.clear();
        scaled.extend(entries().map(|r| r / size));
        Arch::new().dispatch(|| self.steps(count, fraction))
    }

    #[inline(always)]
    fn steps(&self, count: usize, fraction: f64) -> Option<bool> {
        let (mut largest, mut inverse) = (Power::new(count), Power::new(count));
        for step in 1..=MOST_STEPS {
            largest.step(|x| self.multiply(x));
            inverse.step(|x| self.solve(x));
            let ratio = (largest.length * inverse.length).sqrt().recip() / fraction;
            // Beyond the range of numbers there is no rank either.
            if !(largest.length * inverse.length).is_finite() || ratio < 1.0 - ROUNDING {
                return Some(false);
            }
            let most = (count as f64 / SHARE).powf(0.5 / step as f64);
            let missing = 1.0 + 2.0 * ROUNDING + MISSING * (largest.gain + inverse.gain);
            if ratio > if step < STEADY_STEPS { most } else { most.min(missing) } {
                return Some(true);
            }
        }
        None
    }

    #[inline(always)]
    fn column(&self, j: usize) -> &[f64] {
        let first = j * (j + 1) / 2;
        &self.scaled[first..=first + j]
    }

    /// `x <- R^T R x`
    #[inline(always)]
    fn multiply(&self, x: &mut [f64]) {
        // From the left R x needs of x only what is still to come.
        for j in 0..x.len() {
            let (above, here) = x.split_at_mut(j);
            let factor = here[0];
            above.iter_mut().zip(self.column(j)).for_each(|(sum, r)| *sum += factor * r);
            here[0] = factor * self.column(j)[j];
        }
        (0..x.len()).rev().for_each(|j| x[j] = dot(self.column(j), &x[..=j]));
    }

    /// `x <- (R^T R)^-1 x`
    #[inline(always)]
    fn solve(&self, x: &mut [f64]) {
        for j in 0..x.len() {
            x[j] = (x[j] - dot(&self.column(j)[..j], &x[..j])) / self.column(j)[j];
        }
        for j in (0..x.len()).rev() {
            let (above, here) = x.split_at_mut(j);
            here[0] /= self.column(j)[j];
            let factor = here[0];
            above.iter_mut().zip(self.column(j)).for_each(|(rest, r)| *rest -= factor * r);
        }
    }
}

/// The power method.
struct Power {
    vector: Vec<f64>,
    /// Of the vector: how much the last step lengthened it, which never decreases.
    length: f64,
    /// By which share of itself that grew.
    gain: f64,
}

impl Power {
    fn new(count: usize) -> Self {
        // Signs that follow no pattern of a design.
        let sign = |j: u32| if j.wrapping_mul(0x9E37_79B9) & 0x1_0000 == 0 { 1.0 } else { -1.0 };
        let unit = (count as f64).sqrt().recip();
        Self { vector: (0..count as u32).map(|j| unit * sign(j)).collect(), length: 1.0, gain: f64::INFINITY }
    }

    #[inline(always)]
    fn step(&mut self, apply: impl FnOnce(&mut [f64])) {
        let scale = self.length.recip();
        self.vector.iter_mut().for_each(|x| *x *= scale);
        apply(&mut self.vector);
        let length = dot(&self.vector, &self.vector).sqrt();
        self.gain = length * scale - 1.0;
        self.length = length;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::linalg;
    use crate::testing::{noise, pool};

    /// On either side of the border, and close to it on the right side or on none.
    #[test]
    fn what_stands_out_does_in_the_decomposition() {
        for (order, decades) in [(1, 0.0), (2, 3.0), (9, 0.0), (30, 6.0), (61, 12.0), (120, 14.0)] {
            let random = noise(order * order, 7);
            let mut triangle = vec![f64::NAN; order * order];
            for j in 0..order {
                let size = 10.0_f64.powf(-decades * j as f64 / order as f64);
                (0..j).for_each(|i| triangle[j * order + i] = size * random[j * order + i] / 2.0);
                triangle[j * order + j] = size * (0.6 + random[j * order + j] / 2.0);
            }
            let mut extremes = Extremes::new(&triangle, order);
            for count in [1, order.div_ceil(2), order] {
                let mut r = vec![0.0; count * count];
                for (j, target) in r.chunks_exact_mut(count).enumerate() {
                    target[..=j].copy_from_slice(&triangle[j * order..=j * order + j]);
                }
                let values = linalg::thin_svd(r, count, count, &pool(1)).unwrap().s;
                let ratio = values[count - 1] / values[0];
                let mut found = |times: f64| extremes.stands_out(count, ratio / times);
                for times in [1.25, 3.0, 1e3] {
                    assert_eq!(found(times), Some(true), "{count} of {order}, {decades} decades, {times}");
                    assert_eq!(
                        found(1.0 / times),
                        Some(false),
                        "{count} of {order}, {decades} decades, {times}"
                    );
                }
                assert_ne!(found(1.01), Some(false));
                assert_ne!(found(0.99), Some(true));
                assert_eq!(found(1.0), None);
            }
        }
    }

    #[test]
    fn overflow_is_no_rank() {
        let mut extremes = Extremes::new(&[1.0, 0.0, 1.0, 1e-300], 2);
        assert_eq!(extremes.stands_out(2, 1e-200), Some(false));
        assert_eq!(extremes.stands_out(1, 0.5), Some(true));
    }

    #[test]
    fn units_do_not_matter() {
        for unit in [1e-310, 1e-200, 1.0, 1e200] {
            let triangle = [unit, 0.0, 0.0, 0.0, unit / 4.0, 0.0, 0.0, 0.0, 1.0];
            let mut extremes = Extremes::new(&triangle, 3);
            assert_eq!(
                [0.2, 0.3].map(|fraction| extremes.stands_out(2, fraction)),
                [Some(true), Some(false)]
            );
        }
    }
}
