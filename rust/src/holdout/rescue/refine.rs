//! Pairs close to rank loss: the closed form, refined with the residuals of the training rows.
//!
//! `M = I - Q_K^T Q_K` squares singular values, so a small pivot means lost digits: the error of the closed form is about
//! eps / lambda_min(M). The residuals of the training rows themselves do not suffer, and with the factor at hand they correct the
//! closed form; several pairs at once, so that one pass over the basis serves all. Where even that is too coarse, see
//! [`crate::holdout::rescue::refit`].

use crate::error::Error;
use crate::fit::factor::Factor;
use crate::fit::linalg::{self, dot};
use crate::holdout::kernel::Bordered;
use crate::pool::Pool;

/// Rows of the basis between two looks at whether the work has been called off.
const ROWS: usize = 512;

/// Refinement needs a lambda_min(M) at which the factor still contracts the error, and the basis has its digits.
const REFINABLE: f64 = 1e-10;

/// Steps that a pair is worth: each gains five digits or more as a rule.
const STEPS: usize = 4;

/// A factored system that applies the inverse of `M = I - Q_K^T Q_K`.
pub(crate) enum Inverse<'a> {
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
                let held: Vec<f64> = rows.iter().map(|&i| dot(factor.basis_row(i), x)).collect();
                for (z, &i) in system.solve(&held).iter().zip(*rows) {
                    x.iter_mut().zip(factor.basis_row(i)).for_each(|(x, q)| *x += z * q);
                }
            }
        }
    }
}

/// A pair close to rank loss.
pub(crate) struct Suspect<'a> {
    pub inverse: Inverse<'a>,
    /// An estimate of lambda_min(M).
    pub least: f64,
    /// Held-out rows, those that are validated first.
    pub rows: &'a [usize],
    pub validated: usize,
    pub out: &'a mut [f64],
}

/// Workspace of the refinement.
#[derive(Default)]
pub(crate) struct Batch {
    /// Pairs refined at once.
    width: usize,
    /// One vector a pair: rank x width, column-major.
    changes: Vec<f64>,
    gradients: Vec<f64>,
    part: Vec<f64>,
    rest: Vec<f64>,
}

impl Batch {
    /// Solves `M d = Q_-K^T (e_-K - Q_-K change)`, `change += d`, until what is left is rounding; writes weighted residuals
    /// of the validated rows, and tells of which pairs they are to be trusted.
    pub fn refine(
        &mut self,
        factor: &Factor,
        pool: &Pool<'_>,
        suspects: &mut [Suspect<'_>],
    ) -> Result<Vec<bool>, Error> {
        let (rank, size) = (factor.rank, factor.rank * suspects.len());
        self.width = suspects.len();
        self.gradients.resize(size, 0.0);
        self.part.resize(size, 0.0);
        self.rest.resize(ROWS * self.width, 0.0);
        let mut good = vec![true; self.width];
        for c in 0..factor.responses {
            self.changes.clear();
            self.changes.resize(size, 0.0);
            self.refine_response(factor, pool, suspects, c, &mut good)?;
            for (suspect, change) in suspects.iter_mut().zip(self.changes.chunks_exact(rank)) {
                let rows = suspect.rows[..suspect.validated].iter();
                for (e, &row) in suspect.out.iter_mut().skip(c).step_by(factor.responses).zip(rows) {
                    *e = factor.residual_row(row)[c] - dot(factor.basis_row(row), change);
                }
            }
        }
        Ok(good)
    }

    fn refine_response(
        &mut self,
        factor: &Factor,
        pool: &Pool<'_>,
        suspects: &mut [Suspect<'_>],
        c: usize,
        good: &mut [bool],
    ) -> Result<(), Error> {
        let rank = factor.rank;
        let mut before = vec![0.0; self.width];
        let mut open: Vec<usize> = (0..self.width).filter(|&s| good[s]).collect();
        // The closed form: Q^T e = 0, but for rounding, which the steps that follow take care of.
        for &s in &open {
            let change = &mut self.changes[s * rank..(s + 1) * rank];
            for &row in suspects[s].rows {
                let e = factor.residual_row(row)[c];
                change.iter_mut().zip(factor.basis_row(row)).for_each(|(x, q)| *x -= e * q);
            }
            suspects[s].inverse.apply(factor, change);
            before[s] = dot(change, change);
        }
        for _ in 0..STEPS {
            if open.is_empty() {
                return Ok(());
            }
            self.descend(factor, pool, suspects, c)?;
            open.retain(|&s| {
                let step = &mut self.gradients[s * rank..(s + 1) * rank];
                suspects[s].inverse.apply(factor, step);
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

    /// The gradients `Q_-K^T (e_-K - Q_-K change)` of all pairs, in one pass over the basis.
    fn descend(
        &mut self,
        factor: &Factor,
        pool: &Pool<'_>,
        suspects: &[Suspect<'_>],
        c: usize,
    ) -> Result<(), Error> {
        let (rank, width) = (factor.rank, self.width);
        self.gradients.fill(0.0);
        for (block, basis) in factor.basis.chunks(ROWS * rank).enumerate() {
            pool.proceed()?;
            let first = block * ROWS;
            let rest = &mut self.rest[..basis.len() / rank * width];
            linalg::rows_product(basis, &self.changes, rank, width, rest);
            for (i, rest) in rest.chunks_exact_mut(width).enumerate() {
                let e = factor.residual_row(first + i)[c];
                rest.iter_mut().for_each(|x| *x = e - *x);
            }
            let rows = first..first + basis.len() / rank;
            for (s, suspect) in suspects.iter().enumerate() {
                for row in suspect.rows.iter().filter(|row| rows.contains(row)) {
                    rest[(row - first) * width + s] = 0.0;
                }
            }
            linalg::transposed_product(basis, rest, rank, width, &mut self.part);
            self.gradients.iter_mut().zip(&self.part).for_each(|(sum, part)| *sum += part);
        }
        Ok(())
    }
}

/// Whether a pair can be refined, and what can be leaves no doubt of the training rows' rank. Their singular values are at least those of
/// the design times the square root of lambda_min(M), which is allowed a hundredth of its estimate.
pub(crate) fn refinable(factor: &Factor, least: f64) -> bool {
    let bound = factor.least * (REFINABLE / 100.0).sqrt();
    least > REFINABLE && bound > factor.tolerance * (factor.columns as f64).sqrt()
}
