//! Pairs whose training rows may have lost rank: an exact refit.
//!
//! Householder reflections reduce the training rows to a triangle, which shows rank down to rounding. For nested models
//! (`reduce_leading`, `forward_solve`) the triangle serves all leading columns.

use crate::error::Error;
use crate::fit::factor::{Factor, Problem, leading_rank, numerical_rank};
use crate::fit::linalg::{self, QrScratch, dot};
use crate::holdout::pairs::Status;
use crate::pool::Pool;

/// Training rows reduced at a time.
const REDUCED_ROWS: usize = 512;

/// Workspace; allocated at the first pair that needs it.
#[derive(Default)]
pub struct Refit {
    held: Vec<bool>,
    change: Vec<f64>,
    row: Vec<f64>,
    /// A block of training rows under the triangle of those before, column-major.
    block: Vec<f64>,
    /// Rows of the block.
    height: usize,
    reflectors: Vec<f64>,
    scratch: Option<QrScratch>,
}

impl Refit {
    /// Predicts without `rows`, and writes the weighted residuals of the first `validated` of them.
    pub(crate) fn predict(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        (rows, validated): (&[usize], usize),
        out: &mut [f64],
    ) -> Result<Status, Error> {
        self.held.resize(factor.total_rows, false);
        self.change.resize(factor.rank * factor.responses, 0.0);
        self.row.resize(factor.rank + factor.responses, 0.0);
        rows.iter().for_each(|&i| self.held[i] = true);
        let reduced = self.reduce(factor, problem, pool, rows.len());
        rows.iter().for_each(|&i| self.held[i] = false);
        if !reduced? {
            return Ok(Status::Undefined);
        }
        for (e, &row) in out.chunks_exact_mut(factor.responses).zip(&rows[..validated]) {
            factor.full_rank_row(problem, row, &mut self.row)?;
            let (left, right) = self.row.split_at(factor.rank);
            for ((e, b), change) in e.iter_mut().zip(right).zip(self.change.chunks_exact(factor.rank)) {
                *e = b - dot(left, change);
            }
        }
        Ok(Status::Refitted)
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
        let height = (self.held.len() - held).clamp(width, width + REDUCED_ROWS);
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
    pub(crate) fn reduce_leading(
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
        self.height = (self.held.len() - rows.len()).clamp(width, width + REDUCED_ROWS);
        let reduced = self.triangle(factor, problem, pool, self.height, width);
        rows.iter().for_each(|&i| self.held[i] = false);
        reduced?;
        let triangle: Vec<f64> = (0..rank).flat_map(|j| self.column(j, rank)).copied().collect();
        leading_rank(&triangle, rank, factor.tolerance, pool)
    }

    fn column(&self, j: usize, kept: usize) -> &[f64] {
        &self.block[j * self.height..j * self.height + kept]
    }

    /// After `reduce_leading`: a response of row `i`, and the forward solves of the row and of this response's projection.
    pub(crate) fn forward_solve(
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
        let scratch = scratch.get_or_insert_with(|| QrScratch::new(width + REDUCED_ROWS, width));
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
