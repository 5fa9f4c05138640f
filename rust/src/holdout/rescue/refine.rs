//! Pairs close to rank loss: the closed form, refined with the residuals of the training rows.
//!
//! `M = I - Q_K^T Q_K` squares singular values, so a small pivot means lost digits: the error of the closed form is about
//! eps / lambda_min(M). The residuals of the training rows do not lose them, and with the factor of M they correct the
//! closed form. The correction depends on the held-out set alone, so pairs that hold out the same share it; and several sets are
//! corrected at once, so that one pass over the basis serves all of them. Where that is
//! not enough, see [`crate::holdout::rescue::refit`].

use pulp::{Arch, Simd, WithSimd};

use super::Left;
use crate::error::Error;
use crate::fit::factor::Factor;
use crate::fit::linalg::{self, dot};
use crate::holdout::kernel::Bordered;
use crate::pool::Pool;

/// Rows of the basis that are multiplied at a time; between them the work can be called off.
const PASS_ROWS: usize = 512;

/// Below this lambda_min(M) a step no longer contracts the error enough, and the basis has too few digits.
const REFINED_MIN_EIGENVALUE: f64 = 1e-8;

/// The most steps for a pair: each gains five digits or more as a rule.
const MOST_STEPS: usize = 4;

/// A factored system that applies the inverse of `M = I - Q_K^T Q_K`.
pub(super) enum Inverse<'a> {
    /// The factor of M.
    Primal(&'a mut Bordered),
    /// That of `S = I - Q_K Q_K^T`, and the rows K: `M^-1 = I + Q_K^T S^-1 Q_K`.
    Dual(&'a mut Bordered, &'a [usize]),
}

impl Inverse<'_> {
    /// `x <- M^-1 x`.
    fn apply(&mut self, factor: &Factor, x: &mut [f64]) {
        match self {
            Self::Primal(system) => x.copy_from_slice(system.solve(x)),
            Self::Dual(system, rows) => {
                let mut held = vec![0.0; rows.len()];
                let arch = Arch::new();
                arch.dispatch(HeldOut { factor, rows, x, out: &mut held });
                arch.dispatch(Spread { factor, rows, z: system.solve(&held), x });
            }
        }
    }
}

/// `out <- Q_K x`.
struct HeldOut<'a> {
    factor: &'a Factor,
    rows: &'a [usize],
    x: &'a [f64],
    out: &'a mut [f64],
}

impl WithSimd for HeldOut<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { factor, rows, x, out } = self;
        for (out, &i) in out.iter_mut().zip(rows) {
            *out = dot(factor.basis_row(i), x);
        }
    }
}

/// `x <- x + Q_K^T z`.
struct Spread<'a> {
    factor: &'a Factor,
    rows: &'a [usize],
    z: &'a [f64],
    x: &'a mut [f64],
}

impl WithSimd for Spread<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { factor, rows, z, x } = self;
        for (z, &i) in z.iter().zip(rows) {
            x.iter_mut().zip(factor.basis_row(i)).for_each(|(x, q)| *x += z * q);
        }
    }
}

/// A held-out set close to rank loss, and the pairs that hold it out.
pub(super) struct NearSingular<'a, 'b> {
    pub(super) inverse: Inverse<'a>,
    /// An estimate of lambda_min(M).
    pub(super) least: f64,
    /// Held-out rows.
    pub(super) rows: &'a [usize],
    pub(super) pairs: &'a mut [Left<'b>],
}

/// Workspace of the refinement.
#[derive(Default)]
pub(super) struct Refiner {
    /// Sets refined at once.
    width: usize,
    /// One vector a set: rank x width, column-major.
    changes: Vec<f64>,
    gradients: Vec<f64>,
    part: Vec<f64>,
    rest: Vec<f64>,
}

impl Refiner {
    /// Solves `M d = Q_-K^T (e_-K - Q_-K change)`, `change += d`, until only rounding is left. Writes weighted residuals
    /// of the validated rows, and tells for which sets they are accurate.
    pub(super) fn refine(
        &mut self,
        factor: &Factor,
        pool: &Pool<'_>,
        sets: &mut [NearSingular<'_, '_>],
    ) -> Result<Vec<bool>, Error> {
        let (rank, size) = (factor.rank, factor.rank * sets.len());
        self.width = sets.len();
        self.gradients.resize(size, 0.0);
        self.part.resize(size, 0.0);
        self.rest.resize(PASS_ROWS * self.width, 0.0);
        let mut good = vec![true; self.width];
        for c in 0..factor.responses {
            self.changes.clear();
            self.changes.resize(size, 0.0);
            self.refine_response(factor, pool, sets, c, &mut good)?;
            for (set, change) in sets.iter_mut().zip(self.changes.chunks_exact(rank)) {
                for pair in &mut *set.pairs {
                    let out = pair.residuals.iter_mut().skip(c).step_by(factor.responses);
                    for (e, &row) in out.zip(&pair.rows) {
                        *e = factor.residual_row(row)[c] - dot(factor.basis_row(row), change);
                    }
                }
            }
        }
        Ok(good)
    }

    fn refine_response(
        &mut self,
        factor: &Factor,
        pool: &Pool<'_>,
        sets: &mut [NearSingular<'_, '_>],
        c: usize,
        good: &mut [bool],
    ) -> Result<(), Error> {
        let rank = factor.rank;
        let mut before = vec![0.0; self.width];
        let mut open: Vec<usize> = (0..self.width).filter(|&s| good[s]).collect();
        // The closed form: Q^T e = 0, but for rounding, which the steps that follow take care of.
        for &s in &open {
            let change = &mut self.changes[s * rank..(s + 1) * rank];
            let e: Vec<f64> = sets[s].rows.iter().map(|&row| -factor.residual_row(row)[c]).collect();
            Arch::new().dispatch(Spread { factor, rows: sets[s].rows, z: &e, x: change });
            sets[s].inverse.apply(factor, change);
            before[s] = dot(change, change);
        }
        for _ in 0..MOST_STEPS {
            if open.is_empty() {
                return Ok(());
            }
            self.descend(factor, pool, sets, c)?;
            open.retain(|&s| {
                let step = &mut self.gradients[s * rank..(s + 1) * rank];
                sets[s].inverse.apply(factor, step);
                let change = &mut self.changes[s * rank..(s + 1) * rank];
                change.iter_mut().zip(&*step).for_each(|(x, d)| *x += d);
                let (length, whole) = (dot(step, step), dot(change, change));
                // Squares. The next step would gain as many digits as this one did.
                let done = length * length <= 1e-24 * whole * before[s];
                before[s] = length;
                !done
            });
        }
        open.iter().for_each(|&s| good[s] = false);
        Ok(())
    }

    /// The gradients `Q_-K^T (e_-K - Q_-K change)` of all sets, in one pass over the basis.
    fn descend(
        &mut self,
        factor: &Factor,
        pool: &Pool<'_>,
        sets: &[NearSingular<'_, '_>],
        c: usize,
    ) -> Result<(), Error> {
        let (rank, width) = (factor.rank, self.width);
        self.gradients.fill(0.0);
        for (block, basis) in factor.basis.chunks(PASS_ROWS * rank).enumerate() {
            pool.proceed()?;
            let first = block * PASS_ROWS;
            let rest = &mut self.rest[..basis.len() / rank * width];
            linalg::rows_product(basis, &self.changes, rank, width, rest);
            for (i, rest) in rest.chunks_exact_mut(width).enumerate() {
                let e = factor.residual_row(first + i)[c];
                rest.iter_mut().for_each(|x| *x = e - *x);
            }
            let rows = first..first + basis.len() / rank;
            for (s, set) in sets.iter().enumerate() {
                for row in set.rows.iter().filter(|row| rows.contains(row)) {
                    rest[(row - first) * width + s] = 0.0;
                }
            }
            linalg::transposed_product(basis, rest, rank, width, &mut self.part);
            self.gradients.iter_mut().zip(&self.part).for_each(|(sum, part)| *sum += part);
        }
        Ok(())
    }
}

/// Whether a set can be refined and its training rows are of full rank beyond doubt. Their singular values are at
/// least those of the design times the square root of lambda_min(M); its estimate may be a hundred times too large.
pub(super) fn refinable(factor: &Factor, least: f64) -> bool {
    let bound = factor.least * (REFINED_MIN_EIGENVALUE / 100.0).sqrt();
    least > REFINED_MIN_EIGENVALUE && bound > factor.tolerance * (factor.columns as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::holdout::residuals::Status;
    use crate::holdout::scheme::{Held, Scheme};
    use crate::holdout::walk::{Ground, Workspace};
    use crate::testing::{Example, assert_close, pool, sets, singletons};

    /// The primal's inverse of M, and the dual's.
    #[test]
    fn two_systems_apply_one_inverse() {
        let factor = Example::new(30, 6, 1).factor();
        let rows = [3, 11, 27, 8];
        let (mut primal, mut dual) = (Workspace::new(0), Workspace::new(0));
        primal.rows = rows.to_vec();
        primal.fresh_gram(&factor);
        assert!(primal.factor_primal(&factor, 0, 0) > 0.0);
        dual.rows = rows.to_vec();
        dual.fill_dual(&factor, None, 4, 0);
        assert!(dual.system.factor() > 0.0);
        let x: Vec<f64> = (0..6).map(|j| f64::from(j * j) - 7.0).collect();
        let [mut one, mut other] = [x.clone(), x.clone()];
        Inverse::Primal(&mut primal.system).apply(&factor, &mut one);
        Inverse::Dual(&mut dual.system, &rows).apply(&factor, &mut other);
        assert_close(&one, &other, 1e-14);
        // M times it is what it was.
        let held: Vec<f64> = rows.iter().map(|&i| dot(factor.basis_row(i), &one)).collect();
        let product =
            |j: usize| one[j] - rows.iter().zip(&held).map(|(&i, z)| factor.basis_row(i)[j] * z).sum::<f64>();
        assert_close(&(0..6).map(product).collect::<Vec<_>>(), &x, 1e-14);
    }

    /// Of more rows than a pass takes; sets far from rank loss and near it, and one beyond what steps can mend.
    #[test]
    fn several_sets_are_corrected_in_one_pass() {
        let mut example = Example::nearly_lost(1200, 4, 1e-5);
        example.root_weights.fill(1.0);
        let (factor, rows) = (example.factor(), singletons(1200));
        let held = sets([&[1198, 1199, 600], &[5, 6], &[0, 1199, 7, 1198, 500]]);
        let schemes = [Scheme { held: Held::Sets(&held), validated: &held, order: None }];
        let ground = Ground { factor: &factor, schemes: &schemes, rows: &rows, hat: None };
        let mut works: Vec<Workspace> = (0..3).map(|_| Workspace::new(1200)).collect();
        let mut residuals: Vec<Vec<f64>> = (0..3).map(|pair| vec![0.0; 2 * held.get(pair).len()]).collect();
        let mut status: [Option<Status>; 3] = [None; 3];
        let mut left: Vec<[Left<'_>; 1]> = residuals
            .iter_mut()
            .zip(&mut status)
            .enumerate()
            .map(|(pair, (residuals, status))| {
                [Left { scheme: 0, pair, rows: held.get(pair).to_vec(), residuals, status }]
            })
            .collect();
        let mut near: Vec<NearSingular<'_, '_>> = works
            .iter_mut()
            .zip(&mut left)
            .enumerate()
            .map(|(pair, (work, left))| {
                work.list_pair(&ground, 0, pair);
                work.near_singular(&ground, left)
            })
            .collect();
        assert!(refinable(&factor, near[0].least) && near[0].least < 2e-7);
        let good = Refiner::default().refine(&factor, &pool(1), &mut near).unwrap();
        assert_eq!(good, [true; 3]);
        for (pair, found) in residuals.iter().enumerate() {
            let tolerance = if pair == 1 { 1e-14 } else { 1e-10 };
            assert_close(found, &example.refit(held.get(pair), held.get(pair)), tolerance);
        }
    }

    #[test]
    fn of_too_near_a_set_the_basis_has_too_few_digits() {
        let mut factor = Example::new(30, 4, 1).factor();
        assert!(refinable(&factor, 2.0 * REFINED_MIN_EIGENVALUE));
        assert!(!refinable(&factor, 0.5 * REFINED_MIN_EIGENVALUE));
        // The training rows of an ill-conditioned design may have lost rank.
        factor.least = 1e-10;
        assert!(!refinable(&factor, 1e-3));
    }
}
