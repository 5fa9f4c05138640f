//! Prediction residuals of held-out pairs, equation (6): `e_(K) = (I - H_KK)^-1 e_K`, for the validated rows alone.
//!
//! With q held-out rows and rank p, a pair is solved in the smaller of two spaces. The *dual* factors
//! `I - Q_K Q_K^T` (q x q). The *primal* uses `e_(T) = e_T + Q_T M^-1 Q_K^T e_K` with `M = I - Q_K^T Q_K` (p x p). Both are one
//! call of [`Bordered`]. One to three rows are unrolled. A pivot near zero says that the training rows barely
//! determine the model: such a pair is refitted from its training rows, which decides its rank, see [`crate::holdout::rescue::refit`].
//!
//! Balls around one datum nest, and one dual factorisation serves them all: with the datum's rows first and then ring after
//! ring, a ball is a leading part of the largest, and so are its factor L and its forward solves `y = L^-1 e_K` and
//! `z = L^-1 1_T`, of which `e_(T) = z^T y`. All criteria of a sweep then cost what the widest of them does.

use std::ops::Range;
use std::slice;
use std::sync::OnceLock;

use crate::error::Error;
use crate::fit::factor::{Factor, Problem, expect_length};
use crate::fit::linalg::dot;
use crate::holdout::kernel::Bordered;
use crate::holdout::rescue::refine::{Batch, Inverse, Suspect, refinable};
use crate::holdout::rescue::refit::Refit;
use crate::holdout::visit::{CARRIED, Hat, Plan, Slot, costs};
use crate::pool::Pool;
use crate::sets::Sets;

/// Below this lambda_min(M), give or take what an estimate may miss, the closed form is not trusted with nine digits: its
/// error is about eps / lambda_min(M).
const SAFE: f64 = 2e-6;

/// Random right-hand sides that tell lambda_min; they fit in the padding of the last panel as a rule.
pub(crate) const PROBES: usize = 2;

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
                    workspace.gather(pairs, run);
                    workspace.solve(self, hat, slots);
                }
            },
        )?;
        self.rescue(problem, pairs, &plan, &mut residuals, &mut status, pool)?;
        let status = status.into_iter().map(|s| s.unwrap_or(Status::Undefined)).collect();
        let rows = (0..count).flat_map(|s| pairs.validated.get(s)).flat_map(|&d| pairs.rows.get(d)).copied();
        Ok(Predictions { residuals, rows: rows.collect(), offsets: plan.offsets, status })
    }

    /// The pairs that the closed form left: refined in small batches, and refitted where that does not do, each a task
    /// of its own, since it costs far more.
    fn rescue(
        &self,
        problem: &Problem<'_>,
        pairs: &Pairs<'_>,
        plan: &Plan,
        residuals: &mut [f64],
        status: &mut [Option<Status>],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        let mut rest = residuals;
        let mut left = Vec::new();
        for (pair, status) in status.iter_mut().enumerate() {
            let size = (plan.offsets[pair + 1] - plan.offsets[pair]) * self.responses;
            let (out, after) = rest.split_at_mut(size);
            rest = after;
            if status.is_none() {
                left.push((pair, Slot { residuals: out, status }));
            }
        }
        let failure = OnceLock::new();
        let batch = plan.batch(self.rank);
        pool.run(
            left.chunks_mut(batch),
            || (Batch::default(), (0..batch).map(|_| Workspace::default()).collect::<Vec<_>>()),
            |(refining, workspaces), batch| {
                // Once called off, nobody reads the result.
                let _ = self.refine(plan, pairs, (refining, workspaces), batch, pool);
            },
        )?;
        left.retain(|(_, slot)| slot.status.is_none());
        pool.run(
            left.into_iter(),
            || (Refit::default(), Workspace::default()),
            |(refit, workspace), (pair, slot)| {
                workspace.gather(pairs, &[pair]);
                let kept = (&workspace.rows[..], workspace.validated);
                slot.residuals.fill(f64::NAN);
                match refit.predict(self, problem, pool, kept, slot.residuals) {
                    Ok(found) => *slot.status = Some(found),
                    Err(error) => drop(failure.set(error)),
                }
                unweight(self, &workspace.rows[..workspace.validated], slot.residuals);
            },
        )?;
        failure.into_inner().map_or(Ok(()), Err)
    }

    /// Refines what can be, of a few pairs.
    fn refine(
        &self,
        plan: &Plan,
        pairs: &Pairs<'_>,
        (refining, workspaces): (&mut Batch, &mut [Workspace]),
        batch: &mut [(usize, Slot<'_>)],
        pool: &Pool<'_>,
    ) -> Result<(), Error> {
        let mut suspects = Vec::with_capacity(batch.len());
        let mut status = Vec::with_capacity(batch.len());
        for (workspace, (pair, slot)) in workspaces.iter_mut().zip(batch) {
            workspace.gather(pairs, &[*pair]);
            let suspect = workspace.suspect(self, plan.hat.as_ref(), slot.residuals);
            if refinable(self, suspect.least) {
                suspects.push(suspect);
                status.push(&mut *slot.status);
            }
        }
        let good = refining.refine(self, pool, &mut suspects)?;
        for ((status, suspect), good) in status.into_iter().zip(suspects).zip(good) {
            if good {
                unweight(self, &suspect.rows[..suspect.validated], suspect.out);
                *status = Some(Status::Refined);
            }
        }
        Ok(())
    }

    /// What the prediction residuals of each pair's validated rows vary by, in units of the noise of weighted rows:
    /// `((I - H_KK)^-1)_TT`, row-major, pair after pair; NaN where the training rows lose rank.
    pub fn spread(&self, pairs: &Pairs<'_>, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        pairs.check(self.rows)?;
        let rows_of = |pair| pairs.validated.get(pair).iter().map(|&datum| pairs.rows.get(datum).len());
        let sizes: Vec<usize> =
            (0..pairs.held.len()).map(|pair| rows_of(pair).sum::<usize>().pow(2)).collect();
        let mut blocks = vec![0.0; sizes.iter().sum()];
        pool.run(
            cut(&mut blocks, &sizes).into_iter().enumerate(),
            Workspace::default,
            |workspace, (pair, block)| {
                workspace.gather(pairs, &[pair]);
                workspace.spread(self, block);
            },
        )?;
        Ok(blocks)
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

/// Everything a thread needs to solve pairs; it soon allocates no more.
#[derive(Default)]
struct Workspace {
    system: Bordered,
    /// Held-out rows of the run at hand: the validated ones, then those that each pair holds out beyond the one before.
    rows: Vec<usize>,
    /// How many of `rows` each pair holds out.
    ends: Vec<usize>,
    /// Their places in the hat matrix.
    places: Vec<usize>,
    validated: usize,
    /// Estimates of lambda_min(M), one a pair.
    least: Vec<f64>,
}

impl Workspace {
    fn gather(&mut self, pairs: &Pairs<'_>, run: &[usize]) {
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

    /// Takes what was found, unless it is too close to rank loss.
    fn accept(&self, factor: &Factor, least: f64, slot: &mut Slot<'_>) {
        if least >= SAFE {
            unweight(factor, &self.rows[..self.validated], slot.residuals);
            *slot.status = Some(Status::Closed);
        }
    }

    /// The pair at hand, for another try.
    fn suspect<'a>(&'a mut self, factor: &Factor, hat: Option<&Hat>, out: &'a mut [f64]) -> Suspect<'a> {
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
        Suspect { inverse, least, rows, validated: *validated, out }
    }

    /// `((I - H_KK)^-1)_TT` of the pair at hand: in the dual of unit vectors, in the primal `I + Q_T M^-1 Q_T^T`.
    fn spread(&mut self, factor: &Factor, out: &mut [f64]) {
        let (q, t) = (self.rows.len(), self.validated);
        let (dual, primal) = costs(q, factor.rank, false);
        let (own, smallest) = if dual <= primal {
            self.fill_dual(factor, None, q, t);
            (0.0, self.system.factor())
        } else {
            (1.0, self.primal_factor(factor, &(0..t)))
        };
        if smallest <= 0.0 || factor.rank + q > factor.total_rows {
            out.fill(f64::NAN);
            return;
        }
        let first = factor.responses + PROBES;
        for i in 0..t {
            for j in 0..=i {
                let sum: f64 = self.system.forward_products(first + i, first + j).sum();
                let c = sum + if i == j { own } else { 0.0 };
                (out[i * t + j], out[j * t + i]) = (c, c);
            }
        }
    }

    /// `(I - H_KK) z = e_K` for one to three rows, in registers.
    fn unrolled<const N: usize>(&self, factor: &Factor, out: &mut [f64]) -> f64 {
        let q: [&[f64]; N] = std::array::from_fn(|i| factor.basis_row(self.rows[i]));
        let mut l = [[0.0; N]; N];
        // Eigenvalues are at most one, so the least is at least their product.
        let mut least = 1.0;
        for i in 0..N {
            for j in 0..=i {
                let own = if i == j { 1.0 } else { 0.0 };
                let sum: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
                let value = own - dot(q[i], q[j]) - sum;
                if i == j {
                    least *= value.max(0.0);
                }
                l[i][j] = if i == j { value.max(0.0).sqrt() } else { value / l[j][j] };
            }
        }
        for c in 0..factor.responses {
            let mut z: [f64; N] = std::array::from_fn(|i| factor.residual_row(self.rows[i])[c]);
            for i in 0..N {
                z[i] = (z[i] - (0..i).map(|k| l[i][k] * z[k]).sum::<f64>()) / l[i][i];
            }
            for i in (0..N).rev() {
                z[i] = (z[i] - (i + 1..N).map(|k| l[k][i] * z[k]).sum::<f64>()) / l[i][i];
            }
            out.iter_mut().skip(c).step_by(factor.responses).zip(z).for_each(|(e, z)| *e = z);
        }
        least
    }

    /// Solves the pairs of the first `ends` rows, each inside the next; false if the largest cannot be factored. More
    /// validated rows than ride along are those of a single pair.
    fn dual(&mut self, factor: &Factor, hat: Option<&Hat>, ends: &[usize], slots: &mut [Slot<'_>]) -> bool {
        let (q, responses) = (ends[ends.len() - 1], factor.responses);
        let carried = if self.validated <= CARRIED { self.validated } else { 0 };
        self.fill_dual(factor, hat, q, carried);
        if self.system.factor() <= 0.0 {
            return false;
        }
        self.least_eigenvalues(ends, responses);
        for c in 0..responses {
            for k in 0..carried {
                let products = self.system.forward_products(c, responses + PROBES + k);
                leading_sums(products, ends, |pair, e| slots[pair].residuals[k * responses + c] = e);
            }
            if carried < self.validated {
                let z = self.system.back_solve(c, 0);
                slots[0].residuals.iter_mut().skip(c).step_by(responses).zip(z).for_each(|(e, z)| *e = *z);
            }
        }
        for (slot, &least) in slots.iter_mut().zip(&self.least) {
            self.accept(factor, least, slot);
        }
        true
    }

    /// `I - H_KK` of the first q rows, with residuals, and unit vectors of the first `carried` rows.
    fn fill_dual(&mut self, factor: &Factor, hat: Option<&Hat>, q: usize, carried: usize) {
        let responses = factor.responses;
        let rows = &self.rows[..q];
        let border = responses + PROBES + carried;
        match hat {
            None => self.system.start(q, border, factor.rank),
            Some(hat) => {
                self.places.clear();
                self.places.extend(rows.iter().map(|&row| hat.place[row]));
                self.system.start_complement(|i| hat.line(self.places[i]), &self.places, border);
            }
        }
        set_probes(&mut self.system, q, responses);
        for (i, &row) in rows.iter().enumerate() {
            if hat.is_none() {
                self.system.set_row(i, factor.basis_row(row));
            }
            for (c, &e) in factor.residual_row(row).iter().enumerate() {
                *self.system.entry(q + c, i) = e;
            }
        }
        for k in 0..carried {
            *self.system.entry(q + responses + PROBES + k, k) = 1.0;
        }
        self.system.clear_rows(q);
    }

    /// As [`least_eigenvalue`], of every leading part.
    fn least_eigenvalues(&mut self, ends: &[usize], responses: usize) {
        let Self { system, least, .. } = self;
        least.clear();
        least.resize(ends.len(), f64::INFINITY);
        let mut smallest = f64::INFINITY;
        let mut pivots = system.pivots();
        for ((least, &end), &start) in least.iter_mut().zip(ends).zip([0].iter().chain(ends)) {
            smallest = pivots.by_ref().take(end - start).fold(smallest, f64::min);
            *least = smallest;
        }
        drop(pivots);
        for probe in responses..responses + PROBES {
            leading_sums(system.forward_products(probe, probe), ends, |pair, sum| {
                least[pair] = least[pair].min(by_probe(sum, ends[pair]));
            });
        }
    }

    fn primal_factor(&mut self, factor: &Factor, carried: &Range<usize>) -> f64 {
        let border = factor.responses + PROBES + carried.len();
        self.system.start(factor.rank, border, self.rows.len());
        set_probes(&mut self.system, factor.rank, factor.responses);
        let rows = &self.rows;
        for (k, &row) in rows[carried.clone()].iter().enumerate() {
            for (j, &q) in factor.basis_row(row).iter().enumerate() {
                *self.system.entry(factor.rank + factor.responses + PROBES + k, j) = q;
            }
        }
        self.system.set_terms(|t| factor.basis_row(rows[t]), |t| factor.residual_row(rows[t]));
        least_eigenvalue(&mut self.system, factor.rank, factor.responses)
    }

    fn primal(&mut self, factor: &Factor, out: &mut [f64]) -> f64 {
        let responses = factor.responses;
        let validated = 0..self.validated;
        let carry = validated.len() <= CARRIED;
        let least = self.primal_factor(factor, if carry { &validated } else { &(0..0) });
        if least < SAFE {
            return least;
        }
        for c in 0..responses {
            let rows = self.rows[validated.clone()].iter().enumerate();
            // The border came out as y = -L^-1 Q_K^T e_K, and carried rows as u = L^-1 q.
            if carry {
                for (k, &row) in rows {
                    let change: f64 = self.system.forward_products(c, responses + PROBES + k).sum();
                    out[k * responses + c] = factor.residual_row(row)[c] - change;
                }
            } else {
                let z = self.system.back_solve(c, 0);
                for (k, &row) in rows {
                    out[k * responses + c] = factor.residual_row(row)[c] - dot(factor.basis_row(row), z);
                }
            }
        }
        least
    }
}

/// Random signs in the border below the responses, see [`least_eigenvalue`].
fn set_probes(system: &mut Bordered, order: usize, responses: usize) {
    for probe in 0..PROBES {
        for j in 0..order {
            *system.entry(order + responses + probe, j) = sign(probe, j);
        }
    }
}

/// Brings residuals of rows from weighted to plain units.
fn unweight(factor: &Factor, rows: &[usize], out: &mut [f64]) {
    for (e, &row) in out.chunks_exact_mut(factor.responses).zip(rows) {
        e.iter_mut().for_each(|e| *e *= factor.unweight(row));
    }
}

/// Hands on the sums of the first `ends` terms, ends that do not decrease.
fn leading_sums(terms: impl Iterator<Item = f64>, ends: &[usize], mut hand: impl FnMut(usize, f64)) {
    let mut terms = terms;
    let (mut sum, mut start) = (0.0, 0);
    for (k, &end) in ends.iter().enumerate() {
        sum += terms.by_ref().take(end - start).sum::<f64>();
        start = end;
        hand(k, sum);
    }
}

/// Factors, and estimates the smallest eigenvalue from above. Pivots alone can hide it (Kahan's triangles), so random
/// signs d ride along below the responses: `d^T M^-1 d` is about 1 / lambda_min once that is small.
pub(crate) fn least_eigenvalue(system: &mut Bordered, order: usize, responses: usize) -> f64 {
    let smallest = system.factor();
    if smallest <= 0.0 {
        return 0.0;
    }
    (responses..responses + PROBES)
        .map(|probe| by_probe(system.forward_products(probe, probe).sum(), order))
        .fold(smallest, f64::min)
}

/// What a probe's `d^T M^-1 d` says of lambda_min, if anything.
fn by_probe(square: f64, order: usize) -> f64 {
    let grown = square - 10.0 * order as f64;
    if grown > 0.0 { grown.recip() } else { f64::INFINITY }
}

/// The j-th of a fixed sequence of signs that no structure of a design knows of.
pub(crate) fn sign(probe: usize, j: usize) -> f64 {
    let mixed = ((j * PROBES + probe + 1) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    if (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 63 == 0 { 1.0 } else { -1.0 }
}
