//! Pairs close to rank loss: the primal with twice the digits, or the training rows' own triangle.

use std::sync::OnceLock;

use super::curves::{AllModels, Outcome, PairCurve, Visited};
use super::{Curve, Nested, add_squares};
use crate::error::Error;
use crate::fit::factor::Problem;
use crate::fit::linalg::dot;
use crate::holdout::probes::sign;
use crate::holdout::rescue::double_double::{DdFactor, DdGram};
use crate::holdout::rescue::refit::Refit;
use crate::holdout::walk::{LastPair, Workspace};
use crate::pool::Pool;

/// Below this lambda_min(M) twice the digits do not help: those of Q are too few.
const DOUBLE_DOUBLE_MIN_EIGENVALUE: f64 = 1e-12;

/// Pairs close to rank loss that share matrices, at most.
const LONGEST_RUN: usize = 64;

impl AllModels<'_> {
    /// The pairs close to rank loss, in runs that share matrices.
    pub(super) fn rescue(
        &self,
        problem: &Problem<'_>,
        steps: &mut [Visited],
        found: &mut [Curve],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        if steps.is_empty() {
            return Ok(());
        }
        steps.sort_unstable();
        let whole = self.nested.whole_gram(pool)?;
        let mut results: Vec<(Vec<f64>, usize)> = vec![(Vec::new(), 0); steps.len()];
        let failure = OnceLock::new();
        let workspace = || Rescue {
            models: self,
            problem: self.nested.independent(problem),
            whole,
            work: Workspace::new(self.ground.rows.len()),
            curve: PairCurve::new(self.cuts.len()),
            last: LastPair::default(),
            factor: DdFactor::default(),
            refit: Refit::default(),
        };
        let run = (steps.len() / 16).clamp(1, LONGEST_RUN);
        pool.run(steps.chunks(run).zip(results.chunks_mut(run)), workspace, |rescue, (steps, results)| {
            rescue.last.clear(self.ground.rows.len());
            rescue.last.gram.copy_from(whole);
            for (&visited, result) in steps.iter().zip(results) {
                match rescue.solve(visited, pool) {
                    Ok(defined) => *result = (rescue.curve.squares.clone(), defined),
                    Err(error) => {
                        let _ = failure.set(error);
                        return;
                    }
                }
            }
        })?;
        for (&visited, (squares, defined)) in steps.iter().zip(&results) {
            let found = &mut found[visited.scheme];
            found.note(self.ground.schemes, visited, *defined);
            found.squares.iter_mut().zip(squares).for_each(|(sum, x)| *sum += x);
        }
        failure.into_inner().map_or(Ok(()), Err)
    }
}

/// What a thread needs for pairs close to rank loss.
struct Rescue<'a> {
    models: &'a AllModels<'a>,
    problem: Problem<'a>,
    whole: &'a DdGram,
    work: Workspace,
    curve: PairCurve,
    last: LastPair<DdGram>,
    factor: DdFactor,
    refit: Refit,
}

impl Rescue<'_> {
    /// Fills the curve of a pair, and tells how many of the models are defined.
    fn solve(&mut self, visited: Visited, pool: &Pool<'_>) -> Result<usize, Error> {
        let factor = self.models.ground.factor;
        self.work.list_pair(self.models.ground, visited.scheme, visited.pair);
        self.curve.squares.fill(0.0);
        let enough = factor.total_rows >= factor.rank + self.work.rows.len();
        if enough && self.double_double() >= DOUBLE_DOUBLE_MIN_EIGENVALUE {
            match self.curve.cut(self.models, &self.factor.upper(), pool) {
                Outcome::All => return Ok(self.models.cuts.len()),
                Outcome::Leading(defined) => return Ok(defined),
                Outcome::Close => pool.proceed()?,
            }
        }
        self.refitted(pool)
    }

    /// As `PairCurve::primal`, with twice the digits; an estimate of lambda_min(M).
    fn double_double(&mut self) -> f64 {
        let AllModels { nested: Nested { factor, right, .. }, cuts, .. } = *self.models;
        let (rank, responses) = (factor.rank, factor.responses);
        self.update_gram();
        let smallest = self.factor.factor(&self.last.gram);
        if smallest < DOUBLE_DOUBLE_MIN_EIGENVALUE {
            return 0.0;
        }
        let signs: Vec<f64> = (0..rank).map(|j| sign(0, j)).collect();
        let forward = self.factor.forward(&signs);
        let grown = dot(forward, forward) - 10.0 * rank as f64;
        for c in 0..responses {
            let projection = self.factor.projection(c).to_vec();
            for &i in &self.work.rows[..self.work.validated] {
                let u = self.factor.forward(factor.basis_row(i));
                let squares = &mut self.curve.squares;
                add_squares([right[i * responses + c]], u.as_chunks().0, &projection, cuts, squares);
            }
        }
        if grown > 0.0 { smallest.min(grown.recip()) } else { smallest }
    }

    /// Turns the matrix into that of the pair at hand.
    fn update_gram(&mut self) {
        let Self { models, work, last, whole, .. } = self;
        let AllModels { ground, nested, .. } = **models;
        let change = work.change_from(last);
        let (added, removed) = (ground.rows_of(&change.added), ground.rows_of(&change.removed));
        let fetch = |i: usize| (ground.factor.basis_row(i), nested.right_row(i));
        if added.len() + removed.len() > work.rows.len() {
            last.gram.copy_from(whole);
            last.gram.change(&work.rows, -1.0, fetch);
        } else {
            last.gram.change(&added, -1.0, fetch);
            last.gram.change(&removed, 1.0, fetch);
        }
        last.set_members(&work.members[0]);
    }

    /// From the training rows themselves.
    fn refitted(&mut self, pool: &Pool<'_>) -> Result<usize, Error> {
        let Self { models, problem, work, refit, .. } = self;
        let (factor, cuts, squares) = (models.ground.factor, models.cuts, &mut self.curve.squares);
        let leading = refit.reduce_leading(factor, problem, pool, &work.rows)?;
        let defined = cuts.partition_point(|&cut| cut <= leading);
        squares[..defined].fill(0.0);
        squares[defined..].fill(f64::NAN);
        for &i in &work.rows[..work.validated] {
            for c in 0..factor.responses {
                let (b, u, v) = refit.forward_solve(factor, problem, i, c, leading)?;
                add_squares([b], u.as_chunks().0, v, &cuts[..defined], squares);
            }
        }
        Ok(defined)
    }
}
