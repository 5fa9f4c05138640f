//! Prediction residuals of held-out pairs, equation (6): `e_(K) = (I - H_KK)^-1 e_K`, for the validated rows alone.
//!
//! With q held-out rows and rank p, a pair is solved in the smaller of two spaces. The *dual* factors
//! `I - Q_K Q_K^T` (q x q). The *primal* uses `e_(T) = e_T + Q_T M^-1 Q_K^T e_K` with `M = I - Q_K^T Q_K` (p x p).
//! Both are one call of [`Bordered`]. One to three rows are unrolled. A smallest eigenvalue near zero says that the
//! training rows barely determine the model: see [`crate::holdout::rescue`].
//!
//! Balls around one datum nest, and one dual factorisation serves them all: with the datum's rows first and then ring after
//! ring, a ball is a leading part of the largest, and so are its factor L and its forward solves `y = L^-1 e_K` and
//! `z = L^-1 1_T`, of which `e_(T) = z^T y`. All criteria of a sweep then cost what the widest of them does.

use std::slice;
use std::sync::OnceLock;

use crate::error::Error;
use crate::fit::factor::{Factor, Problem, expect_length};
use crate::fit::linalg::dot;
use crate::holdout::kernel::Bordered;
use crate::holdout::probes::{PROBES, least_eigenvalue};
use crate::holdout::rescue::refine::{Inverse, NearSingular};
use crate::holdout::rescue::refit::Refit;
use crate::holdout::visit::{Hat, Plan, Slot, costs};
use crate::pool::Pool;
use crate::sets::Sets;

/// Which data each pair holds out and validates, and the rows of every datum.
pub struct Pairs<'a> {
    /// Held-out data of each pair, increasing.
    pub held: &'a Sets,
    /// Validated data of each pair, increasing, a subset of those held out.
    pub validated: &'a Sets,
    /// Rows of each datum.
    pub rows: &'a Sets,
    /// Data in an order in which successive ones are near each other, as far as it is known. It changes no result.
    pub order: &'a [usize],
}

impl Pairs<'_> {
    /// Fails unless they are pairs of sets of data, and those sets of a design's rows.
    pub(crate) fn check(&self, rows: usize) -> Result<(), Error> {
        expect_length(self.validated.len(), self.held.len())?;
        check_indices(self.rows, rows)?;
        check_indices(self.held, self.rows.len())?;
        check_indices(self.validated, self.rows.len())
    }
}

/// What became of a pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// The closed form holds.
    Closed,
    /// Close to rank loss; the closed form was refined on the training rows.
    Refined,
    /// Closer still; the training rows were refitted.
    Refitted,
    /// The training rows have lower rank than all rows: no prediction exists.
    Undefined,
}

/// Predictions of every pair, in order.
pub struct Predictions {
    /// Prediction residuals of the validated rows in the responses' unit, row-major; NaN where undefined.
    pub residuals: Vec<f64>,
    /// The validated rows, pair after pair.
    pub rows: Vec<usize>,
    /// Where each pair starts in `rows`; one more than the pairs.
    pub offsets: Vec<usize>,
    /// One a pair.
    pub status: Vec<Status>,
}

impl Factor {
    /// Predicts the validated rows of every pair with its held-out rows left out of the fit. `problem` is the one that
    /// was factored: pairs close to rank loss go back to it.
    pub fn predict(
        &self,
        problem: &Problem<'_>,
        pairs: &Pairs<'_>,
        pool: &Pool<'_>,
    ) -> Result<Predictions, Error> {
        let plan = Plan::new(self, pairs, pool)?;
        let count = pairs.held.len();
        let mut residuals = vec![f64::NAN; plan.offsets[count] * self.responses];
        let mut status = vec![None; count];
        let hat = plan.hat.as_ref();
        let mut slots = plan.slots(&mut residuals, &mut status, self.responses);
        pool.run(
            plan.chunks(&mut slots, pool.threads()).into_iter(),
            Workspace::default,
            |workspace, chunk| {
                let mut rest = chunk.slots;
                for run in chunk.runs {
                    let run = plan.runs.get(run);
                    let (slots, after) = rest.split_at_mut(run.len());
                    rest = after;
                    workspace.list_rows(pairs, run);
                    workspace.solve(self, hat, slots);
                }
            },
        )?;
        self.rescue(problem, pairs, &plan, &mut residuals, &mut status, pool)?;
        let status = status.into_iter().map(|s| s.unwrap_or(Status::Undefined)).collect();
        let rows = (0..count).flat_map(|s| pairs.validated.get(s)).flat_map(|&d| pairs.rows.get(d)).copied();
        Ok(Predictions { residuals, rows: rows.collect(), offsets: plan.offsets, status })
    }

    /// What the prediction residuals of each pair's validated rows vary by, in units of the noise of weighted rows:
    /// `((I - H_KK)^-1)_TT`, row-major, pair after pair; NaN where the training rows lose rank.
    pub fn spread(
        &self,
        problem: &Problem<'_>,
        pairs: &Pairs<'_>,
        pool: &Pool<'_>,
    ) -> Result<Vec<f64>, Error> {
        pairs.check(self.rows)?;
        let rows_of = |pair| pairs.validated.get(pair).iter().map(|&datum| pairs.rows.get(datum).len());
        let sizes: Vec<usize> =
            (0..pairs.held.len()).map(|pair| rows_of(pair).sum::<usize>().pow(2)).collect();
        let mut blocks = vec![0.0; sizes.iter().sum()];
        let failure = OnceLock::new();
        pool.run(
            cut(&mut blocks, &sizes).into_iter().enumerate(),
            || (Workspace::default(), Refit::default()),
            |(workspace, refit), (pair, block)| {
                workspace.list_rows(pairs, &[pair]);
                if !workspace.spread(self, block) {
                    let kept = (&workspace.rows[..], workspace.validated);
                    let _ =
                        refit.spread(self, problem, pool, kept, block).map_err(|error| failure.set(error));
                }
            },
        )?;
        failure.into_inner().map_or(Ok(blocks), Err)
    }

    /// The blocks `H_KK` of the hat matrix for sets of rows: each row-major, one after another.
    pub fn hat_blocks(&self, sets: &Sets, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        check_indices(sets, self.rows)?;
        let sizes: Vec<usize> = (0..sets.len()).map(|s| sets.get(s).len().pow(2)).collect();
        let mut blocks = vec![0.0; sizes.iter().sum()];
        pool.run(
            cut(&mut blocks, &sizes).into_iter().enumerate(),
            || (),
            |(), (s, block)| {
                let rows = sets.get(s);
                let q = rows.len();
                for (i, &row) in rows.iter().enumerate() {
                    for (j, &column) in rows.iter().enumerate().take(i + 1) {
                        let h = dot(self.basis_row(row), self.basis_row(column));
                        (block[i * q + j], block[j * q + i]) = (h, h);
                    }
                }
            },
        )?;
        Ok(blocks)
    }
}

/// Parts of these sizes, one after another.
fn cut<'a>(mut rest: &'a mut [f64], sizes: &[usize]) -> Vec<&'a mut [f64]> {
    let part = |&size: &usize| {
        let (part, after) = std::mem::take(&mut rest).split_at_mut(size);
        rest = after;
        part
    };
    sizes.iter().map(part).collect()
}

pub(crate) fn check_indices(sets: &Sets, bound: usize) -> Result<(), Error> {
    expect_length(sets.items.len(), *sets.offsets.last().unwrap_or(&0))?;
    match sets.items.iter().max() {
        Some(&index) if index >= bound => Err(Error::Index { index, bound }),
        _ => Ok(()),
    }
}

/// Everything a thread needs to solve pairs; after the largest pair it allocates no more.
#[derive(Default)]
pub(super) struct Workspace {
    pub(super) system: Bordered,
    /// Held-out rows of the run at hand: the validated ones, then those that each pair holds out beyond the one before.
    pub(super) rows: Vec<usize>,
    /// How many of `rows` each pair holds out.
    ends: Vec<usize>,
    /// Their places in the hat matrix.
    pub(super) places: Vec<usize>,
    pub(super) validated: usize,
    /// Estimates of lambda_min(M), one a pair.
    pub(super) least: Vec<f64>,
}

impl Workspace {
    pub(super) fn list_rows(&mut self, pairs: &Pairs<'_>, run: &[usize]) {
        self.rows.clear();
        self.ends.clear();
        let mut inside = pairs.validated.get(run[0]);
        inside.iter().for_each(|&datum| self.rows.extend_from_slice(pairs.rows.get(datum)));
        self.validated = self.rows.len();
        for &pair in run {
            let mut known = inside.iter().peekable();
            inside = pairs.held.get(pair);
            for datum in inside {
                if known.next_if_eq(&datum).is_none() {
                    self.rows.extend_from_slice(pairs.rows.get(*datum));
                }
            }
            self.ends.push(self.rows.len());
        }
    }

    /// Writes the prediction residuals of the validated rows of every pair, but for those too close to rank loss.
    fn solve(&mut self, factor: &Factor, hat: Option<&Hat>, slots: &mut [Slot<'_>]) {
        let ends = std::mem::take(&mut self.ends);
        let possible = ends.partition_point(|&q| factor.rank + q <= factor.total_rows);
        let (slots, lost) = slots.split_at_mut(possible);
        lost.iter_mut().for_each(|slot| *slot.status = Some(Status::Undefined));
        if possible < 2 || !self.dual(factor, hat, &ends[..possible], slots) {
            for (slot, &q) in slots.iter_mut().zip(&ends) {
                self.solve_one(factor, hat, q, slot);
            }
        }
        self.ends = ends;
    }

    /// The pair of the first q rows.
    fn solve_one(&mut self, factor: &Factor, hat: Option<&Hat>, q: usize, slot: &mut Slot<'_>) {
        let least = match q {
            0 => f64::INFINITY,
            1 => self.unrolled::<1>(factor, slot.residuals),
            2 => self.unrolled::<2>(factor, slot.residuals),
            3 => self.unrolled::<3>(factor, slot.residuals),
            q => {
                let (dual, primal) = costs(q, factor.rank, hat.is_some());
                if dual <= primal {
                    self.dual(factor, hat, &[q], slice::from_mut(slot));
                    return;
                }
                self.primal(factor, slot.residuals)
            }
        };
        self.accept(factor, least, slot);
    }

    /// Accepts the solution, unless the pair is too close to rank loss.
    pub(super) fn accept(&self, factor: &Factor, least: f64, slot: &mut Slot<'_>) {
        if least >= factor.closed_form_least() {
            unweight(factor, &self.rows[..self.validated], slot.residuals);
            *slot.status = Some(Status::Closed);
        }
    }

    /// The current pair with its factored system, for refinement.
    pub(super) fn near_singular<'a>(
        &'a mut self,
        factor: &Factor,
        hat: Option<&Hat>,
        out: &'a mut [f64],
    ) -> NearSingular<'a> {
        let q = self.rows.len();
        let (dual, primal) = costs(q, factor.rank, hat.is_some());
        let least = if dual <= primal {
            self.fill_dual(factor, hat, q, 0);
            least_eigenvalue(&mut self.system, q, factor.responses)
        } else {
            self.primal_factor(factor, &(0..0))
        };
        let Self { system, rows, validated, .. } = self;
        let inverse = if dual <= primal { Inverse::Dual(system, rows) } else { Inverse::Primal(system) };
        NearSingular { inverse, least, rows, validated: *validated, out }
    }

    /// `((I - H_KK)^-1)_TT` of the pair at hand: in the dual of unit vectors, in the primal `I + Q_T M^-1 Q_T^T`. False
    /// if the pair is too close to rank loss.
    fn spread(&mut self, factor: &Factor, out: &mut [f64]) -> bool {
        let (q, t) = (self.rows.len(), self.validated);
        let (dual, primal) = costs(q, factor.rank, false);
        let (own, least) = if dual <= primal {
            self.fill_dual(factor, None, q, t);
            (0.0, least_eigenvalue(&mut self.system, q, factor.responses))
        } else {
            (1.0, self.primal_factor(factor, &(0..t)))
        };
        if least < factor.closed_form_least() || factor.rank + q > factor.total_rows {
            return false;
        }
        let first = factor.responses + PROBES;
        for i in 0..t {
            for j in 0..=i {
                let sum: f64 = self.system.forward_products(first + i, first + j).sum();
                let c = sum + if i == j { own } else { 0.0 };
                (out[i * t + j], out[j * t + i]) = (c, c);
            }
        }
        true
    }
}

/// Brings residuals of rows from weighted to plain units.
pub(super) fn unweight(factor: &Factor, rows: &[usize], out: &mut [f64]) {
    for (e, &row) in out.chunks_exact_mut(factor.responses).zip(rows) {
        e.iter_mut().for_each(|e| *e *= factor.unweight(row));
    }
}
