//! Pairs close to rank loss: the primal with twice the digits, or the training rows' own triangle.

use std::sync::OnceLock;

use super::sweep::{LastPair, Outcome, Sweep, Workspace};
use super::{Curve, Nested, add_squares};
use crate::error::Error;
use crate::fit::factor::Problem;
use crate::fit::linalg::dot;
use crate::holdout::probes::sign;
use crate::holdout::rescue::double_double::{DdFactor, DdGram};
use crate::holdout::rescue::refit::Refit;
use crate::pool::Pool;

/// Below this lambda_min(M) twice the digits do not help: those of Q are too few.
const DOUBLE_DOUBLE_MIN_EIGENVALUE: f64 = 1e-12;

/// Pairs close to rank loss that share matrices, at most.
const LONGEST_RUN: usize = 64;

impl Sweep<'_> {
    /// The pairs close to rank loss, in runs that share matrices.
    pub(super) fn rescue(
        &self,
        problem: &Problem<'_>,
        steps: &mut [(usize, usize)],
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
            sweep: self,
            problem: self.nested.independent(problem),
            whole,
            plain: Workspace::new(self),
            last: LastPair::default(),
            factor: DdFactor::default(),
            refit: Refit::default(),
        };
        let run = (steps.len() / 16).clamp(1, LONGEST_RUN);
        pool.run(steps.chunks(run).zip(results.chunks_mut(run)), workspace, |rescue, (steps, results)| {
            rescue.last.clear(self.rows.len());
            rescue.last.gram.copy_from(whole);
            for (&(s, step), result) in steps.iter().zip(results) {
                match rescue.solve((s, self.schemes[s].order[step]), pool) {
                    Ok(defined) => *result = (rescue.plain.curve.clone(), defined),
                    Err(error) => {
                        let _ = failure.set(error);
                        return;
                    }
                }
            }
        })?;
        for (&(s, step), (squares, defined)) in steps.iter().zip(&results) {
            found[s].defined[step] = *defined;
            found[s].squares.iter_mut().zip(squares).for_each(|(sum, x)| *sum += x);
        }
        failure.into_inner().map_or(Ok(()), Err)
    }
}

/// What a thread needs for pairs close to rank loss.
struct Rescue<'a> {
    sweep: &'a Sweep<'a>,
    problem: Problem<'a>,
    whole: &'a DdGram,
    plain: Workspace,
    last: LastPair<DdGram>,
    factor: DdFactor,
    refit: Refit,
}

impl Rescue<'_> {
    /// Fills the curve of a pair, and tells how many of the models are defined.
    fn solve(&mut self, pair: (usize, usize), pool: &Pool<'_>) -> Result<usize, Error> {
        let factor = &self.sweep.nested.factor;
        self.plain.list_rows(self.sweep, pair);
        self.plain.curve.fill(0.0);
        let enough = factor.total_rows >= factor.rank + self.plain.rows.len();
        if enough && self.double_double() >= DOUBLE_DOUBLE_MIN_EIGENVALUE {
            match self.plain.cut(self.sweep, &self.factor.upper(), pool) {
                Outcome::All => return Ok(self.sweep.cuts.len()),
                Outcome::Leading(defined) => return Ok(defined),
                Outcome::Close => pool.proceed()?,
            }
        }
        self.refitted(pool)
    }

    /// As `Workspace::primal`, with twice the digits; an estimate of lambda_min(M).
    fn double_double(&mut self) -> f64 {
        let Sweep { nested: Nested { factor, right, .. }, cuts, .. } = *self.sweep;
        let (rank, responses) = (factor.rank, factor.responses);
        self.update_gram();
        let smallest = self.factor.factor(&self.last.gram);
        if smallest < DOUBLE_DOUBLE_MIN_EIGENVALUE {
            return 0.0;
        }
        let signs: Vec<f64> = (0..rank).map(|j| sign(0, j)).collect();
        let forward = self.factor.forward(&signs);
        let grown = dot(forward, forward) - 10.0 * rank as f64;
        let Workspace { rows, validated, curve, .. } = &mut self.plain;
        for c in 0..responses {
            let projection = self.factor.projection(c).to_vec();
            for &i in &rows[rows.len() - *validated..] {
                let u = self.factor.forward(factor.basis_row(i));
                add_squares([right[i * responses + c]], u.as_chunks().0, &projection, cuts, curve);
            }
        }
        if grown > 0.0 { smallest.min(grown.recip()) } else { smallest }
    }

    /// Turns the matrix into that of the pair at hand.
    fn update_gram(&mut self) {
        let Self { sweep, plain, last, whole, .. } = self;
        let factor = &sweep.nested.factor;
        let Workspace { members, stamps, now, slide, .. } = plain;
        slide.find(last, members, stamps, *now);
        if slide.len() > members.len() {
            last.gram.copy_from(whole);
            slide.removed.clear();
            slide.added.clone_from(members);
        }
        let fetch = |i: usize| (factor.basis_row(i), sweep.nested.right_row(i));
        last.gram.change(&sweep.rows_of(&slide.added), -1.0, fetch);
        last.gram.change(&sweep.rows_of(&slide.removed), 1.0, fetch);
        last.set_members(members);
    }

    /// From the training rows themselves.
    fn refitted(&mut self, pool: &Pool<'_>) -> Result<usize, Error> {
        let Self { sweep, problem, plain, refit, .. } = self;
        let factor = &sweep.nested.factor;
        let leading = refit.reduce_leading(factor, problem, pool, &plain.rows)?;
        let defined = sweep.cuts.partition_point(|&cut| cut <= leading);
        plain.curve[..defined].fill(0.0);
        plain.curve[defined..].fill(f64::NAN);
        for &i in &plain.rows[plain.rows.len() - plain.validated..] {
            for c in 0..factor.responses {
                let (b, u, v) = refit.forward_solve(factor, problem, i, c, leading)?;
                add_squares([b], u.as_chunks().0, v, &sweep.cuts[..defined], &mut plain.curve);
            }
        }
        Ok(defined)
    }
}
