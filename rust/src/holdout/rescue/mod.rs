//! Pairs close to rank loss, where the closed form loses digits: refined, solved with twice the digits, or refitted.

pub mod double_double;
pub(crate) mod refine;
pub mod refit;
pub(super) mod shared;

use std::collections::HashMap;
use std::sync::OnceLock;

use self::refine::{Inverse, NearSingular, Refiner, refinable};
use self::refit::Refit;
use self::shared::groups;
use crate::error::Error;
use crate::fit::factor::{Factor, Problem};
use crate::holdout::plan::costs;
use crate::holdout::probes::least_eigenvalue;
use crate::holdout::residuals::{Places, Status, unweight};
use crate::holdout::walk::{Ground, Workspace};
use crate::pool::{Pool, take};

/// Sets close to rank loss that share a pass over the basis, and how many numbers their systems may have.
const BATCH_PAIRS: usize = 16;
const BATCH_NUMBERS: usize = 4_000_000;

/// A pair that the closed form did not solve, its validated rows, and where its results go.
pub(super) struct Left<'a> {
    scheme: usize,
    pair: usize,
    rows: Vec<usize>,
    residuals: &'a mut [f64],
    status: &'a mut Option<Status>,
}

impl Left<'_> {
    fn accept(&mut self, factor: &Factor, status: Status) {
        unweight(factor, &self.rows, self.residuals);
        *self.status = Some(status);
    }
}

impl Factor {
    /// Solves the pairs that the closed form did not, those together that hold out the same: refines sets in small batches,
    /// and refits those for which that is not enough, neighbours together where these share most of their training rows.
    pub(super) fn rescue(
        &self,
        problem: &Problem<'_>,
        ground: &Ground<'_>,
        places: &Places,
        residuals: &mut [f64],
        status: &mut [Option<Status>],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        if status.iter().all(Option::is_some) {
            return Ok(());
        }
        let mut sets = grouped(ground, places.left(ground, residuals, status), pool)?;
        let failure = OnceLock::new();
        let batch = batch(ground);
        let workspace = || Workspace::new(ground.rows.len());
        pool.run(
            sets.chunks_mut(batch),
            || (Refiner::default(), (0..batch).map(|_| workspace()).collect::<Vec<_>>()),
            |(refining, workspaces), sets| {
                // Once called off, nobody reads the result.
                let _ = self.refine(ground, (refining, workspaces), sets, pool);
            },
        )?;
        sets.retain(|pairs| pairs[0].status.is_none());
        along_the_way(ground, &mut sets);
        let members = |pairs: &Vec<Left<'_>>| {
            pool.proceed()?;
            Ok(ground.members(pairs[0].scheme, pairs[0].pair))
        };
        let members = sets.iter().map(members).collect::<Result<Vec<_>, Error>>()?;
        let groups =
            groups(&members, ground.rows.len(), (self.problem_rows(), self.coordinates() + self.responses));
        let mut rest = &mut sets[..];
        let tasks: Vec<_> = groups.iter().map(|group| (group, take(&mut rest, group.sets.len()))).collect();
        pool.run(tasks.into_iter(), Refit::default, |refit, (group, sets)| {
            let refitted = refit.share(self, problem, pool, &ground.rows_of(&group.union)).and_then(|()| {
                sets.iter_mut().zip(&members[group.sets.clone()]).try_for_each(|(pairs, members)| {
                    self.refit(problem, refit, &ground.rows_of(members), pairs, pool)
                })
            });
            if let Err(error) = refitted {
                let _ = failure.set(error);
            }
        })?;
        failure.into_inner().map_or(Ok(()), Err)
    }

    /// Refines those of a few sets that can be refined.
    fn refine(
        &self,
        ground: &Ground<'_>,
        (refining, workspaces): (&mut Refiner, &mut [Workspace]),
        sets: &mut [Vec<Left<'_>>],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        let mut near_singular = Vec::with_capacity(sets.len());
        for (workspace, pairs) in workspaces.iter_mut().zip(sets) {
            workspace.list_pair(ground, pairs[0].scheme, pairs[0].pair);
            let set = workspace.near_singular(ground, pairs);
            if refinable(self, set.least) {
                near_singular.push(set);
            }
        }
        let good = refining.refine(self, pool, &mut near_singular)?;
        for set in near_singular.iter_mut().zip(good).filter_map(|(set, good)| good.then_some(set)) {
            set.pairs.iter_mut().for_each(|pair| pair.accept(self, Status::Refined));
        }
        Ok(())
    }

    /// Refits without the rows that these pairs hold out.
    fn refit(
        &self,
        problem: &Problem<'_>,
        refit: &mut Refit,
        rows: &[usize],
        pairs: &mut [Left<'_>],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        let defined = refit.refit(self, problem, pool, rows)?;
        for pair in pairs {
            if defined {
                refit.residuals(self, problem, &pair.rows, pair.residuals)?;
                pair.accept(self, Status::Refitted);
            } else {
                pair.residuals.fill(f64::NAN);
                *pair.status = Some(Status::Undefined);
            }
        }
        Ok(())
    }
}

/// Those together that hold out the same data.
fn grouped<'a>(
    ground: &Ground<'_>,
    left: Vec<Left<'a>>,
    pool: &Pool<'_>,
) -> Result<Vec<Vec<Left<'a>>>, Error> {
    let mut sets: Vec<Vec<Left<'a>>> = Vec::new();
    let mut known: HashMap<Vec<usize>, usize> = HashMap::new();
    for pair in left {
        pool.proceed()?;
        let mut held = ground.members(pair.scheme, pair.pair);
        held.sort_unstable();
        let set = *known.entry(held).or_insert(sets.len());
        match sets.get_mut(set) {
            Some(pairs) => pairs.push(pair),
            None => sets.push(vec![pair]),
        }
    }
    Ok(sets)
}

/// Puts sets in the order in which neighbours come one after another, where their scheme knows one.
fn along_the_way(ground: &Ground<'_>, sets: &mut [Vec<Left<'_>>]) {
    let steps: Vec<Vec<usize>> = ground
        .schemes
        .iter()
        .map(|scheme| {
            let mut steps: Vec<usize> = (0..scheme.validated.len()).collect();
            scheme.order.into_iter().flatten().enumerate().for_each(|(step, &pair)| steps[pair] = step);
            steps
        })
        .collect();
    sets.sort_by_key(|pairs| (pairs[0].scheme, steps[pairs[0].scheme][pairs[0].pair]));
}

impl Places {
    /// The pairs that have no status yet.
    fn left<'a>(
        &self,
        ground: &Ground<'_>,
        residuals: &'a mut [f64],
        status: &'a mut [Option<Status>],
    ) -> Vec<Left<'a>> {
        let (mut rest, mut scheme) = (residuals, 0);
        let mut left = Vec::new();
        for (place, status) in status.iter_mut().enumerate() {
            let size = (self.offsets[place + 1] - self.offsets[place]) * ground.factor.responses;
            let out = take(&mut rest, size);
            while self.firsts[scheme + 1] <= place {
                scheme += 1;
            }
            if status.is_none() {
                let pair = place - self.firsts[scheme];
                let rows = ground.rows_of(ground.schemes[scheme].validated.get(pair));
                left.push(Left { scheme, pair, rows, residuals: out, status });
            }
        }
        left
    }
}

impl Workspace {
    /// The set at hand with its factored system, for refinement.
    fn near_singular<'a, 'b>(
        &'a mut self,
        ground: &Ground<'_>,
        pairs: &'a mut [Left<'b>],
    ) -> NearSingular<'a, 'b> {
        let Ground { factor, ref hat, .. } = *ground;
        let q = self.rows.len();
        let (dual, primal) = costs(q as f64, q as f64, factor.rank, hat.is_some());
        let least = if dual <= primal {
            self.fill_dual(factor, hat.as_ref(), q, 0);
            least_eigenvalue(&mut self.system, q, factor.responses)
        } else {
            self.fresh_gram(factor);
            self.factor_primal(factor, 0, 0)
        };
        let Self { system, rows, .. } = self;
        let inverse = if dual <= primal { Inverse::Dual(system, rows) } else { Inverse::Primal(system) };
        NearSingular { inverse, least, rows, pairs }
    }
}

/// How many sets are refined at once.
fn batch(ground: &Ground<'_>) -> usize {
    let Ground { factor, ref hat, rows, schemes } = *ground;
    let largest = schemes.iter().map(|scheme| scheme.held.largest()).max().unwrap_or(0);
    let q = largest * factor.rows.div_ceil(rows.len().max(1));
    let (dual, primal) = costs(q as f64, q as f64, factor.rank, hat.is_some());
    let terms = if hat.is_some() { 0 } else { factor.rank };
    let system = if dual <= primal { q * (q + terms) } else { factor.rank * factor.rank };
    (BATCH_NUMBERS / system.max(1)).clamp(1, BATCH_PAIRS)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::holdout::residuals::Predictions;
    use crate::holdout::scheme::{Held, Scheme};
    use crate::sets::Sets;
    use crate::testing::{Example, assert_close, pool, sets, singletons, windows};

    fn predict(example: &Example, pairs: &[(&Sets, &Sets)]) -> Predictions {
        let scheme = |&(held, validated)| Scheme { held: Held::Sets(held), validated, order: None };
        let (schemes, rows) = (pairs.iter().map(scheme).collect::<Vec<_>>(), singletons(example.rows));
        example.factor().predict(&example.problem(), &schemes, &rows, &pool(2)).unwrap()
    }

    /// The closed form would have lost the digits that the fraction has, twice over.
    #[test]
    fn pairs_near_rank_loss_are_plain_refits() {
        let some: Vec<usize> = (10..40).collect();
        let held = sets([&[38, 39], &[3, 38, 39], &some]);
        let validated = sets([&[39], &[38, 3], &[38, 12, 39]]);
        let other = sets([&[39, 7, 38]]);
        let ways = [
            (1e-1, Status::Closed, 1e-13),
            (2e-4, Status::Refined, 1e-11),
            (1e-7, Status::Refitted, 1e-8),
            (0.0, Status::Undefined, 0.0),
        ];
        for (fraction, status, tolerance) in ways {
            let example = Example::nearly_lost(40, 5, fraction);
            let found = predict(&example, &[(&held, &validated), (&other, &other)]);
            assert_eq!(found.status, [status; 4]);
            for pair in 0..4 {
                let values = &found.residuals[2 * found.offsets[pair]..2 * found.offsets[pair + 1]];
                let (held, validated, k) =
                    if pair < 3 { (&held, &validated, pair) } else { (&other, &other, 0) };
                assert_close(values, &example.refit(held.get(k), validated.get(k)), tolerance);
            }
        }
    }

    /// Far enough from rank loss for predictions as large as the responses, but not for larger ones; a pair of rows, and one
    /// alone.
    #[test]
    fn predictions_much_larger_than_responses_are_refined() {
        for (first, held) in [(38, sets([&[38, 39]])), (39, sets([&[39]]))] {
            let mut example = Example::nearly_lost(40, 5, 5e-4);
            example.design[38 * 5 + 4] *= if first == 39 { 5e-4 } else { 1.0 };
            for (training, status, tolerance) in
                [(1.0, Status::Refined, 1e-12), (1e-3, Status::Closed, 1e-10)]
            {
                example.responses.iter_mut().take(2 * first).for_each(|b| *b *= training);
                let found = predict(&example, &[(&held, &held)]);
                assert_eq!(found.status, [status]);
                assert_close(&found.residuals, &example.refit(held.get(0), held.get(0)), tolerance);
            }
        }
    }

    /// Whatever they validate, and in whatever order they list it; more sets than are refined together.
    #[test]
    fn pairs_that_hold_out_the_same_are_solved_once() {
        for fraction in [1e-4, 1e-7] {
            let example = Example::nearly_lost(80, 5, fraction);
            let held: Sets =
                (0..60).map(|i| [vec![78, i / 2, 79], vec![79, 78, i / 2]][i % 2].clone()).collect();
            let validated: Sets = (0..60).map(|i| vec![[i / 2, 78][i % 2]]).collect();
            let found = predict(&example, &[(&held, &validated)]);
            for pair in 0..60 {
                let (one, some) = (sets([held.get(pair)]), sets([validated.get(pair)]));
                let alone = predict(&example, &[(&one, &some)]);
                assert_eq!(alone.status[0], found.status[pair]);
                assert_close(&found.residuals[2 * pair..2 * pair + 2], &alone.residuals, 1e-16 / fraction);
            }
            let (rows, factor) = (singletons(80), example.factor());
            let schemes = [Scheme { held: Held::Sets(&held), validated: &validated, order: None }];
            let ground = Ground { factor: &factor, schemes: &schemes, rows: &rows, hat: None };
            let places = Places { firsts: vec![0, 60], offsets: (0..=60).collect() };
            let (mut residuals, mut status) = (vec![0.0; 120], vec![None; 60]);
            status[4] = Some(Status::Closed);
            let left = places.left(&ground, &mut residuals, &mut status);
            let grouped = grouped(&ground, left, &pool(1)).unwrap();
            let pairs: Vec<Vec<usize>> =
                grouped.iter().map(|set| set.iter().map(|left| left.pair).collect()).collect();
            let expected = (0..30).map(|i| if i == 2 { vec![5] } else { vec![2 * i, 2 * i + 1] });
            assert_eq!(pairs, expected.collect::<Vec<_>>());
            assert!(grouped.iter().flatten().all(|left| left.rows == validated.get(left.pair)));
        }
    }

    /// The system at hand is the smaller one, and applies the same inverse.
    #[test]
    fn both_systems_know_how_near_rank_loss_a_set_is() {
        let example = Example::nearly_lost(60, 8, 1e-3);
        let (factor, rows) = (example.factor(), singletons(60));
        for (reach, dual) in [(2, true), (20, false)] {
            let held = windows(60, reach);
            let schemes = [Scheme { held: Held::Sets(&held), validated: &rows, order: None }];
            let ground = Ground { factor: &factor, schemes: &schemes, rows: &rows, hat: None };
            let mut work = Workspace::new(60);
            for (pair, near) in [(59, true), (20, false)] {
                work.list_pair(&ground, 0, pair);
                let set = work.near_singular(&ground, &mut []);
                assert_eq!(matches!(set.inverse, Inverse::Dual(..)), dual);
                assert_eq!(set.least < 1e-3, near);
                assert_eq!(set.rows.len(), held.get(pair).len());
            }
        }
    }

    /// The larger the systems, the fewer at once.
    #[test]
    fn systems_refined_at_once_fit_in_the_memory_meant_for_them() {
        let (mut factor, rows) = (Example::new(60, 4, 1).factor(), singletons(60));
        let held = windows(60, 20);
        let schemes = [Scheme { held: Held::Sets(&held), validated: &rows, order: None }];
        for (rank, count) in [(4, BATCH_PAIRS), (500, 16), (1000, 16), (5000, 16), (100_000, 1)] {
            factor.rank = rank;
            let found = batch(&Ground { factor: &factor, schemes: &schemes, rows: &rows, hat: None });
            let system = 41 * (41 + rank);
            assert_eq!(found, count.min((BATCH_NUMBERS / system.min(rank * rank)).max(1)));
        }
    }
}
