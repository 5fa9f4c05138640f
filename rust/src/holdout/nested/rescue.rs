//! Pairs close to rank loss: the primal with twice the digits, or the training rows' own triangle.

use std::sync::OnceLock;

use super::curves::{AllModels, Outcome, PairCurve, Visited};
use super::{Curve, Nested, add_squares};
use crate::error::Error;
use crate::fit::factor::Problem;
use crate::fit::panels::PANEL;
use crate::holdout::probes::{by_probe, sign};
use crate::holdout::rescue::double_double::{DdFactor, DdGram};
use crate::holdout::rescue::refit::Refit;
use crate::holdout::rescue::shared::{Group, groups};
use crate::holdout::walk::{LastPair, Workspace};
use crate::pool::{Pool, take};

/// Below this lambda_min(M) twice the digits do not help: those of Q are too few.
const DOUBLE_DOUBLE_MIN_EIGENVALUE: f64 = 1e-12;

/// Below this estimate by plain arithmetic lambda_min(M) is below that beyond doubt.
const CERTAIN_LOSS: f64 = DOUBLE_DOUBLE_MIN_EIGENVALUE / 10.0;

/// What a factor with twice the digits costs for each column, in rows that are reduced.
const TWICE_THE_DIGITS: f64 = 0.7;

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
        self.plan(steps, pool)?;
        let (close, refitted) = steps.split_at(steps.partition_point(|visited| !visited.refit));
        let groups = self.groups(refitted, pool)?.0;
        let run = (close.len() / 16).clamp(1, LONGEST_RUN);
        let runs = close.chunks(run).map(|run| (run, &[][..]));
        let tasks = runs.chain(groups.iter().map(|group| (&refitted[group.sets.clone()], &group.union[..])));
        let whole = if close.is_empty() { None } else { Some(self.nested.whole_gram(pool)?) };
        let mut results: Vec<(Vec<f64>, usize)> = vec![(Vec::new(), 0); steps.len()];
        let mut rest = &mut results[..];
        let tasks: Vec<_> =
            tasks.map(|(steps, union)| (steps, union, take(&mut rest, steps.len()))).collect();
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

    /// Puts pairs in order, and those last that are to be refitted: twice the digits are too few, or cost more.
    fn plan(&self, steps: &mut [Visited], pool: &Pool<'_>) -> Result<(), Error> {
        steps.sort_unstable_by_key(|visited| (visited.scheme, visited.step));
        let (groups, others) = self.groups(steps, pool)?;
        let columns = self.nested.factor.rank as f64;
        for group in &groups {
            let sets = group.sets.clone().filter(|&k| others[k]).count();
            let cheap = group.cost < TWICE_THE_DIGITS * columns * sets as f64;
            steps[group.sets.clone()].iter_mut().for_each(|v| v.refit = cheap || v.least < CERTAIN_LOSS);
        }
        steps.sort_unstable_by_key(|visited| (visited.refit, visited.scheme, visited.step));
        Ok(())
    }

    /// Neighbours that are best refitted together; and by pair, whether it holds out others than the one before.
    fn groups(&self, steps: &[Visited], pool: &Pool<'_>) -> Result<(Vec<Group>, Vec<bool>), Error> {
        let factor = &self.nested.factor;
        let members = |visited: &Visited| {
            pool.proceed()?;
            let mut members = self.ground.members(visited.scheme, visited.pair);
            members.sort_unstable();
            Ok(members)
        };
        let members = steps.iter().map(members).collect::<Result<Vec<_>, Error>>()?;
        let others = (0..steps.len()).map(|k| k == 0 || members[k] != members[k - 1]).collect();
        let shape = (factor.problem_rows(), factor.coordinates() + factor.responses);
        Ok((groups(&members, self.ground.rows.len(), shape), others))
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
        let solved = match (self.move_to_pair(!visited.refit), self.solved) {
            (false, Some(solved)) => solved,
            _ => self.factor(visited, pool)?,
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

    /// Factors the set at hand, or its training rows.
    fn factor(&mut self, visited: Visited, pool: &Pool<'_>) -> Result<Solved, Error> {
        let models = self.models;
        let least = if visited.refit { 0.0 } else { self.double_double() };
        if least >= DOUBLE_DOUBLE_MIN_EIGENVALUE {
            if least > models.ground.factor.certain_least() {
                return Ok(Solved::TwiceTheDigits(models.cuts.len()));
            }
            match self.curve.cut(models, &self.factor.upper(), pool) {
                Outcome::All => return Ok(Solved::TwiceTheDigits(models.cuts.len())),
                Outcome::Leading(defined) => return Ok(Solved::TwiceTheDigits(defined)),
                Outcome::Close => pool.proceed()?,
            }
        }
        let Self { work, refit, problem, .. } = self;
        let factor = models.ground.factor;
        // Plain arithmetic knows lambda_min(M) to about 1e-13.
        if visited.least > factor.certain_least().max(100.0 * DOUBLE_DOUBLE_MIN_EIGENVALUE) {
            refit.reduce(factor, problem, pool, &work.rows)?;
            return Ok(Solved::Refitted(factor.rank));
        }
        Ok(Solved::Refitted(refit.reduce_leading(factor, problem, pool, &work.rows)?))
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
    use crate::sets::Sets;
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

    /// What is lost to twice the digits, and what costs less so: neighbours of a small problem that share their rows.
    #[test]
    fn pairs_are_refitted_where_they_must_or_where_that_is_cheaper() {
        for (rows, cheap) in [(120, true), (2000, false)] {
            let example = Example::new(rows, 60, 1);
            let (problem, alone) = (example.problem(), singletons(rows));
            let nested = Nested::new(&problem, &pool(1)).unwrap();
            let held: Sets = (0..8).map(|i| (i..i + 5).collect::<Vec<usize>>()).collect();
            let validated: Sets = (0..8).map(|i| vec![i]).collect();
            let schemes = [Scheme { held: Held::Sets(&held), validated: &validated, order: None }];
            let ground = Ground { factor: &nested.factor, schemes: &schemes, rows: &alone, hat: None };
            let models = AllModels { ground: &ground, nested: &nested, cuts: &[60] };
            let visited = |step: usize| {
                let least = if step == 2 { 0.0 } else { 1e-9 };
                Visited { scheme: 0, step, pair: step, least, refit: false }
            };
            let mut steps: Vec<Visited> = (0..8).rev().map(visited).collect();
            models.plan(&mut steps, &pool(1)).unwrap();
            let found: Vec<(usize, bool)> =
                steps.iter().map(|visited| (visited.step, visited.refit)).collect();
            let order = if cheap { [0, 1, 2, 3, 4, 5, 6, 7] } else { [0, 1, 3, 4, 5, 6, 7, 2] };
            assert_eq!(found, order.map(|step| (step, cheap || step == 2)));
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
            let visited = Visited { scheme: 0, step: pair, pair, least: 1e-10, refit: false };
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
        start(&mut rescue);
        rescue.solved = None;
        let visited = Visited { scheme: 0, step: 0, pair: 0, least: 0.0, refit: true };
        assert_eq!(rescue.solve(visited, &pool(1)), Ok(5));
        assert!(matches!(rescue.solved, Some(Solved::Refitted(5))));
        assert_close(&rescue.curve.squares, &refitted(&example, held.get(0), validated.get(0)), 1e-11);
    }
}
