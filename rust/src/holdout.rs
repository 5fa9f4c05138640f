//! Prediction residuals of held-out pairs, equation (6): `e_(K) = (I - H_KK)^-1 e_K`, for the validated rows alone.
//!
//! With q held-out rows and rank p, a pair is solved in the smaller of two spaces. The *dual* factors
//! `I - Q_K Q_K^T` (q x q). The *primal* uses `e_(T) = e_T + Q_T M^-1 Q_K^T e_K` with `M = I - Q_K^T Q_K` (p x p). Both are one
//! call of [`Bordered`]. One to three rows are unrolled. A pivot near zero says that the training rows barely
//! determine the model: such a pair is refitted from its training rows, which decides its rank, see [`crate::refit`].

use std::ops::Range;
use std::sync::OnceLock;

use crate::cholesky::Bordered;
use crate::error::Error;
use crate::factor::{Factor, Problem, expect_length};
use crate::linalg::{self, dot};
use crate::pool::Pool;
use crate::refit::Refit;
use crate::scheme::Sets;

/// Below this lambda_min(M), give or take what an estimate may miss, the closed form is not trusted with nine digits: its
/// error is about eps / lambda_min(M).
const SAFE: f64 = 1e-5;

/// Validated rows that ride along as border rows, instead of a back substitution for all unknowns.
const CARRIED: usize = 4;

/// Random right-hand sides that tell lambda_min; they fit in the padding of the last panel as a rule.
pub(crate) const PROBES: usize = 2;

/// Hat matrices are kept whole up to this many rows (72 MB).
const HAT_ROWS: usize = 3000;

/// Which data each pair holds out and validates, and the rows of every datum.
pub struct Pairs<'a> {
    /// Held-out data of each pair, increasing.
    pub held: &'a Sets,
    /// Validated data of each pair, increasing, a subset of those held out.
    pub validated: &'a Sets,
    /// Rows of each datum.
    pub rows: &'a Sets,
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
        let hat = plan.hat.as_deref();
        pool.run(
            plan.chunks(&mut residuals, &mut status, self.responses, pool.threads()).into_iter(),
            || Workspace::new(self, &plan),
            |workspace, chunk| {
                let mut rest = chunk.residuals;
                for (status, pair) in chunk.status.iter_mut().zip(chunk.pairs) {
                    workspace.gather(pairs, pair);
                    let (out, after) = rest.split_at_mut(workspace.validated * self.responses);
                    rest = after;
                    *status = workspace.solve(self, hat, out);
                }
            },
        )?;
        self.rescue(problem, pairs, &plan, &mut residuals, &mut status, pool)?;
        let status = status.into_iter().map(|s| s.unwrap_or(Status::Undefined)).collect();
        let rows = (0..count).flat_map(|s| pairs.validated.get(s)).flat_map(|&d| pairs.rows.get(d)).copied();
        Ok(Predictions { residuals, rows: rows.collect(), offsets: plan.offsets, status })
    }

    /// The pairs that the closed form left, each a task of its own: they cost far more than the others.
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
        let mut tasks = Vec::new();
        for (pair, status) in status.iter_mut().enumerate() {
            let size = (plan.offsets[pair + 1] - plan.offsets[pair]) * self.responses;
            let (out, after) = rest.split_at_mut(size);
            rest = after;
            if status.is_none() {
                tasks.push((pair, status, out));
            }
        }
        let failure = OnceLock::new();
        pool.run(
            tasks.into_iter(),
            || Workspace::new(self, plan),
            |workspace, (pair, status, out)| {
                workspace.gather(pairs, pair);
                match workspace.rescue(self, problem, pool, out) {
                    Ok(found) => *status = Some(found),
                    Err(error) => drop(failure.set(error)),
                }
            },
        )?;
        failure.into_inner().map_or(Ok(()), Err)
    }

    /// The blocks `H_KK` of the hat matrix for sets of rows: each row-major, one after another.
    pub fn hat_blocks(&self, sets: &Sets, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        check_indices(sets, self.rows)?;
        let sizes: Vec<usize> = (0..sets.len()).map(|s| sets.get(s).len().pow(2)).collect();
        let mut blocks = vec![0.0; sizes.iter().sum()];
        let mut rest = &mut blocks[..];
        let mut tasks = Vec::with_capacity(sets.len());
        for (s, size) in sizes.into_iter().enumerate() {
            let (block, after) = rest.split_at_mut(size);
            rest = after;
            tasks.push((sets.get(s), block));
        }
        pool.run(
            tasks.into_iter(),
            || (),
            |(), (rows, block)| {
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

    /// The lower triangle of H, row-major.
    fn hat(&self, pool: &Pool<'_>) -> Result<Vec<f64>, Error> {
        const BAND: usize = 64;
        let mut hat = vec![0.0; self.rows * self.rows];
        let basis = &self.basis[..self.rows * self.rank];
        pool.run(
            hat.chunks_mut(BAND * self.rows).enumerate(),
            || (),
            |(), (band, out)| linalg::gram_rows(basis, self.rank, band * BAND, out, self.rows),
        )?;
        Ok(hat)
    }
}

pub(crate) fn check_indices(sets: &Sets, bound: usize) -> Result<(), Error> {
    expect_length(sets.items.len(), *sets.offsets.last().unwrap_or(&0))?;
    match sets.items.iter().max() {
        Some(&index) if index >= bound => Err(Error::Index { index, bound }),
        _ => Ok(()),
    }
}

/// Multiply-adds of the dual and of the primal for q rows.
fn costs(q: usize, rank: usize, hat: bool) -> (f64, f64) {
    let (q, p) = (q as f64, rank as f64);
    let gram = if hat { q } else { q * p / 2.0 };
    (q * gram + q * q * q / 6.0, q * p * p / 2.0 + p * p * p / 6.0)
}

/// Sizes, costs and places of all pairs, known before any is solved.
struct Plan {
    /// Multiply-adds before each pair; one more than the pairs.
    cost: Vec<f64>,
    offsets: Vec<usize>,
    hat: Option<Vec<f64>>,
    largest: usize,
}

struct Chunk<'a> {
    pairs: Range<usize>,
    residuals: &'a mut [f64],
    status: &'a mut [Option<Status>],
}

impl Plan {
    fn new(factor: &Factor, pairs: &Pairs<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        let count = pairs.held.len();
        expect_length(pairs.validated.len(), count)?;
        check_indices(pairs.rows, factor.rows)?;
        check_indices(pairs.held, pairs.rows.len())?;
        check_indices(pairs.validated, pairs.rows.len())?;
        let rows =
            |sets: &Sets, s: usize| sets.get(s).iter().map(|&d| pairs.rows.get(d).len()).sum::<usize>();
        let held: Vec<usize> = (0..count).map(|s| rows(pairs.held, s)).collect();
        let mut offsets = vec![0; count + 1];
        for s in 0..count {
            offsets[s + 1] = offsets[s] + rows(pairs.validated, s);
        }
        let total = |hat: bool| -> f64 {
            held.iter().map(|&q| costs(q, factor.rank, hat)).map(|(dual, primal)| dual.min(primal)).sum()
        };
        let whole = (factor.rows as f64).powi(2) * factor.rank as f64 / 2.0;
        let keep_hat = factor.rows <= HAT_ROWS && whole + total(true) < total(false);
        let hat = if keep_hat { Some(factor.hat(pool)?) } else { None };
        let mut cost = vec![0.0; count + 1];
        for (s, &q) in held.iter().enumerate() {
            let (dual, primal) = costs(q, factor.rank, keep_hat);
            let gather = (q * factor.rank + 100) as f64;
            cost[s + 1] = cost[s] + dual.min(primal) + gather;
        }
        Ok(Self { cost, offsets, hat, largest: held.into_iter().max().unwrap_or(0) })
    }

    /// Runs of pairs of about equal cost: several a thread for balance, none so long that it delays an interrupt.
    fn chunks<'a>(
        &self,
        mut residuals: &'a mut [f64],
        mut status: &'a mut [Option<Status>],
        responses: usize,
        threads: usize,
    ) -> Vec<Chunk<'a>> {
        let count = status.len();
        let target = (self.cost[count] / (8 * threads) as f64).clamp(1e5, 5e7);
        let mut chunks = Vec::new();
        let mut first = 0;
        while first < count {
            let goal = self.cost[first] + target;
            let last = (first + 1..count).find(|&s| self.cost[s] >= goal).unwrap_or(count);
            let (mine, rest) = residuals.split_at_mut((self.offsets[last] - self.offsets[first]) * responses);
            let (states, others) = status.split_at_mut(last - first);
            (residuals, status) = (rest, others);
            chunks.push(Chunk { pairs: first..last, residuals: mine, status: states });
            first = last;
        }
        chunks
    }
}

/// Everything a thread needs to solve pairs without allocating.
struct Workspace {
    system: Bordered,
    /// Held-out rows of the pair at hand, the validated ones last.
    rows: Vec<usize>,
    validated: usize,
    refit: Refit,
}

impl Workspace {
    fn new(factor: &Factor, plan: &Plan) -> Self {
        let mut system = Bordered::default();
        let (q, p) = (plan.largest, factor.rank);
        let border = factor.responses + PROBES + CARRIED;
        let dual = q.min(if plan.hat.is_some() { q } else { p });
        system.reserve(dual, border, if plan.hat.is_some() { 0 } else { p });
        system.reserve(p, border, q);
        Self { system, rows: Vec::with_capacity(q), validated: 0, refit: Refit::default() }
    }

    fn gather(&mut self, pairs: &Pairs<'_>, pair: usize) {
        let validated = pairs.validated.get(pair);
        self.rows.clear();
        let mut skip = validated.iter().peekable();
        for &datum in pairs.held.get(pair) {
            if skip.next_if_eq(&&datum).is_none() {
                self.rows.extend_from_slice(pairs.rows.get(datum));
            }
        }
        let others = self.rows.len();
        for &datum in validated {
            self.rows.extend_from_slice(pairs.rows.get(datum));
        }
        self.validated = self.rows.len() - others;
    }

    /// Writes the prediction residuals of the validated rows, or none if the pair is too close to rank loss.
    fn solve(&mut self, factor: &Factor, hat: Option<&[f64]>, out: &mut [f64]) -> Option<Status> {
        let q = self.rows.len();
        if factor.total_rows < factor.rank + q {
            return Some(Status::Undefined);
        }
        let least = match (q, hat) {
            (0, _) => return Some(Status::Closed),
            (1, _) => self.unrolled::<1>(factor, out),
            (2, _) => self.unrolled::<2>(factor, out),
            (3, _) => self.unrolled::<3>(factor, out),
            (q, hat) => {
                let (dual, primal) = costs(q, factor.rank, hat.is_some());
                if dual <= primal { self.dual(factor, hat, out) } else { self.primal(factor, out) }
            }
        };
        if least < SAFE {
            return None;
        }
        self.unweight(factor, out);
        Some(Status::Closed)
    }

    fn rescue(
        &mut self,
        factor: &Factor,
        problem: &Problem<'_>,
        pool: &Pool<'_>,
        out: &mut [f64],
    ) -> Result<Status, Error> {
        out.fill(f64::NAN);
        let least = self.primal_factor(factor, &(0..0));
        let Self { system, rows, validated, refit, .. } = self;
        let status = refit.predict(factor, problem, pool, (system, least), (rows, *validated), out)?;
        self.unweight(factor, out);
        Ok(status)
    }

    fn unweight(&self, factor: &Factor, out: &mut [f64]) {
        let validated = &self.rows[self.rows.len() - self.validated..];
        for (e, &row) in out.chunks_exact_mut(factor.responses).zip(validated) {
            e.iter_mut().for_each(|e| *e *= factor.unweight(row));
        }
    }

    /// Begins a system with a border of right-hand sides, probes, and `carried` rows.
    fn start(&mut self, order: usize, responses: usize, terms: usize, carried: usize) {
        self.system.start(order, responses + PROBES + carried, terms);
        for probe in 0..PROBES {
            for j in 0..order {
                *self.system.entry(order + responses + probe, j) = sign(probe, j);
            }
        }
    }

    /// `(I - H_KK) z = e_K` for one to three rows, in registers.
    fn unrolled<const N: usize>(&self, factor: &Factor, out: &mut [f64]) -> f64 {
        let q: [&[f64]; N] = std::array::from_fn(|i| factor.basis_row(self.rows[i]));
        let mut l = [[0.0; N]; N];
        let mut smallest = f64::INFINITY;
        for i in 0..N {
            for j in 0..=i {
                let own = if i == j { 1.0 } else { 0.0 };
                let sum: f64 = (0..j).map(|k| l[i][k] * l[j][k]).sum();
                let value = own - dot(q[i], q[j]) - sum;
                if i == j {
                    smallest = smallest.min(value);
                }
                l[i][j] = if i == j { value.max(0.0).sqrt() } else { value / l[j][j] };
            }
        }
        let first = N - self.validated;
        for c in 0..factor.responses {
            let mut z: [f64; N] = std::array::from_fn(|i| factor.residual_row(self.rows[i])[c]);
            for i in 0..N {
                z[i] = (z[i] - (0..i).map(|k| l[i][k] * z[k]).sum::<f64>()) / l[i][i];
            }
            for i in (first..N).rev() {
                z[i] = (z[i] - (i + 1..N).map(|k| l[k][i] * z[k]).sum::<f64>()) / l[i][i];
                out[(i - first) * factor.responses + c] = z[i];
            }
        }
        smallest
    }

    fn dual(&mut self, factor: &Factor, hat: Option<&[f64]>, out: &mut [f64]) -> f64 {
        let (q, responses) = (self.rows.len(), factor.responses);
        self.start(q, responses, if hat.is_some() { 0 } else { factor.rank }, 0);
        for (i, &row) in self.rows.iter().enumerate() {
            match hat {
                None => self.system.set_row(i, factor.basis_row(row)),
                Some(hat) => {
                    for (j, &other) in self.rows.iter().enumerate().take(i + 1) {
                        *self.system.entry(i, j) -= hat[row.max(other) * factor.rows + row.min(other)];
                    }
                }
            }
            for (c, &e) in factor.residual_row(row).iter().enumerate() {
                *self.system.entry(q + c, i) = e;
            }
        }
        self.system.clear_rows(q);
        let least = least_eigenvalue(&mut self.system, q, responses);
        if least >= SAFE {
            for c in 0..responses {
                let z = self.system.back_solve(c, q - self.validated);
                out.iter_mut().skip(c).step_by(responses).zip(z).for_each(|(e, z)| *e = *z);
            }
        }
        least
    }

    fn primal_factor(&mut self, factor: &Factor, carried: &Range<usize>) -> f64 {
        self.start(factor.rank, factor.responses, self.rows.len(), carried.len());
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
        let validated = self.rows.len() - self.validated..self.rows.len();
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
                    let change = self.system.forward_dot(c, responses + PROBES + k);
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

/// Factors, and estimates the smallest eigenvalue from above. Pivots alone can hide it (Kahan's triangles), so random
/// signs d ride along below the responses: `d^T M^-1 d` is about 1 / lambda_min once that is small.
pub(crate) fn least_eigenvalue(system: &mut Bordered, order: usize, responses: usize) -> f64 {
    let smallest = system.factor();
    if smallest <= 0.0 {
        return 0.0;
    }
    let probe = |k| system.forward_dot(responses + k, responses + k) - 10.0 * order as f64;
    (0..PROBES)
        .map(probe)
        .fold(smallest, |least, grown| if grown > 0.0 { least.min(grown.recip()) } else { least })
}

/// The j-th of a fixed sequence of signs that no structure of a design knows of.
pub(crate) fn sign(probe: usize, j: usize) -> f64 {
    let mixed = ((j * PROBES + probe + 1) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    if (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9) >> 63 == 0 { 1.0 } else { -1.0 }
}
