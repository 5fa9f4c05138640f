//! Pairs close to rank loss: the primal with twice the digits, or the training rows' own triangle.

use std::sync::OnceLock;

use super::curves::{AllModels, Outcome, PairCurve, Visited, certain_least};
use super::{Curve, Nested, add_squares};
use crate::error::Error;
use crate::fit::factor::Problem;
use crate::fit::panels::PANEL;
use crate::holdout::probes::{by_probe, sign};
use crate::holdout::rescue::double_double::{DdFactor, DdGram};
use crate::holdout::rescue::refit::Refit;
use crate::holdout::rescue::shared::groups;
use crate::holdout::walk::{LastPair, Workspace};
use crate::pool::Pool;

/// Below this lambda_min(M) twice the digits do not help: those of Q are too few.
const DOUBLE_DOUBLE_MIN_EIGENVALUE: f64 = 1e-12;

/// Below this estimate by plain arithmetic lambda_min(M) is below that beyond doubt.
const CERTAIN_LOSS: f64 = DOUBLE_DOUBLE_MIN_EIGENVALUE / 10.0;

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
        // Those for which twice the digits are too few come last.
        let lost = |visited: &Visited| visited.least < CERTAIN_LOSS;
        steps.sort_unstable_by_key(|visited| (lost(visited), visited.scheme, visited.step));
        let (close, lost) = steps.split_at(steps.partition_point(|visited| !lost(visited)));
        let members: Vec<Vec<usize>> = lost.iter().map(|visited| visited.members(self.ground)).collect();
        let factor = &self.nested.factor;
        let shape = (factor.problem_rows(), factor.coordinates() + factor.responses);
        let groups = groups(&members, self.ground.rows.len(), shape);
        let run = (close.len() / 16).clamp(1, LONGEST_RUN);
        let runs = close.chunks(run).map(|run| (run, &[][..]));
        let tasks = runs.chain(groups.iter().map(|group| (&lost[group.sets.clone()], &group.union[..])));
        let whole = if close.is_empty() { None } else { Some(self.nested.whole_gram(pool)?) };
        let mut results: Vec<(Vec<f64>, usize)> = vec![(Vec::new(), 0); steps.len()];
        let mut rest = &mut results[..];
        let tasks: Vec<_> = tasks
            .map(|(steps, union)| {
                let (mine, after) = std::mem::take(&mut rest).split_at_mut(steps.len());
                rest = after;
                (steps, union, mine)
            })
            .collect();
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
            solved: None,
        };
        pool.run(tasks.into_iter(), workspace, |rescue, (steps, union, results)| {
            let solved = rescue.start(union, pool).and_then(|()| {
                steps.iter().zip(results).try_for_each(|(&visited, result)| {
                    let defined = rescue.solve(visited, pool)?;
                    *result = (rescue.curve.squares.clone(), defined);
                    Ok(())
                })
            });
            if let Err(error) = solved {
                let _ = failure.set(error);
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
    /// Of all rows, if twice the digits help any pair.
    whole: Option<&'a DdGram>,
    work: Workspace,
    curve: PairCurve,
    last: LastPair<DdGram>,
    factor: DdFactor,
    refit: Refit,
    solved: Option<Solved>,
}

/// What the last set was solved with, and how far its training rows determine the models.
#[derive(Clone, Copy)]
enum Solved {
    /// The factor with twice the digits, which serves this many of the models.
    TwiceTheDigits(usize),
    /// The triangle of the training rows, this many columns of it.
    Refitted(usize),
}

impl Rescue<'_> {
    /// Before a run of neighbours, and data beyond which these hold out none, if they share what is left.
    fn start(&mut self, union: &[usize], pool: &Pool<'_>) -> Result<(), Error> {
        let Self { models, problem, whole, last, refit, solved, .. } = self;
        let AllModels { ground, nested, .. } = **models;
        *solved = None;
        last.clear(ground.rows.len());
        if let Some(whole) = whole {
            last.gram.copy_from(whole);
        }
        refit.share(&nested.factor, problem, pool, &ground.rows_of(union))
    }

    /// Fills the curve of a pair, and tells how many of the models are defined.
    fn solve(&mut self, visited: Visited, pool: &Pool<'_>) -> Result<usize, Error> {
        self.work.list_pair(self.models.ground, visited.scheme, visited.pair);
        // Data in a cluster tend to hold out the same set.
        let lost = visited.least < CERTAIN_LOSS;
        let solved = match (self.move_to_pair(!lost), self.solved) {
            (false, Some(solved)) => solved,
            _ => self.factor(lost, pool)?,
        };
        self.solved = Some(solved);
        let defined = match solved {
            Solved::TwiceTheDigits(defined) => defined,
            Solved::Refitted(leading) => self.models.cuts.partition_point(|&cut| cut <= leading),
        };
        self.curve.squares[..defined].fill(0.0);
        self.curve.squares[defined..].fill(f64::NAN);
        match solved {
            Solved::TwiceTheDigits(_) => self.predict(defined),
            Solved::Refitted(leading) => self.predict_refitted(leading, defined)?,
        }
        Ok(defined)
    }

    /// Factors the set at hand; of one that is lost to twice the digits, the training rows.
    fn factor(&mut self, lost: bool, pool: &Pool<'_>) -> Result<Solved, Error> {
        let models = self.models;
        let least = if lost { 0.0 } else { self.double_double() };
        if least >= DOUBLE_DOUBLE_MIN_EIGENVALUE {
            if least > certain_least(models.ground.factor) {
                return Ok(Solved::TwiceTheDigits(models.cuts.len()));
            }
            match self.curve.cut(models, &self.factor.upper(), pool) {
                Outcome::All => return Ok(Solved::TwiceTheDigits(models.cuts.len())),
                Outcome::Leading(defined) => return Ok(Solved::TwiceTheDigits(defined)),
                Outcome::Close => pool.proceed()?,
            }
        }
        let rows = &self.work.rows;
        Ok(Solved::Refitted(self.refit.reduce_leading(models.ground.factor, &self.problem, pool, rows)?))
    }

    /// Factors with twice the digits; an estimate of lambda_min(M).
    fn double_double(&mut self) -> f64 {
        let rank = self.models.ground.factor.rank;
        let smallest = self.factor.factor(&self.last.gram);
        if smallest < DOUBLE_DOUBLE_MIN_EIGENVALUE {
            return 0.0;
        }
        let signs: Vec<f64> = (0..rank).map(|j| sign(0, j)).collect();
        let square = self.factor.forward(&[&signs]).iter().map(|u| u[0] * u[0]).sum();
        smallest.min(by_probe(square, rank))
    }

    /// As `PairCurve::primal`, with twice the digits.
    fn predict(&mut self, defined: usize) {
        let AllModels { nested: Nested { factor, right, .. }, cuts, .. } = *self.models;
        let squares = &mut self.curve.squares;
        for rows in self.work.rows[..self.work.validated].chunks(PANEL) {
            let entries: Vec<&[f64]> = rows.iter().map(|&i| factor.basis_row(i)).collect();
            let u = self.factor.forward(&entries).to_vec();
            for c in 0..factor.responses {
                let mut b = [0.0; PANEL];
                b.iter_mut().zip(rows).for_each(|(b, &i)| *b = right[i * factor.responses + c]);
                add_squares(b, &u, &self.factor.projection(c), &cuts[..defined], squares);
            }
        }
    }

    /// From the training rows themselves.
    fn predict_refitted(&mut self, leading: usize, defined: usize) -> Result<(), Error> {
        let Self { models, problem, work, refit, curve, .. } = self;
        let factor = models.ground.factor;
        for &i in &work.rows[..work.validated] {
            for c in 0..factor.responses {
                let (b, u, v) = refit.forward_solve(factor, problem, i, c, leading)?;
                add_squares([b], u.as_chunks().0, v, &models.cuts[..defined], &mut curve.squares);
            }
        }
        Ok(())
    }

    /// Goes on to the pair at hand, and turns the matrix into its own if that is needed; whether the set is another.
    fn move_to_pair(&mut self, gram: bool) -> bool {
        let Self { models, work, last, whole, .. } = self;
        let AllModels { ground, nested, .. } = **models;
        let change = work.change_from(last);
        let (added, removed) = (ground.rows_of(&change.added), ground.rows_of(&change.removed));
        if added.len() + removed.len() == 0 {
            return false;
        }
        let fetch = |i: usize| (ground.factor.basis_row(i), nested.right_row(i));
        if !gram {
            last.set_members(&work.members[0]);
            return true;
        }
        if let Some(whole) = whole.filter(|_| added.len() + removed.len() > work.rows.len()) {
            last.gram.copy_from(whole);
            last.gram.change(&work.rows, -1.0, fetch);
        } else {
            last.gram.change(&added, -1.0, fetch);
            last.gram.change(&removed, 1.0, fetch);
        }
        last.set_members(&work.members[0]);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::holdout::nested::curves::tests::{curves, refitted};
    use crate::holdout::scheme::{Held, Scheme};
    use crate::holdout::walk::Ground;
    use crate::testing::{Example, assert_close, bits, pool, sets, singletons};

    /// Nearly lost, all but lost, and lost beyond twice the digits: those of the last model. Equal sets of different
    /// validated rows, in any order.
    #[test]
    fn curves_near_rank_loss_are_plain_refits() {
        let held = sets([&[38, 39], &[39, 2, 38], &[2, 38, 39], &[39, 38], &[5]]);
        let validated = sets([&[38], &[2, 39], &[38], &[39], &[5]]);
        for (fraction, tolerance) in [(1e-3, 1e-10), (1e-5, 1e-10), (1e-8, 1e-7)] {
            let example = Example::nearly_lost(40, 5, fraction);
            let found = &curves(&example, &[(&held, &validated, None)], 1)[0];
            let mut expected = [0.0; 5];
            for pair in 0..5 {
                let curve = refitted(&example, held.get(pair), validated.get(pair));
                expected.iter_mut().zip(curve).for_each(|(sum, x)| *sum += x);
            }
            assert_close(&found.squares[..4], &expected[..4], 1e-12);
            let error = (found.squares[4] / expected[4] - 1.0).abs();
            assert!(error < tolerance, "{fraction}: {error}");
        }
    }

    /// A set that comes again is neither updated nor factored again; another is, whatever it starts from.
    #[test]
    fn equal_sets_share_a_factor() {
        let example = Example::nearly_lost(40, 5, 1e-5);
        let (problem, rows) = (example.problem(), singletons(40));
        let nested = Nested::new(&problem, &pool(1)).unwrap();
        let held = sets([&[38, 39, 4], &[4, 38, 39], &[5, 38, 39], &[10, 11, 12, 38, 39], &[38, 39, 4]]);
        let validated = sets([&[4], &[4], &[5], &[10], &[4]]);
        let schemes = [Scheme { held: Held::Sets(&held), validated: &validated, order: None }];
        let ground = Ground { factor: &nested.factor, schemes: &schemes, rows: &rows, hat: None };
        let models = AllModels { ground: &ground, nested: &nested, cuts: &[1, 2, 3, 4, 5] };
        let whole = nested.whole_gram(&pool(1)).unwrap();
        let mut rescue = Rescue {
            models: &models,
            problem: nested.independent(&problem),
            whole: Some(whole),
            work: Workspace::new(40),
            curve: PairCurve::new(5),
            last: LastPair::default(),
            factor: DdFactor::default(),
            refit: Refit::default(),
            solved: None,
        };
        let start = |rescue: &mut Rescue<'_>| {
            rescue.last.clear(40);
            rescue.last.gram.copy_from(whole);
        };
        start(&mut rescue);
        let changes = [0, 1, 2, 3, 4].map(|pair| {
            rescue.work.list_pair(&ground, 0, pair);
            rescue.move_to_pair(true)
        });
        assert_eq!(changes, [true, false, true, true, true]);
        start(&mut rescue);
        let found = [0, 1, 2, 3, 4].map(|pair| {
            let visited = Visited { scheme: 0, step: pair, pair, least: 1e-10 };
            assert_eq!(rescue.solve(visited, &pool(1)), Ok(5));
            assert!(matches!(rescue.solved, Some(Solved::TwiceTheDigits(5))));
            assert_close(
                &rescue.curve.squares,
                &refitted(&example, held.get(pair), validated.get(pair)),
                1e-11,
            );
            bits(&rescue.curve.squares)
        });
        assert_eq!(found[0], found[1]);
        // Where plain arithmetic leaves no doubt, twice the digits are not tried.
        start(&mut rescue);
        rescue.solved = None;
        assert_eq!(rescue.solve(Visited { scheme: 0, step: 0, pair: 0, least: 0.0 }, &pool(1)), Ok(5));
        assert!(matches!(rescue.solved, Some(Solved::Refitted(5))));
        assert_close(&rescue.curve.squares, &refitted(&example, held.get(0), validated.get(0)), 1e-11);
    }
}
