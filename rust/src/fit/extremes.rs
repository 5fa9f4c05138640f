//! About how far apart the extreme singular values of a triangle are, at the price of a few triangular solves.
//!
//! Steps of the power method from a vector of signs: on `R^T R` for the largest, on its inverse for the least. Of n
//! singular values the k-th step finds the extreme one, from within, to a factor of about `n^(1 / 4k)`: enough to tell
//! rank from its loss except near the border.

use crate::fit::linalg::dot;

/// Numbers of steps, and how many times too large they may leave the ratio, with margin for an unlucky start.
pub(crate) const EFFORTS: [(usize, f64); 2] = [(8, 2.0), (48, 1.15)];

/// The least singular value of a triangle's first `count` columns over the largest, or more if the steps are few. The
/// triangle is upper, column-major with columns `stride` apart, and has no zero on its diagonal.
pub(crate) fn conditioning(triangle: &[f64], stride: usize, count: usize, steps: usize) -> f64 {
    let entries = |j: usize| triangle[j * stride..=j * stride + j].iter();
    let size = (0..count).flat_map(entries).fold(0.0, |size: f64, r| size.max(r.abs()));
    // In units of the largest entry, whose square may be beyond the range of numbers.
    let mut scaled = vec![0.0; count * count];
    for (j, column) in scaled.chunks_exact_mut(count).enumerate() {
        column.iter_mut().zip(entries(j)).for_each(|(to, r)| *to = r / size);
    }
    let column = |j: usize| &scaled[j * count..=j * count + j];
    let largest = grown(count, steps, |x| {
        // From the left R x needs of x only what is still to come.
        for j in 0..count {
            let (above, here) = x.split_at_mut(j);
            let factor = here[0];
            above.iter_mut().zip(column(j)).for_each(|(sum, r)| *sum += factor * r);
            here[0] = factor * column(j)[j];
        }
        (0..count).rev().for_each(|j| x[j] = dot(column(j), &x[..=j]));
    });
    let inverse = grown(count, steps, |x| {
        for j in 0..count {
            x[j] = (x[j] - dot(&column(j)[..j], &x[..j])) / column(j)[j];
        }
        for j in (0..count).rev() {
            let (above, here) = x.split_at_mut(j);
            here[0] /= column(j)[j];
            let factor = here[0];
            above.iter_mut().zip(column(j)).for_each(|(rest, r)| *rest -= factor * r);
        }
    });
    (largest * inverse).sqrt().recip()
}

/// How much the last step of the power method lengthens a vector; infinite if that overflows.
fn grown(count: usize, steps: usize, apply: impl Fn(&mut [f64])) -> f64 {
    // Signs that follow no pattern of a design.
    let mut x: Vec<f64> = (0..count as u32)
        .map(|j| if j.wrapping_mul(0x9E37_79B9) & 0x1_0000 == 0 { 1.0 } else { -1.0 })
        .collect();
    let mut length = (count as f64).sqrt();
    for _ in 0..steps {
        x.iter_mut().for_each(|x| *x /= length);
        apply(&mut x);
        length = dot(&x, &x).sqrt();
        if !length.is_finite() {
            return f64::INFINITY;
        }
    }
    length
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::linalg;
    use crate::pool::Pool;

    #[test]
    fn the_ratio_is_that_of_the_decomposition() {
        let flag = AtomicBool::new(false);
        let pool = Pool::new(1, &flag);
        let mut state = 1_u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        for (stride, decades) in [(1, 0.0), (2, 3.0), (9, 0.0), (30, 6.0), (61, 12.0), (120, 14.0)] {
            let mut triangle = vec![f64::NAN; stride * stride];
            for j in 0..stride {
                let size = 10.0_f64.powf(-decades * j as f64 / stride as f64);
                (0..j).for_each(|i| triangle[j * stride + i] = size * noise());
                triangle[j * stride + j] = size * (0.6 + noise());
            }
            for count in [1, stride.div_ceil(2), stride] {
                let mut r = vec![0.0; count * count];
                for (j, target) in r.chunks_exact_mut(count).enumerate() {
                    target[..=j].copy_from_slice(&triangle[j * stride..=j * stride + j]);
                }
                let values = linalg::thin_svd(r, count, count, &pool).unwrap().s;
                for (steps, margin) in EFFORTS {
                    let found = conditioning(&triangle, stride, count, steps) * values[0] / values[count - 1];
                    assert!((0.98..margin).contains(&found), "{found} of {count} with {decades} decades");
                }
            }
        }
    }

    #[test]
    fn overflow_is_no_rank() {
        assert_eq!(conditioning(&[1.0, 0.0, 1.0, 1e-300], 2, 2, 8), 0.0);
    }

    #[test]
    fn units_do_not_matter() {
        for unit in [1e-310, 1e-200, 1.0, 1e200] {
            let found = conditioning(&[unit, 0.0, 0.0, unit / 4.0], 2, 2, 48);
            assert!((found - 0.25).abs() < 1e-12);
        }
    }
}
