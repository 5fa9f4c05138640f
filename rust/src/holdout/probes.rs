//! An estimate of a factored system's smallest eigenvalue: random right-hand sides that ride along tell what pivots hide.

use crate::holdout::kernel::Bordered;

/// Random right-hand sides that tell lambda_min; they fit in the padding of the last panel as a rule.
pub(crate) const PROBES: usize = 2;

/// Random signs in the border below the responses, see [`least_eigenvalue`].
pub(crate) fn set_probes(system: &mut Bordered, order: usize, responses: usize) {
    for probe in 0..PROBES {
        for j in 0..order {
            *system.entry(order + responses + probe, j) = sign(probe, j);
        }
    }
}

/// Factors, and estimates the smallest eigenvalue, at least by the order'th part of it. Pivots alone can hide it (Kahan's triangles), so random
/// signs d ride along below the responses: `d^T M^-1 d` is about 1 / lambda_min once that is small.
pub(crate) fn least_eigenvalue(system: &mut Bordered, order: usize, responses: usize) -> f64 {
    let smallest = system.factor();
    if smallest <= 0.0 {
        return 0.0;
    }
    (responses..responses + PROBES)
        .map(|probe| by_probe(system.forward_products(probe, probe).sum(), order))
        .fold(smallest, f64::min)
}

/// What a probe's `d^T M^-1 d` says of lambda_min, if anything.
pub(crate) fn by_probe(square: f64, order: usize) -> f64 {
    let grown = square - 10.0 * order as f64;
    if grown > 0.0 { grown.recip() } else { f64::INFINITY }
}

/// The j-th of a fixed sequence of signs that no structure of a design knows of.
pub(crate) fn sign(probe: usize, j: usize) -> f64 {
    let mixed = ((j * PROBES + probe + 1) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    if (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 63 == 0 { 1.0 } else { -1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::holdout::gram::Gram;

    /// The identity less one row, which leaves one eigenvalue of `1 - |row|^2`.
    fn estimate(row: &[f64]) -> f64 {
        let mut gram = Gram::default();
        gram.start(row.len(), 1);
        gram.change(&[0], -1.0, |_| (row, &[0.5]));
        let mut system = Bordered::default();
        system.start_from(&gram, PROBES);
        set_probes(&mut system, row.len(), 1);
        least_eigenvalue(&mut system, row.len(), 1)
    }

    #[test]
    fn an_estimate_has_the_size_of_the_least_eigenvalue() {
        for order in [1, 3, 8, 21, 60] {
            for least in [0.5, 1e-3, 1e-6, 1e-9] {
                let entry = ((1.0 - least) / order as f64).sqrt();
                let row: Vec<f64> = (0..order).map(|j| if j % 3 == 1 { -entry } else { entry }).collect();
                let found = estimate(&row);
                assert!(found >= least / order as f64 * (1.0 - 1e-6), "{order} {least} {found}");
                assert!(least > 1e-2 || found < 20.0 * least, "{order} {least} {found}");
            }
        }
        assert_eq!(estimate(&[0.0, 1.0, 0.0]), 0.0);
    }

    /// Kahan's triangle: no pivot is below 1e-2, and yet the least eigenvalue is below 1e-10.
    #[test]
    fn probes_see_what_pivots_hide() {
        let (order, c) = (60_usize, 0.4_f64);
        let s = (1.0 - c * c).sqrt();
        // Rows of a triangle with unit columns; the matrix is its Gram matrix.
        let row = |k: usize| {
            let entry = |j: usize| {
                if j < k {
                    0.0
                } else if j == k {
                    1.0
                } else {
                    -c
                }
            };
            (0..order).map(|j| s.powi(k as i32) * entry(j)).collect::<Vec<f64>>()
        };
        let rows: Vec<Vec<f64>> = (0..order).map(row).collect();
        let mut gram = Gram::default();
        gram.start(order, 0);
        gram.change(&(0..order).collect::<Vec<_>>(), 1.0, |k| (&rows[k], &[]));
        let unit = |j: usize| (0..order).map(|k| f64::from(u8::from(k == j))).collect::<Vec<f64>>();
        let units: Vec<Vec<f64>> = (0..order).map(unit).collect();
        gram.change(&(0..order).collect::<Vec<_>>(), -1.0, |k| (&units[k], &[]));
        let mut system = Bordered::default();
        system.start_from(&gram, PROBES);
        set_probes(&mut system, order, 0);
        let found = least_eigenvalue(&mut system, order, 0);
        let pivot = system.pivots().fold(f64::INFINITY, f64::min);
        assert!(found < 1e-6 * pivot, "{found} {pivot}");
    }

    #[test]
    fn signs_are_as_often_the_one_as_the_other() {
        let mut system = Bordered::default();
        system.start(1000, 1 + PROBES, 0);
        set_probes(&mut system, 1000, 1);
        for probe in 0..PROBES {
            assert!((0..1000).all(|j| *system.entry(1001 + probe, j) == sign(probe, j)));
            let sum: f64 = (0..1000).map(|j| sign(probe, j)).sum();
            assert!(sum.abs() < 100.0);
        }
        assert!((0..1000).any(|j| sign(0, j) != sign(1, j)));
    }
}
