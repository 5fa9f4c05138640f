//! Pairs whose training rows may have lost rank: an exact refit.
//!
//! Householder reflections reduce the training rows to a triangle, which shows rank down to rounding. For nested models
//! (`reduce_leading`, `forward_solve`) the triangle serves all leading columns.

use crate::error::Error;
use crate::fit::factor::{Factor, Problem};
use crate::fit::linalg::{self, QrScratch, dot};
use crate::fit::rank::{leading_rank, numerical_rank};
use crate::holdout::rescue::shared::Shared;
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
    shared: Shared,
}

impl Refit {
    /// Refits without `rows`; false if the others have lost rank.
    pub(super) fn refit(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        rows: &[usize],
    ) -> Result<bool, Error> {
        self.reduce(factor, problem, pool, rows)?;
        let defined = self.rank(factor, pool)? == factor.coordinates();
        if defined {
            self.solve(factor);
        }
        Ok(defined)
    }

    /// The weighted residuals of rows under the last refit.
    pub(super) fn residuals(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        rows: &[usize],
        out: &mut [f64],
    ) -> Result<(), Error> {
        let order = factor.coordinates();
        for (e, &row) in out.chunks_exact_mut(factor.responses).zip(rows) {
            factor.full_rank_row(problem, row, &mut self.row)?;
            let (left, right) = self.row.split_at(order);
            for ((e, b), change) in e.iter_mut().zip(right).zip(self.change.chunks_exact(order)) {
                *e = b - dot(left, change);
            }
        }
        Ok(())
    }

    /// `((I - H_KK)^-1)_TT = I + X_T (X_-K^T X_-K)^-1 X_T^T` of the first `validated` of the held-out rows, row-major;
    /// NaN where the training rows have lost rank.
    pub(crate) fn spread(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        (rows, validated): (&[usize], usize),
        out: &mut [f64],
    ) -> Result<(), Error> {
        self.reduce(factor, problem, pool, rows)?;
        let order = factor.coordinates();
        if self.rank(factor, pool)? < order {
            out.fill(f64::NAN);
            return Ok(());
        }
        let mut solves = Vec::with_capacity(validated * order);
        for &row in &rows[..validated] {
            self.forward(factor, problem, row, order)?;
            solves.extend_from_slice(&self.row[..order]);
        }
        let solve = |i: usize| &solves[i * order..(i + 1) * order];
        for i in 0..validated {
            for j in 0..=i {
                let c = dot(solve(i), solve(j)) + if i == j { 1.0 } else { 0.0 };
                (out[i * validated + j], out[j * validated + i]) = (c, c);
            }
        }
        Ok(())
    }

    /// Coefficients of the training rows, from their triangle.
    fn solve(&mut self, factor: &Factor) {
        let (order, responses) = (factor.coordinates(), factor.responses);
        self.change.resize(order * responses, 0.0);
        for (c, change) in self.change.chunks_exact_mut(order).enumerate() {
            let column = (order + c) * self.height;
            change.copy_from_slice(&self.block[column..column + order]);
        }
        linalg::solve_upper(&self.block, self.height, order, &mut self.change, responses);
    }

    /// Reduces the training rows of a design of full rank, and tells how many of its leading columns they determine.
    pub(crate) fn reduce_leading(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        rows: &[usize],
    ) -> Result<usize, Error> {
        self.reduce(factor, problem, pool, rows)?;
        let mut triangle = Vec::with_capacity(factor.rank * factor.rank);
        (0..factor.rank).for_each(|j| triangle.extend_from_slice(self.column(j, factor.rank)));
        leading_rank(&triangle, factor.rank, factor.tolerance, pool)
    }

    /// Reduces all rows but some, once for the sets that come next: none of them holds out others. Without any, nothing is
    /// shared.
    pub(crate) fn share(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        outside: &[usize],
    ) -> Result<(), Error> {
        self.shared.clear();
        if outside.is_empty() {
            return Ok(());
        }
        self.reduce(factor, problem, pool, outside)?;
        let Self { shared, block, height, row, .. } = self;
        shared.start(factor.coordinates(), row.len(), |j| &block[j * *height..]);
        for &i in outside {
            factor.full_rank_row(problem, i, row)?;
            shared.push(i, row);
        }
        Ok(())
    }

    /// Reduces all rows but those held out.
    pub(crate) fn reduce(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        rows: &[usize],
    ) -> Result<(), Error> {
        let width = factor.coordinates() + factor.responses;
        self.held.resize(factor.problem_rows(), false);
        self.row.resize(width, 0.0);
        rows.iter().for_each(|&i| self.held[i] = true);
        let reduced = if self.shared.is_empty() {
            self.height = (self.held.len() - rows.len()).clamp(width, width + REDUCED_ROWS);
            self.triangle(factor, problem, pool, width)
        } else {
            self.height = width;
            self.block.resize(width * width, 0.0);
            self.shared.reduce(&self.held, &mut self.block, width, pool)
        };
        rows.iter().for_each(|&i| self.held[i] = false);
        reduced
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
        self.forward(factor, problem, i, leading)?;
        let projection = self.column(rank + response, leading);
        Ok((self.row[rank + response], &self.row[..leading], projection))
    }

    /// Leaves the forward solve of row `i`, its leading entries, in `row`.
    fn forward(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        i: usize,
        leading: usize,
    ) -> Result<(), Error> {
        factor.full_rank_row(problem, i, &mut self.row)?;
        for j in 0..leading {
            let at = j * self.height;
            let (known, rest) = self.row.split_at_mut(j);
            rest[0] = (rest[0] - dot(&self.block[at..at + j], known)) / self.block[at + j];
        }
        Ok(())
    }

    /// Leaves the triangle of the training rows and their right-hand sides at the top of `block`.
    fn triangle(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        width: usize,
    ) -> Result<(), Error> {
        let Self { held, row: entries, block, reflectors, scratch, height, .. } = self;
        let height = *height;
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
    fn rank(&self, factor: &Factor, pool: &Pool<'_>) -> Result<usize, Error> {
        let order = factor.coordinates();
        let mut r = vec![0.0; order * order];
        for (j, column) in r.chunks_exact_mut(order).enumerate() {
            column[..=j].copy_from_slice(self.column(j, j + 1));
        }
        if linalg::inverse_norm(&r, order, pool)?.recip() > 2.0 * factor.tolerance * (order as f64).sqrt() {
            return Ok(order);
        }
        let values = linalg::thin_svd(r, order, order, pool)?.s;
        Ok(numerical_rank(&values, factor.tolerance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Example, assert_close, pool};

    /// Weighted residuals, of more rows than are reduced at a time.
    #[test]
    fn residuals_are_those_of_the_training_rows_fit() {
        let example = Example::new(1300, 5, 2);
        let (factor, problem, mut refit) = (example.factor(), example.problem(), Refit::default());
        for rows in [&[0, 700, 1299, 3][..], &[], &[600]] {
            assert!(refit.refit(&factor, &problem, &pool(1), rows).unwrap());
            let some = [0, 1299, 20];
            let mut found = vec![0.0; 6];
            refit.residuals(&factor, &problem, &some, &mut found).unwrap();
            let mut expected = example.refit(rows, &some);
            expected.iter_mut().enumerate().for_each(|(k, e)| *e *= example.root_weights[some[k / 2]]);
            assert_close(&found, &expected, 1e-13);
        }
    }

    /// Of the same sets, in any order, and of none.
    #[test]
    fn what_sets_share_is_reduced_once() {
        let example = Example::new(60, 5, 2);
        let (factor, problem, mut refit) = (example.factor(), example.problem(), Refit::default());
        let mut share = |rows: &[usize]| {
            refit.share(&factor, &problem, &pool(1), rows).unwrap();
            for held in [&[7, 21, 30][..], &[21], &[21, 7, 58, 3], &[7, 21, 30]] {
                assert_eq!(refit.refit(&factor, &problem, &pool(1), held), Ok(true));
                let mut found = vec![0.0; 4];
                refit.residuals(&factor, &problem, &[21, 50], &mut found).unwrap();
                let mut expected = example.refit(held, &[21, 50]);
                expected
                    .iter_mut()
                    .enumerate()
                    .for_each(|(k, e)| *e *= example.root_weights[[21, 50][k / 2]]);
                assert_close(&found, &expected, 1e-13);
                assert_eq!(refit.reduce_leading(&factor, &problem, &pool(1), held), Ok(5));
            }
            refit.height
        };
        assert_eq!(share(&[58, 3, 7, 21, 30]), 7);
        assert_eq!(share(&[]), 59);
        assert_eq!(share(&[21, 30, 58, 3, 7]), 7);
    }

    /// A column that only two rows see, and fewer rows than columns.
    #[test]
    fn training_rows_that_lose_rank_have_no_fit() {
        for (fraction, defined) in [(1e-12, true), (1e-17, false), (0.0, false)] {
            let example = Example::nearly_lost(20, 4, fraction);
            let (factor, problem, mut refit) = (example.factor(), example.problem(), Refit::default());
            assert_eq!(refit.refit(&factor, &problem, &pool(1), &[18, 19]), Ok(defined));
            assert_eq!(refit.refit(&factor, &problem, &pool(1), &[18]), Ok(true));
            let most: Vec<usize> = (0..17).collect();
            assert_eq!(refit.refit(&factor, &problem, &pool(1), &most), Ok(false));
            let leading = refit.reduce_leading(&factor, &problem, &pool(1), &[19, 18]).unwrap();
            assert_eq!(leading, if defined { 4 } else { 3 });
        }
    }

    /// `1 + |R^-T x|^2` is the spread of a row alone; `u . v` is what the training rows' leading models predict.
    #[test]
    fn the_triangle_serves_spreads_and_leading_models() {
        let example = Example::new(40, 4, 2);
        let (factor, problem, mut refit) = (example.factor(), example.problem(), Refit::default());
        let held = [7, 21, 30];
        let mut spread = [0.0; 4];
        refit.spread(&factor, &problem, &pool(1), (&held, 2), &mut spread).unwrap();
        assert_eq!(refit.reduce_leading(&factor, &problem, &pool(1), &held), Ok(4));
        for c in 0..2 {
            let (b, u, v) = refit.forward_solve(&factor, &problem, 7, c, 4).unwrap();
            assert!((spread[0] - 1.0 - dot(u, u)).abs() < 1e-14 * spread[0]);
            assert_eq!(b, example.responses[14 + c] * example.root_weights[7]);
            for size in 1..=4 {
                let expected = example.lead(size).refit(&held, &[7])[c] * example.root_weights[7];
                assert!((b - dot(&u[..size], &v[..size]) - expected).abs() < 1e-13);
            }
        }
        // The inverse of I - H_KK, of which it is a part.
        let mut whole = [0.0; 9];
        refit.spread(&factor, &problem, &pool(1), (&held, 3), &mut whole).unwrap();
        assert_close(&spread, &[whole[0], whole[1], whole[3], whole[4]], 1e-14);
        let h = |i: usize, j: usize| dot(factor.basis_row(held[i]), factor.basis_row(held[j]));
        let entry =
            |i: usize, j: usize| whole[3 * i + j] - (0..3).map(|k| h(i, k) * whole[3 * k + j]).sum::<f64>();
        let product: Vec<f64> = (0..9).map(|at| entry(at / 3, at % 3)).collect();
        assert_close(&product, &[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], 1e-14);
    }

    #[test]
    fn a_problem_that_has_changed_is_noticed() {
        let mut example = Example::new(40, 4, 2);
        let factor = example.factor();
        example.design[9] += 1.0;
        let found = Refit::default().refit(&factor, &example.problem(), &pool(1), &[0]);
        assert_eq!(found, Err(Error::Changed { row: 2 }));
    }
}
