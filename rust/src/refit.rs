//! The few pairs whose training rows barely determine the model, or do not: an exact refit.
//!
//! Cholesky pivots square singular values and tell loss only down to about 1e-7 in them. Here the training rows of the
//! basis are reduced by Householder reflections, which sees down to rounding.

use crate::factor::{Factor, numerical_rank};
use crate::holdout::Status;
use crate::linalg::{self, QrScratch};

/// Training rows reduced at a time.
const ROWS: usize = 512;

/// Workspace; allocated at the first pair that needs it.
#[derive(Default)]
pub struct Refit {
    held: Vec<bool>,
    /// The running triangle over a block of rows of `[Q | e]`, column-major.
    block: Vec<f64>,
    reflectors: Vec<f64>,
    scratch: Option<QrScratch>,
}

impl Refit {
    /// Refits without `rows`, and writes the weighted residuals of the last `validated` of them.
    pub(crate) fn predict(&mut self, factor: &Factor, rows: &[usize], validated: usize, out: &mut [f64]) -> Status {
        let (rank, responses) = (factor.rank, factor.responses);
        let width = rank + responses;
        let height = width + ROWS;
        self.reserve(factor, height, width);
        rows.iter().for_each(|&i| self.held[i] = true);
        self.reduce(factor, height, width);
        rows.iter().for_each(|&i| self.held[i] = false);
        if self.rank(factor, height) < rank {
            out.fill(f64::NAN);
            return Status::Undefined;
        }
        for c in 0..responses {
            let column = (rank + c) * height;
            let mut change = self.block[column..column + rank].to_vec();
            linalg::solve_upper(&self.block, height, rank, &mut change, 1);
            let kept = &rows[rows.len() - validated..];
            for (e, &row) in out.iter_mut().skip(c).step_by(responses).zip(kept) {
                *e = factor.residual_row(row)[c] - linalg::dot(factor.basis_row(row), &change);
            }
        }
        Status::Refitted
    }

    fn reserve(&mut self, factor: &Factor, height: usize, width: usize) {
        self.held.resize(factor.rows, false);
        self.block.resize(height * width, 0.0);
        self.reflectors.resize(linalg::reflector_size(height, width), 0.0);
        self.scratch.get_or_insert_with(|| QrScratch::new(height, width));
    }

    /// Leaves the triangle of the training rows of `[Q | e]` at the top of `block`.
    fn reduce(&mut self, factor: &Factor, height: usize, width: usize) {
        let Self { held, block, reflectors, scratch: Some(scratch) } = self else { return };
        block.fill(0.0);
        let total = factor.basis.len() / factor.rank.max(1);
        let mut training = (0..total).filter(|&i| i >= factor.rows || !held[i]).peekable();
        while training.peek().is_some() {
            for j in 0..width {
                block[j * height + (j + 1).min(width)..(j + 1) * height].fill(0.0);
            }
            for (k, row) in training.by_ref().take(ROWS).enumerate() {
                for (j, &q) in factor.basis_row(row).iter().enumerate() {
                    block[j * height + width + k] = q;
                }
                for (c, &e) in factor.residual_row(row).iter().enumerate() {
                    block[(factor.rank + c) * height + width + k] = e;
                }
            }
            linalg::qr_in_place(block, height, width, reflectors, scratch);
        }
    }

    /// Rank of the training rows of the design, columns at unit length.
    fn rank(&self, factor: &Factor, height: usize) -> usize {
        let rank = factor.rank;
        let mut r = vec![0.0; rank * rank];
        for (j, column) in r.chunks_exact_mut(rank).enumerate() {
            column[..=j].copy_from_slice(&self.block[j * height..j * height + j + 1]);
        }
        let design = linalg::product(&r, &factor.triangle, rank, rank, factor.columns);
        let tolerance = factor.rows.max(factor.columns) as f64 * f64::EPSILON;
        // The design's smallest singular value is at least 1 / (||R^-1|| ||triangle^-1||), its largest at most sqrt(columns).
        linalg::thin_svd(&design, rank, factor.columns).map_or(0, |svd| numerical_rank(&svd.s, tolerance))
    }
}
