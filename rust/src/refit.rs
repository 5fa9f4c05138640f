//! The few pairs whose training rows barely determine the model, or do not.
//!
//! `M = I - Q_K^T Q_K` squares singular values, so a small pivot means lost digits: the error of the closed form is
//! about eps / lambda_min(M). Two remedies, the cheaper first. *Refinement* takes the residuals of the training rows
//! themselves, which do not suffer, and corrects with the factor at hand; several pairs at once, so that one pass over the
//! basis serves all. Where even that is too coarse, a *refit* reduces
//! the training rows by Householder reflections, which sees rank down to rounding; for nested models (`lead`, `forward`) the
//! triangle that is left answers for all leading columns.

use crate::cholesky::Bordered;
use crate::error::Error;
use crate::factor::{Factor, Problem, leading_rank, numerical_rank};
use crate::holdout::Status;
use crate::linalg::{self, QrScratch, dot};
use crate::pool::Pool;

/// Training rows reduced at a time.
const ROWS: usize = 512;

/// Refinement needs a lambda_min(M) at which the factor still contracts the error, and the basis has its digits.
const REFINABLE: f64 = 1e-10;

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

/// Workspace; allocated at the first pair that needs it.
#[derive(Default)]
pub struct Refit {
    held: Vec<bool>,
    change: Vec<f64>,
    row: Vec<f64>,
    batch: Batch,
    /// A block of training rows under the triangle of those before, column-major.
    block: Vec<f64>,
    /// Rows of the block.
    height: usize,
    reflectors: Vec<f64>,
    scratch: Option<QrScratch>,
}

impl Refit {
    /// Predicts the validated rows of every pair, and writes their weighted residuals.
    pub(crate) fn predict(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        suspects: &mut [Suspect<'_>],
    ) -> Result<Vec<Status>, Error> {
        self.row.resize(factor.rank + factor.responses, 0.0);
        let refined = self.batch.refine(factor, suspects);
        let mut status = Vec::with_capacity(suspects.len());
        for (s, (suspect, refined)) in suspects.iter_mut().zip(refined).enumerate() {
            let Suspect { rows, validated, out, .. } = suspect;
            let kept = &rows[..*validated];
            self.change.clear();
            if refined {
                let changes = self.batch.changes.chunks_exact(factor.rank * self.batch.width);
                changes.for_each(|all| self.change.extend(&all[s * factor.rank..(s + 1) * factor.rank]));
                self.write(out, factor, kept, |row, out| {
                    out[..factor.rank].copy_from_slice(factor.basis_row(row));
                    out[factor.rank..].copy_from_slice(factor.residual_row(row));
                    Ok(())
                })?;
                status.push(Status::Refined);
                continue;
            }
            self.change.resize(factor.rank * factor.responses, 0.0);
            self.held.resize(factor.total_rows, false);
            rows.iter().for_each(|&i| self.held[i] = true);
            let reduced = self.reduce(factor, problem, pool, rows.len());
            rows.iter().for_each(|&i| self.held[i] = false);
            status.push(if reduced? {
                self.write(out, factor, kept, |row, out| factor.full_rank_row(problem, row, out))?;
                Status::Refitted
            } else {
                Status::Undefined
            });
        }
        Ok(status)
    }

    /// Residuals of rows, given in the coordinates of `change` with their right-hand sides behind.
    fn write(
        &mut self,
        out: &mut [f64],
        factor: &Factor,
        rows: &[usize],
        fetch: impl Fn(usize, &mut [f64]) -> Result<(), Error>,
    ) -> Result<(), Error> {
        for (e, &row) in out.chunks_exact_mut(factor.responses).zip(rows) {
            fetch(row, &mut self.row)?;
            let (left, right) = self.row.split_at(factor.rank);
            for ((e, b), change) in e.iter_mut().zip(right).zip(self.change.chunks_exact(factor.rank)) {
                *e = b - dot(left, change);
            }
        }
        Ok(())
    }

    /// Solves the training rows by QR; false if they have lost rank.
    fn reduce(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        held: usize,
    ) -> Result<bool, Error> {
        let (rank, responses) = (factor.rank, factor.responses);
        let width = rank + responses;
        let height = (self.held.len() - held).clamp(width, width + ROWS);
        self.triangle(factor, problem, pool, height, width)?;
        if self.rank(factor, height, pool)? < rank {
            return Ok(false);
        }
        for (c, change) in self.change.chunks_exact_mut(rank).enumerate() {
            let column = (rank + c) * height;
            change.copy_from_slice(&self.block[column..column + rank]);
        }
        linalg::solve_upper(&self.block, height, rank, &mut self.change, responses);
        Ok(true)
    }

    /// Reduces the training rows of a design of full rank, and tells how many of its leading columns they determine.
    pub(crate) fn lead(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        rows: &[usize],
    ) -> Result<usize, Error> {
        self.held.resize(factor.total_rows, false);
        rows.iter().for_each(|&i| self.held[i] = true);
        let (rank, responses) = (factor.rank, factor.responses);
        let width = rank + responses;
        self.row.resize(width, 0.0);
        self.height = (self.held.len() - rows.len()).clamp(width, width + ROWS);
        let reduced = self.triangle(factor, problem, pool, self.height, width);
        rows.iter().for_each(|&i| self.held[i] = false);
        reduced?;
        let triangle: Vec<f64> = (0..rank).flat_map(|j| self.column(j, rank)).copied().collect();
        leading_rank(&triangle, rank, factor.tolerance, pool)
    }

    fn column(&self, j: usize, kept: usize) -> &[f64] {
        &self.block[j * self.height..j * self.height + kept]
    }

    /// After `lead`: a response of row `i`, and the forward solves of the row and of this response's projection.
    pub(crate) fn forward(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        i: usize,
        response: usize,
        leading: usize,
    ) -> Result<(f64, &[f64], &[f64]), Error> {
        let rank = factor.rank;
        factor.full_rank_row(problem, i, &mut self.row)?;
        for j in 0..leading {
            let at = j * self.height;
            let (known, rest) = self.row.split_at_mut(j);
            rest[0] = (rest[0] - dot(&self.block[at..at + j], known)) / self.block[at + j];
        }
        let projection = self.column(rank + response, leading);
        Ok((self.row[rank + response], &self.row[..leading], projection))
    }

    /// Leaves the triangle of the training rows and their right-hand sides at the top of `block`.
    fn triangle(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        height: usize,
        width: usize,
    ) -> Result<(), Error> {
        let Self { held, row: entries, block, reflectors, scratch, .. } = self;
        // Sized for the largest block, whatever this pair's.
        let scratch = scratch.get_or_insert_with(|| QrScratch::new(width + ROWS, width));
        block.clear();
        block.resize(height * width, 0.0);
        reflectors.resize(linalg::reflector_size(height, width), 0.0);
        let mut training = (0..held.len()).filter(|&i| !held[i]).peekable();
        let mut kept = 0;
        while training.peek().is_some() {
            for j in 0..width {
                block[j * height + kept.min(j + 1)..(j + 1) * height].fill(0.0);
            }
            for (k, row) in training.by_ref().take(height - kept).enumerate() {
                factor.full_rank_row(problem, row, entries)?;
                for (j, &x) in entries.iter().enumerate() {
                    block[j * height + kept + k] = x;
                }
            }
            linalg::qr_in_place(block, height, width, reflectors, scratch, pool)?;
            kept = width;
        }
        Ok(())
    }

    /// Rank of the training rows, the design's columns at unit length.
    fn rank(&self, factor: &Factor, height: usize, pool: &Pool<'_>) -> Result<usize, Error> {
        let rank = factor.rank;
        let mut r = vec![0.0; rank * rank];
        for (j, column) in r.chunks_exact_mut(rank).enumerate() {
            column[..=j].copy_from_slice(&self.block[j * height..j * height + j + 1]);
        }
        let full = rank == factor.columns;
        let bound = if full { 1.0 } else { factor.least } / linalg::inverse_norm(&r, rank);
        if bound > 2.0 * factor.tolerance * (factor.columns as f64).sqrt() {
            return Ok(rank);
        }
        let design = if full { r } else { linalg::product(&r, &factor.triangle, rank, rank, factor.columns) };
        let values = linalg::thin_svd(design, rank, factor.columns, pool)?.s;
        Ok(numerical_rank(&values, factor.tolerance))
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
struct Batch {
    /// Pairs refined at once.
    width: usize,
    /// One vector a pair, for each response: rank x width, column-major.
    changes: Vec<f64>,
    gradients: Vec<f64>,
    part: Vec<f64>,
    rest: Vec<f64>,
}

impl Batch {
    /// `M d = Q_-K^T (e_-K - Q_-K change)`, `change += d`, until what is left is rounding; tells of which pairs it is.
    fn refine(&mut self, factor: &Factor, suspects: &mut [Suspect<'_>]) -> Vec<bool> {
        let size = factor.rank * suspects.len();
        self.width = suspects.len();
        self.changes.clear();
        self.changes.resize(size * factor.responses, 0.0);
        self.gradients.resize(size, 0.0);
        self.part.resize(size, 0.0);
        self.rest.resize(ROWS * self.width, 0.0);
        let mut good: Vec<bool> = suspects.iter().map(|s| s.least > REFINABLE && certain(factor)).collect();
        for c in 0..factor.responses {
            self.refine_response(factor, suspects, c, &mut good);
        }
        good
    }

    fn refine_response(
        &mut self,
        factor: &Factor,
        suspects: &mut [Suspect<'_>],
        c: usize,
        good: &mut [bool],
    ) {
        let (rank, size) = (factor.rank, factor.rank * self.width);
        let mut before = vec![0.0; self.width];
        let mut open: Vec<usize> = (0..self.width).filter(|&s| good[s]).collect();
        // The closed form: Q^T e = 0, but for rounding, which the steps that follow take care of.
        for &s in &open {
            let change = &mut self.changes[c * size + s * rank..c * size + (s + 1) * rank];
            for &row in suspects[s].rows {
                let e = factor.residual_row(row)[c];
                change.iter_mut().zip(factor.basis_row(row)).for_each(|(x, q)| *x -= e * q);
            }
            suspects[s].inverse.apply(factor, change);
            before[s] = dot(change, change);
        }
        for _ in 0..8 {
            if open.is_empty() {
                return;
            }
            self.descend(factor, suspects, c);
            open.retain(|&s| {
                let step = &mut self.gradients[s * rank..(s + 1) * rank];
                suspects[s].inverse.apply(factor, step);
                let change = &mut self.changes[c * size + s * rank..c * size + (s + 1) * rank];
                change.iter_mut().zip(&*step).for_each(|(x, d)| *x += d);
                let (length, whole) = (dot(step, step), dot(change, change));
                // Squares: the next step would gain as many digits as this one did.
                let done = length * length <= 1e-24 * whole * before[s];
                // Each step must gain a digit.
                good[s] = done || length <= 1e-2 * before[s];
                before[s] = length;
                good[s] && !done
            });
        }
        open.iter().for_each(|&s| good[s] = false);
    }

    /// The gradients `Q_-K^T (e_-K - Q_-K change)` of all pairs, in one pass over the basis.
    fn descend(&mut self, factor: &Factor, suspects: &[Suspect<'_>], c: usize) {
        let (rank, width) = (factor.rank, self.width);
        let changes = &self.changes[c * rank * width..(c + 1) * rank * width];
        self.gradients.fill(0.0);
        for (block, basis) in factor.basis.chunks(ROWS * rank).enumerate() {
            let first = block * ROWS;
            let rest = &mut self.rest[..basis.len() / rank * width];
            linalg::rows_product(basis, changes, rank, width, rest);
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
    }
}

/// Whether what can be refined leaves no doubt of the training rows' rank. Their singular values are at least those of
/// the design times the square root of lambda_min(M), which is allowed a hundredth of its estimate.
fn certain(factor: &Factor) -> bool {
    let bound = factor.least * (REFINABLE / 100.0).sqrt();
    bound > factor.tolerance * (factor.columns as f64).sqrt()
}
