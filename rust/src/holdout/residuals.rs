//! Prediction residuals of held-out pairs, equation (6): `e_(K) = (I - H_KK)^-1 e_K`, for the validated rows alone.
//!
//! With q held-out rows and rank p, a pair is solved in the smaller of two spaces. The *dual* factors
//! `I - Q_K Q_K^T` (q x q), see `holdout::dual`. The *primal* uses `e_(T) = e_T + Q_T M^-1 Q_K^T e_K` with
//! `M = I - Q_K^T Q_K` (p x p), which neighbouring pairs share, see `holdout::walk`. Both are a factorisation by
//! [`Bordered`](crate::holdout::kernel::Bordered). A smallest eigenvalue near zero says that the training rows barely
//! determine the model: see [`crate::holdout::rescue`].

use pulp::{Arch, Simd, WithSimd};

use crate::error::Error;
use crate::fit::factor::{Factor, Problem};
use crate::fit::linalg::dot;
use crate::holdout::gram::touch;
use crate::holdout::hat::Hat;
use crate::holdout::plan::{self, Portion, costs, lead};
use crate::holdout::probes::PROBES;
use crate::holdout::scheme::{Scheme, check_indices};
use crate::holdout::walk::{Ground, Question, Visit, Workspace, walk};
use crate::pool::Pool;
use crate::sets::Sets;

/// Validated rows that ride along as border rows, instead of a back substitution for all unknowns.
pub(super) const MOST_CARRIED: usize = 4;

/// Rows that are fetched together.
const BATCH: usize = 64;

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

/// Predictions of every pair, scheme after scheme.
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

/// What a row that is held out of a refit takes beside the arithmetic, in multiply-adds: sets are sorted, compared, joined.
const MEMBER: f64 = 100.0;

/// Pairs after the walk: those that the closed form solved, and those that are too close to rank loss for it.
pub struct Walked<'a> {
    ground: Ground<'a>,
    places: Places,
    residuals: Vec<f64>,
    status: Vec<Option<Status>>,
}

impl Factor {
    /// Predicts the validated rows of every pair with its held-out rows left out of the fit. `problem` is the one that
    /// was factored: pairs close to rank loss go back to it. `rows` are those of each datum.
    pub fn predict(
        &self,
        problem: &Problem<'_>,
        schemes: &[Scheme<'_>],
        rows: &Sets,
        pool: &Pool<'_>,
    ) -> Result<Predictions, Error> {
        self.walk(schemes, rows, pool)?.finish(problem, pool)
    }

    /// The multiply-adds of a refit, at most, without most of the rows.
    pub(crate) fn refit_cost(&self) -> f64 {
        let &Self { rows, columns, responses, total_rows, .. } = self;
        2.0 * total_rows as f64 * ((columns + responses) as f64).powi(2) + MEMBER * rows as f64
    }

    /// The part of `predict` that needs no problem.
    pub fn walk<'a>(
        &'a self,
        schemes: &'a [Scheme<'a>],
        rows: &'a Sets<'a>,
        pool: &Pool<'_>,
    ) -> Result<Walked<'a>, Error> {
        check_indices(rows, self.rows)?;
        schemes.iter().try_for_each(|scheme| scheme.check(rows))?;
        let chains = plan::chains(schemes);
        let mut ground = Ground { factor: self, schemes, rows, hat: None };
        if plan::hat_pays(&chains, schemes, self, rows) {
            ground.hat = Some(Hat::new(self, rows, plan::visits(&chains, schemes), pool)?);
        }
        let portions = plan::portions(&chains, schemes, self, rows);
        let mut found: Vec<Residuals> = portions.iter().map(|_| Residuals::default()).collect();
        walk(&ground, &LastModel(&ground), &portions, &mut found, pool)?;
        let places = Places::new(schemes, rows);
        let count = places.offsets.len() - 1;
        let mut residuals = vec![f64::NAN; places.offsets[count] * self.responses];
        let mut status = vec![None; count];
        for (portion, part) in portions.iter().zip(found) {
            pool.proceed()?;
            places.put(portion, part, self.responses, &mut residuals, &mut status);
        }
        Ok(Walked { ground, places, residuals, status })
    }
}

impl Walked<'_> {
    /// The multiply-adds of `finish`, at most: those of as many refits as there are pairs left.
    pub fn finish_cost(&self) -> f64 {
        let left = self.status.iter().filter(|status| status.is_none()).count();
        left as f64 * self.ground.factor.refit_cost()
    }

    /// Solves the pairs that are left, with the problem that was factored.
    pub fn finish(self, problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Predictions, Error> {
        let Self { ground, places, mut residuals, mut status } = self;
        ground.factor.rescue(problem, &ground, &places, &mut residuals, &mut status, pool)?;
        let status = status.into_iter().map(|s| s.unwrap_or(Status::Undefined)).collect();
        let mut listed = Vec::with_capacity(places.offsets.last().copied().unwrap_or(0));
        for &datum in ground.schemes.iter().flat_map(|scheme| scheme.validated.items.iter()) {
            listed.extend_from_slice(ground.rows.get(datum));
        }
        Ok(Predictions { residuals, rows: listed, offsets: places.offsets, status })
    }
}

/// Where the results of every pair go.
pub(super) struct Places {
    /// Pairs before each scheme; one more than the schemes.
    pub(super) firsts: Vec<usize>,
    /// Validated rows before each pair; one more than the pairs.
    pub(super) offsets: Vec<usize>,
}

impl Places {
    fn new(schemes: &[Scheme<'_>], rows: &Sets) -> Self {
        let count: usize = schemes.iter().map(|scheme| scheme.validated.len()).sum();
        let (mut firsts, mut offsets) = (vec![0], Vec::with_capacity(count + 1));
        let mut end = 0;
        offsets.push(end);
        for scheme in schemes {
            for pair in 0..scheme.validated.len() {
                end += rows.total(scheme.validated.get(pair));
                offsets.push(end);
            }
            firsts.push(offsets.len() - 1);
        }
        Self { firsts, offsets }
    }

    /// Puts what a portion found in the order of the pairs.
    fn put(
        &self,
        portion: &Portion<'_>,
        found: Residuals,
        responses: usize,
        residuals: &mut [f64],
        status: &mut [Option<Status>],
    ) {
        let visits = portion.steps.clone().map(|step| portion.chain.pair(step));
        let pairs = visits.flat_map(|pair| portion.chain.schemes.iter().map(move |&s| self.firsts[s] + pair));
        let mut values = &found.values[..];
        for (pair, found) in pairs.zip(found.status) {
            let place = self.offsets[pair] * responses..self.offsets[pair + 1] * responses;
            let (mine, rest) = values.split_at(place.len());
            residuals[place].copy_from_slice(mine);
            values = rest;
            status[pair] = found;
        }
    }
}

/// The prediction residuals of the model of all columns.
struct LastModel<'a>(&'a Ground<'a>);

/// Residuals and status of pairs, in the order of the walk: the pairs of a step one after another.
#[derive(Default)]
struct Residuals {
    values: Vec<f64>,
    status: Vec<Option<Status>>,
}

impl Residuals {
    /// Accepts the solution of the k-th of the last `pairs` pairs, unless it is too close to rank loss.
    fn accept(&mut self, factor: &Factor, work: &Workspace, (k, pairs): (usize, usize), least: f64) {
        let (out, status) = self.slot(factor, work, (k, pairs));
        if least >= factor.closed_form_least() && !factor.outgrown(out, least) {
            unweight(factor, &work.rows[..work.validated], out);
            *status = Some(Status::Closed);
        }
    }

    fn slot(
        &mut self,
        factor: &Factor,
        work: &Workspace,
        (k, pairs): (usize, usize),
    ) -> (&mut [f64], &mut Option<Status>) {
        let block = work.validated * factor.responses;
        let end = self.values.len() - (pairs - 1 - k) * block;
        let last = self.status.len() - (pairs - k);
        (&mut self.values[end - block..end], &mut self.status[last])
    }
}

impl LastModel<'_> {
    /// The row that a pair holds out and validates, if it is a single one.
    fn lone_row(&self, scheme: &Scheme<'_>, pair: usize) -> Option<usize> {
        match (scheme.held.listed()?.get(pair), scheme.validated.get(pair)) {
            (&[datum], &[validated]) if datum == validated => match *self.0.rows.get(datum) {
                [row] => Some(row),
                _ => None,
            },
            _ => None,
        }
    }
}

/// The residual of a row that is held out alone, equation (3), and the eigenvalue of its M.
fn leave_out(factor: &Factor, row: usize, out: &mut [f64]) -> f64 {
    let least = 1.0 - factor.leverage[row];
    out.iter_mut().zip(factor.residual_row(row)).for_each(|(out, e)| *out = e / least);
    least
}

impl Question for LastModel<'_> {
    type Answer = Residuals;

    fn at_once(&self, portion: &Portion<'_>, answer: &mut Residuals) -> bool {
        let Ground { factor, schemes, .. } = *self.0;
        let [s] = portion.chain.schemes[..] else { return false };
        if factor.rank == factor.total_rows {
            return false;
        }
        let (count, responses, required) =
            (portion.steps.len(), factor.responses, factor.closed_form_least());
        let mut values = vec![f64::NAN; count * responses];
        let mut status = vec![None; count];
        for (k, step) in portion.steps.clone().enumerate() {
            let Some(row) = self.lone_row(&schemes[s], portion.chain.pair(step)) else { return false };
            let out = &mut values[k * responses..(k + 1) * responses];
            let least = leave_out(factor, row, out);
            if least >= required && !factor.outgrown(out, least) {
                status[k] = Some(Status::Closed);
            }
            unweight(factor, &[row], out);
        }
        *answer = Residuals { values, status };
        true
    }

    fn together(
        &self,
        work: &mut Workspace,
        at: Visit<'_>,
        order: &[usize],
        answer: &mut Residuals,
    ) -> usize {
        let Ground { factor, rows, ref hat, .. } = *self.0;
        let (pairs, validated) = (at.chain.schemes.len(), self.0.validated(at));
        let block = rows.total(validated) * factor.responses;
        answer.values.resize(answer.values.len() + pairs * block, f64::NAN);
        answer.status.resize(answer.status.len() + pairs, None);
        if pairs == 1 || block > MOST_CARRIED * factor.responses {
            return 0;
        }
        let sizes: Vec<f64> = order.iter().map(|&k| rows.total(&work.members[k]) as f64).collect();
        let count = lead(&sizes, at.chain.order.is_some(), factor.rank, hat.is_some()).0;
        let order = &order[..count];
        if count < 2 || !work.list(self.0, validated, order) {
            return 0;
        }
        let ends = std::mem::take(&mut work.ends);
        let possible = ends.partition_point(|&q| factor.rank + q <= factor.total_rows);
        let mut found = vec![f64::NAN; possible * block];
        let solved = possible == 0 || work.dual(factor, hat.as_ref(), &ends[..possible], &mut found);
        work.ends = ends;
        if !solved {
            return 0;
        }
        for (k, &pair) in order.iter().enumerate() {
            let (out, status) = answer.slot(factor, work, (pair, pairs));
            if k < possible {
                out.copy_from_slice(&found[k * block..(k + 1) * block]);
                answer.accept(factor, work, (pair, pairs), work.least[k]);
            } else {
                *status = Some(Status::Undefined);
            }
        }
        count
    }

    fn dual(&self, work: &mut Workspace, at: Visit<'_>, primal: f64, answer: &mut Residuals) -> bool {
        let (factor, hat, q) = (self.0.factor, self.0.hat.as_ref(), work.rows.len());
        let place = (at.k, at.chain.schemes.len());
        let (out, status) = answer.slot(factor, work, place);
        if factor.rank + q > factor.total_rows {
            *status = Some(Status::Undefined);
            return true;
        }
        let least = match q {
            0 => f64::INFINITY,
            1 => leave_out(factor, work.rows[0], out),
            2 => work.unrolled::<2>(factor, out),
            3 => work.unrolled::<3>(factor, out),
            q => {
                if costs(q as f64, 0.0, factor.rank, hat.is_some()).0 > primal {
                    return false;
                }
                if work.dual(factor, hat, &[q], out) { work.least[0] } else { 0.0 }
            }
        };
        answer.accept(factor, work, place, least);
        true
    }

    fn primal(&self, work: &mut Workspace, at: Visit<'_>, _: &Pool<'_>, answer: &mut Residuals) {
        let factor = self.0.factor;
        let responses = factor.responses;
        let validated = work.validated;
        let known = work.known_least(at.k);
        let riding = if known.is_none() && validated <= MOST_CARRIED { validated } else { 0 };
        let least = known.unwrap_or_else(|| work.factor_primal(factor, at.k, riding));
        if least < factor.closed_form_least() {
            return;
        }
        let place = (at.k, at.chain.schemes.len());
        let out = answer.slot(factor, work, place).0;
        for c in 0..responses {
            let rows = work.rows[..validated].iter().zip(out.iter_mut().skip(c).step_by(responses));
            // The border came out as y = -L^-1 Q_K^T e_K, and rows that rode along as u = L^-1 q.
            if riding == validated {
                for (k, (&row, out)) in rows.enumerate() {
                    let change: f64 = work.system.forward_products(c, responses + PROBES + k).sum();
                    *out = factor.residual_row(row)[c] - change;
                }
            } else {
                let z = work.system.back_solve(c, 0);
                predict_rows(factor, &work.rows[..validated], z, c, out);
            }
        }
        answer.accept(factor, work, place, least);
    }
}

/// Residuals of response c of rows, given the change `z` of its coefficients in the basis.
fn predict_rows(factor: &Factor, rows: &[usize], z: &[f64], c: usize, out: &mut [f64]) {
    for (rows, out) in rows.chunks(BATCH).zip(out.chunks_mut(BATCH * factor.responses)) {
        touch(rows.iter().map(|&row| factor.basis_row(row)));
        Arch::new().dispatch(Predict { factor, rows, z, c, out });
    }
}

struct Predict<'a> {
    factor: &'a Factor,
    rows: &'a [usize],
    z: &'a [f64],
    c: usize,
    out: &'a mut [f64],
}

impl WithSimd for Predict<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { factor, rows, z, c, out } = self;
        for (&row, out) in rows.iter().zip(out.chunks_exact_mut(factor.responses)) {
            out[c] = factor.residual_row(row)[c] - dot(factor.basis_row(row), z);
        }
    }
}

/// Brings residuals of rows from weighted to plain units.
pub(super) fn unweight(factor: &Factor, rows: &[usize], out: &mut [f64]) {
    for (e, &row) in out.chunks_exact_mut(factor.responses).zip(rows) {
        e.iter_mut().for_each(|e| *e *= factor.unweight(row));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::holdout::scheme::Held;
    use crate::testing::{Example, assert_close, bits, pool, sets, singletons, windows};

    fn predict(
        example: &Example,
        schemes: &[(&Sets, &Sets, Option<&[usize]>)],
        rows: &Sets,
        threads: usize,
    ) -> Predictions {
        let schemes: Vec<Scheme<'_>> = schemes
            .iter()
            .map(|&(held, validated, order)| Scheme { held: Held::Sets(held), validated, order })
            .collect();
        example.factor().predict(&example.problem(), &schemes, rows, &pool(threads)).unwrap()
    }

    fn rows_of(data: &[usize], rows: &Sets) -> Vec<usize> {
        data.iter().flat_map(|&datum| rows.get(datum)).copied().collect()
    }

    /// Of a column that three rows alone have, two of them held out leave the third; without all three it is lost.
    #[test]
    fn what_is_left_to_finish_costs_as_many_refits() {
        let mut example = Example::new(40, 4, 1);
        example.penalty.clear();
        for (i, row) in example.design.chunks_exact_mut(4).enumerate() {
            row[3] = if i < 3 { 1.0 } else { 0.0 };
        }
        let (factor, rows) = (example.factor(), singletons(40));
        for (held, left) in [(vec![vec![0], vec![7, 8]], 0.0), (vec![vec![0, 1, 2], vec![9]], 1.0)] {
            let held: Sets = held.into_iter().collect();
            let schemes = [Scheme { held: Held::Sets(&held), validated: &held, order: None }];
            let walked = factor.walk(&schemes, &rows, &pool(1)).unwrap();
            assert_eq!(walked.finish_cost(), left * 40.0 * (2.0 * 25.0 + MEMBER));
            let status = walked.finish(&example.problem(), &pool(1)).unwrap().status;
            assert_eq!(status[0] == Status::Undefined, left > 0.0);
            assert_eq!(status[1], Status::Closed);
        }
    }

    /// One to three rows, small sets and large ones, some of them validated or many, alone and in chains.
    #[test]
    fn predictions_are_plain_refits() {
        let example = Example::new(66, 5, 2);
        // Data of one row, of two and of three.
        let rows: Sets = (0..33).map(|i| [vec![i], vec![33 + i], vec![33 + i, i]][i % 3].clone()).collect();
        let (alone, order) = (singletons(33), (0..33).collect::<Vec<_>>());
        let held = [0, 1, 4, 9].map(|reach| windows(33, reach));
        let many = sets([&[3, 4, 5, 6, 7, 8, 20, 22]]);
        for order in [None, Some(&order[..])] {
            let mut schemes: Vec<_> = held.iter().map(|held| (held, &alone, order)).collect();
            schemes.extend([(&held[1], &held[1], None), (&many, &many, None)]);
            let found = predict(&example, &schemes, &rows, 2);
            let mut values = &found.residuals[..];
            let mut listed = Vec::new();
            for (held, validated, _) in schemes {
                for pair in 0..held.len() {
                    let some = rows_of(validated.get(pair), &rows);
                    let expected = example.refit(&rows_of(held.get(pair), &rows), &some);
                    let (mine, rest) = values.split_at(expected.len());
                    assert_close(mine, &expected, 1e-12);
                    (values, listed) = (rest, [listed, some].concat());
                }
            }
            assert_eq!(found.rows, listed);
            assert!(found.status.iter().all(|&status| status == Status::Closed));
            assert_eq!(
                (found.offsets.len(), found.offsets.last()),
                (found.status.len() + 1, Some(&listed.len()))
            );
        }
    }

    #[test]
    fn balls_of_which_now_one_and_now_the_other_is_larger_are_solved_together() {
        let example = Example::new(66, 30, 2);
        let (rows, alone): (Sets, _) = ((0..33).map(|i| vec![i, 33 + i]).collect(), singletons(33));
        let changing: Sets = (0..33).map(|i| windows(33, [1, 3][i % 2]).get(i).to_vec()).collect();
        let steady = windows(33, 2);
        let found = predict(&example, &[(&changing, &alone, None), (&steady, &alone, None)], &rows, 2);
        let expected: Vec<f64> = [&changing, &steady]
            .iter()
            .flat_map(|held| (0..33).map(move |i| (held.get(i), i)))
            .flat_map(|(held, i)| example.refit(&rows_of(held, &rows), rows.get(i)))
            .collect();
        assert_close(&found.residuals, &expected, 1e-11);
        let factor = example.factor();
        let schemes = [&changing, &steady].map(|held| Scheme {
            held: Held::Sets(held),
            validated: &alone,
            order: None,
        });
        let ground = Ground { factor: &factor, schemes: &schemes, rows: &rows, hat: None };
        let (chains, mut work) = (plan::chains(&schemes), Workspace::new(33));
        for step in [10, 11] {
            work.members = chains[0].schemes.iter().map(|&s| ground.members(s, step)).collect();
            let first = usize::from(work.members[1].len() < work.members[0].len());
            let at = Visit { chain: &chains[0], step, k: 0 };
            let mut together = |order: [usize; 2]| {
                LastModel(&ground).together(&mut work, at, &order, &mut Residuals::default())
            };
            assert_eq!([together([first, 1 - first]), together([1 - first, first])], [2, 0]);
        }
    }

    /// The last column is seen by the last two rows alone; three rows are too few; nothing held out loses nothing.
    #[test]
    fn without_rank_there_is_no_prediction() {
        let example = Example::nearly_lost(12, 4, 0.0);
        let some: Vec<usize> = (0..9).collect();
        let held = sets([&[10, 11], &[11], &some, &[], &[0, 1, 2, 10, 11]]);
        let validated = sets([&[10], &[11], &[0, 5], &[], &[1]]);
        let found = predict(&example, &[(&held, &validated, None)], &singletons(12), 1);
        let expected =
            [Status::Undefined, Status::Closed, Status::Undefined, Status::Closed, Status::Undefined];
        assert_eq!(found.status, expected);
        let refits: Vec<f64> =
            (0..5).flat_map(|pair| example.refit(held.get(pair), validated.get(pair))).collect();
        assert_close(&found.residuals, &refits, 1e-12);
    }

    /// In an order, of weights, and of a row that the last column needs, nearly or wholly; also where all are.
    #[test]
    fn rows_left_out_one_by_one_are_plain_refits() {
        let (alone, order) = (singletons(12), [5, 11, 0, 1, 2, 3, 4, 6, 7, 8, 9, 10]);
        for (fraction, needed) in [(1.0, Status::Closed), (1e-4, Status::Refined), (0.0, Status::Undefined)] {
            let mut example = Example::nearly_lost(12, 4, fraction);
            example.design[4 * 10 + 3] *= fraction;
            for order in [None, Some(&order[..])] {
                let found = predict(&example, &[(&alone, &alone, order)], &alone, 1);
                for (i, status) in found.status.iter().enumerate() {
                    assert_eq!(
                        *status,
                        if i == 11 { needed } else { Status::Closed },
                        "row {i} at {fraction}"
                    );
                    assert_close(&found.residuals[2 * i..2 * i + 2], &example.refit(&[i], &[i]), 1e-11);
                }
                assert_eq!(found.rows, (0..12).collect::<Vec<_>>());
            }
        }
        let mut square = Example::new(4, 4, 1);
        square.penalty.clear();
        let alone = singletons(4);
        let found = predict(&square, &[(&alone, &alone, None)], &alone, 1);
        assert_eq!(found.status, [Status::Undefined; 4]);
    }

    /// Pairs that validate nothing, or data of two rows, are not rows left out.
    #[test]
    fn only_lone_rows_that_are_validated_are_answered_at_once() {
        let (factor, rows) = (Example::new(6, 2, 1).factor(), sets([&[0, 1], &[2], &[3], &[4], &[5]]));
        let answered = |held: &Sets, validated: &Sets| {
            let schemes = [Scheme { held: Held::Sets(held), validated, order: None }];
            let ground = Ground { factor: &factor, schemes: &schemes, rows: &rows, hat: None };
            let chains = plan::chains(&schemes);
            let portions = plan::portions(&chains, &schemes, &factor, &rows);
            LastModel(&ground).at_once(&portions[0], &mut Residuals::default())
        };
        let some = sets([&[1], &[4]]);
        assert!(answered(&some, &some));
        for held in [sets([&[1], &[0]]), sets([&[1], &[2, 3]]), sets([&[1], &[]])] {
            assert!(!answered(&held, &held));
        }
        assert!(!answered(&some, &sets([&[1], &[]])));
    }

    #[test]
    fn no_bit_depends_on_threads() {
        let example = Example::nearly_lost(300, 9, 5e-5);
        let (alone, order) = (singletons(300), (0..300).rev().collect::<Vec<_>>());
        let held = [2, 9, 30].map(|reach| windows(300, reach));
        let schemes = held.each_ref().map(|held| (held, &alone, Some(&order[..])));
        let [one, four] = [1, 4].map(|threads| predict(&example, &schemes, &alone, threads));
        assert_eq!(bits(&one.residuals), bits(&four.residuals));
        assert_eq!(one.status, four.status);
        assert!(one.status.contains(&Status::Refined) && one.status.contains(&Status::Closed));
    }
}
