//! Every leading model at once: model l has the first l columns of the design.
//!
//! Let Q be the basis of an unpivoted factorisation, so that its first l columns span those of model l. For a held-out set K
//! factor `M = I - Q_K^T Q_K = L L^T` without pivoting. With `b = Q c + e`, `u = L^-1 q_i` and
//! `v = L^-1 (Q^T b - Q_K^T b_K) = L^T c - L^-1 Q_K^T e_K`, the prediction of model l at row i is
//!
//! ```text
//! sum_{j <= l} u_j v_j
//! ```
//!
//! since leading blocks of L factor leading blocks of M: the whole curve over l costs one factorisation a set. The second form
//! of v has no cancellation.
//!
//! * **Dual**, for small sets: `S_l = I - Q_K,l Q_K,l^T` loses one rank-one term a column. With `w = S_l-1^-1 q_l` and
//!   `d = 1 - q_l . w`, which is the pivot `L_ll^2`,
//!   `S_l^-1 = S_l-1^-1 + w w^T / d` and the prediction residuals become `e - w (c_l - q_l . e) / d`. The sums have no
//!   cancellation.
//! * **Neighbouring sets** share a [`Gram`] matrix: that of a pair is made from that of the pair before, of the next smaller
//!   scheme around the same datum (ring by ring), or afresh, whichever differs in the fewest rows.
//! * **Rank loss.** A vanishing pivot at column j leaves models j, j + 1, .. undefined. M squares singular values, so the
//!   error is eps / lambda_min(M); where that shows, the same is done with twice the digits, see [`crate::holdout::rescue::double_double`]. The training
//!   rows' triangle `L^T R`, with R the design's, decides on rank. Where Q itself has too few digits, at lambda_min near
//!   rounding, the training rows are refitted, and their own triangle gives u and v for all l.

use std::sync::OnceLock;

use crate::error::Error;
use crate::fit::factor::{self, Factor, Problem, expect_length};
use crate::fit::linalg::{self, dot};
use crate::holdout::gram::Gram;
use crate::holdout::kernel::Bordered;
use crate::holdout::pairs::{PROBES, check_indices, least_eigenvalue, sign};
use crate::holdout::rescue::double_double::{self, DoubledFactor, DoubledGram, Doubles};
use crate::holdout::rescue::refit::Refit;
use crate::near::neighbours::Around;
use crate::pool::Pool;
use crate::sets::Sets;

/// Below this lambda_min(M) a pair needs twice the digits.
const SAFE: f64 = 2e-7;

/// Below this lambda_min(M) twice the digits do not help: those of Q are too few.
const DOUBLED: f64 = 1e-12;

/// Pairs close to rank loss that share matrices, at most.
const RUN: usize = 64;

/// Below this lambda_min(M), training rows of an ill-conditioned design may have lost rank.
const DOUBTFUL: f64 = 1e-5;

/// Steps of a chain that share matrices; the next ones start afresh, so that rounding does not grow.
const STEPS: usize = 64;

/// Multiply-adds of a task, so that none delays an interrupt.
const TASK: f64 = 1e9;

/// Validated rows solved for together.
const CARRIED: usize = 64;

/// Held-out and validated data of pairs.
pub struct Scheme<'a> {
    /// Held-out data of each pair.
    pub held: Held<'a>,
    /// Validated data of each pair, a subset of those held out.
    pub validated: &'a Sets,
    /// The pairs to be visited, successive ones best near each other: they then share most of what they hold out.
    pub order: &'a [usize],
}

/// Data that pairs hold out.
#[derive(Clone, Copy)]
pub enum Held<'a> {
    /// Listed.
    Sets(&'a Sets),
    /// Found around each datum when they are needed.
    Around(&'a Around),
}

impl Held<'_> {
    fn len(self) -> usize {
        match self {
            Self::Sets(sets) => sets.len(),
            Self::Around(around) => around.own.len(),
        }
    }

    /// About how many data a pair holds out.
    fn mean(self) -> f64 {
        match self {
            Self::Sets(sets) => sets.items.len() as f64 / sets.len().max(1) as f64,
            Self::Around(around) => around.mean,
        }
    }

    fn members(self, pair: usize, out: &mut Vec<usize>) {
        match self {
            Self::Sets(sets) => {
                out.clear();
                out.extend_from_slice(sets.get(pair));
            }
            Self::Around(around) => around.members(pair, out),
        }
    }
}

/// What a scheme says of every model.
pub struct Curve {
    /// Sum of squared weighted prediction residuals, one a model; NaN where a pair is undefined.
    pub squares: Vec<f64>,
    /// How many of the models are defined, for each pair in the order of the visit.
    pub defined: Vec<usize>,
}

/// The fit of one model.
pub struct Fit {
    /// Sum of squared weighted residuals.
    pub squares: f64,
    /// Trace of the hat matrix: the effective number of parameters.
    pub parameters: f64,
    /// Number of columns that add rank.
    pub rank: usize,
}

/// A factored problem whose leading columns are models of their own.
pub struct Nested {
    factor: Factor,
    /// The columns that add rank to those before; all of them as a rule.
    kept: Vec<usize>,
    /// The problem without the others, if there are others.
    reduced: Option<(Vec<f64>, Vec<f64>)>,
    /// Weighted responses, rows x responses.
    right: Vec<f64>,
    squares: OnceLock<Doubles>,
}

impl Nested {
    /// Factors all models.
    pub fn new(problem: &Problem<'_>, pool: &Pool<'_>) -> Result<Self, Error> {
        let mut factor = Factor::new(problem, pool)?;
        let mut kept: Vec<usize> = (0..problem.columns).collect();
        let mut reduced = None;
        while 0 < factor.rank && factor.rank < kept.len() {
            kept = factor.independent_columns(pool)?.into_iter().map(|j| kept[j]).collect();
            let only = |matrix| columns(matrix, problem.columns, &kept);
            let parts = (only(problem.design), only(problem.penalty));
            factor = Factor::new(&part(problem, &parts, kept.len()), pool)?;
            reduced = Some(parts);
        }
        kept.truncate(factor.rank);
        let right = factor::weighted_responses(problem, factor.responses);
        Ok(Self { factor, kept, reduced, right, squares: OnceLock::new() })
    }

    /// How many of the independent columns are among the first ones of the design.
    fn cuts(&self, sizes: &[usize]) -> Result<Vec<usize>, Error> {
        if let Some(index) = (1..sizes.len()).find(|&k| sizes[k] < sizes[k - 1]) {
            return Err(Error::Decreasing { index });
        }
        Ok(sizes.iter().map(|&size| self.kept.partition_point(|&column| column < size)).collect())
    }

    /// The fit of the models with these numbers of columns.
    pub fn fits(&self, sizes: &[usize], pool: &Pool<'_>) -> Result<Vec<Fit>, Error> {
        const ROWS: usize = 2000;
        let Factor { rank, rows, .. } = self.factor;
        let cuts = self.cuts(sizes)?;
        let width = rank + sizes.len();
        let mut parts = vec![0.0; rows.div_ceil(ROWS) * width];
        pool.run(
            parts.chunks_exact_mut(width.max(1)).enumerate(),
            || (),
            |(), (block, part)| {
                let (leverage, squares) = part.split_at_mut(rank);
                for i in block * ROWS..rows.min((block + 1) * ROWS) {
                    let q = self.factor.basis_row(i);
                    leverage.iter_mut().zip(q).for_each(|(h, q)| *h += q * q);
                    for (c, b) in self.right_row(i).iter().enumerate() {
                        let projection = &self.factor.projection[c * rank..(c + 1) * rank];
                        add_squares([*b], q.as_chunks().0, projection, &cuts, squares);
                    }
                }
            },
        )?;
        let mut sums = vec![0.0; width];
        for part in parts.chunks_exact(width.max(1)) {
            sums.iter_mut().zip(part).for_each(|(s, x)| *s += x);
        }
        let (leverage, squares) = sums.split_at(rank);
        let fit = |(&cut, &squares): (&usize, &f64)| Fit {
            squares,
            parameters: leverage[..cut].iter().sum(),
            rank: cut,
        };
        Ok(cuts.iter().zip(squares).map(fit).collect())
    }

    /// The coefficients of the model of the first `size` columns, size x responses, column-major; those of columns that add
    /// no rank are zero.
    pub fn coefficients(&self, size: usize) -> Vec<f64> {
        let Factor { rank, .. } = self.factor;
        let cut = self.kept.partition_point(|&column| column < size);
        self.factor
            .projection
            .chunks_exact(rank.max(1))
            .flat_map(|c| {
                let mut x = c[..cut].to_vec();
                linalg::solve_upper(&self.factor.triangle, rank, cut, &mut x, 1);
                let mut all = vec![0.0; size];
                for ((x, scale), &column) in x.iter().zip(&self.factor.scales).zip(&self.kept) {
                    all[column] = x * scale;
                }
                all
            })
            .collect()
    }

    /// Cross-validates the models with these numbers of columns, none less than the one before, by every scheme. Schemes
    /// with equal validated sets and order go through the data together, the smaller first.
    pub fn curves(
        &self,
        problem: &Problem<'_>,
        schemes: &[Scheme<'_>],
        rows: &Sets,
        sizes: &[usize],
        pool: &Pool<'_>,
    ) -> Result<Vec<Curve>, Error> {
        check(schemes, rows, self.factor.rows)?;
        let cuts = self.cuts(sizes)?;
        let sweep = Sweep { nested: self, schemes, rows, cuts: &cuts };
        let chains = chains(schemes);
        let mut tasks: Vec<Task> = Vec::new();
        for chain in &chains {
            let length = schemes[chain[0]].order.len();
            let steps = sweep.steps(chain);
            tasks.extend(
                (0..length).step_by(steps).map(|first| sweep.task(chain, first, length.min(first + steps))),
            );
        }
        pool.run(
            tasks.iter_mut(),
            || Workspace::new(&sweep),
            |workspace, task| workspace.walk(&sweep, task, pool),
        )?;
        let mut found: Vec<Curve> = schemes
            .iter()
            .map(|s| Curve { squares: vec![0.0; cuts.len()], defined: vec![cuts.len(); s.order.len()] })
            .collect();
        let mut rest = Vec::new();
        for task in &tasks {
            for (&s, squares) in task.chain.iter().zip(task.squares.chunks_exact(cuts.len().max(1))) {
                found[s].squares.iter_mut().zip(squares).for_each(|(sum, x)| *sum += x);
            }
            task.cut.iter().for_each(|&(s, step, defined)| found[s].defined[step] = defined);
            rest.extend_from_slice(&task.close);
        }
        sweep.rescue(problem, &mut rest, &mut found, pool)?;
        Ok(found)
    }

    /// `Q^T Q` in twice the digits, once some pair needs it.
    fn squares(&self, pool: &Pool<'_>) -> Result<&Doubles, Error> {
        if self.squares.get().is_none() {
            drop(self.squares.set(doubled::squares(&self.factor.basis, self.factor.rank, pool)?));
        }
        self.squares.get().ok_or(Error::Interrupted)
    }

    fn right_row(&self, i: usize) -> &[f64] {
        let r = self.factor.responses;
        &self.right[i * r..(i + 1) * r]
    }

    /// The problem that was factored, of the one that came.
    fn independent<'a>(&'a self, problem: &'a Problem<'a>) -> Problem<'a> {
        match &self.reduced {
            Some(parts) => part(problem, parts, self.kept.len()),
            None => Problem { ..*problem },
        }
    }
}

fn columns(matrix: &[f64], width: usize, kept: &[usize]) -> Vec<f64> {
    matrix.chunks_exact(width).flat_map(|row| kept.iter().map(|&j| row[j])).collect()
}

fn part<'a>(
    problem: &Problem<'a>,
    (design, penalty): &'a (Vec<f64>, Vec<f64>),
    columns: usize,
) -> Problem<'a> {
    Problem { design, penalty, columns, ..*problem }
}

/// Adds the squares of `b - sum_{j < cut} u_j v_j` at every cut, of N rows side by side.
fn add_squares<const N: usize>(b: [f64; N], u: &[[f64; N]], v: &[f64], cuts: &[usize], squares: &mut [f64]) {
    let (mut rest, mut done) = (b, 0);
    for (square, &cut) in squares.iter_mut().zip(cuts) {
        for (u, v) in u[done..cut].iter().zip(&v[done..cut]) {
            rest.iter_mut().zip(u).for_each(|(rest, u)| *rest -= u * v);
        }
        done = cut;
        rest.iter().for_each(|e| *square += e * e);
    }
}

fn check(schemes: &[Scheme<'_>], rows: &Sets, bound: usize) -> Result<(), Error> {
    check_indices(rows, bound)?;
    for scheme in schemes {
        if let Held::Sets(held) = scheme.held {
            check_indices(held, rows.len())?;
        }
        check_indices(scheme.validated, rows.len())?;
        expect_length(scheme.validated.len(), scheme.held.len())?;
        if let Some(&index) = scheme.order.iter().find(|&&pair| pair >= scheme.held.len()) {
            return Err(Error::Index { index, bound: scheme.held.len() });
        }
    }
    Ok(())
}

/// Schemes around the same data, those that hold out less first.
fn chains(schemes: &[Scheme<'_>]) -> Vec<Vec<usize>> {
    let mut chains: Vec<Vec<usize>> = Vec::new();
    for (s, scheme) in schemes.iter().enumerate() {
        let alike = |other: &Scheme<'_>| {
            other.validated.offsets == scheme.validated.offsets
                && other.validated.items == scheme.validated.items
                && other.order == scheme.order
        };
        match chains.iter_mut().find(|chain| alike(&schemes[chain[0]])) {
            Some(chain) => chain.push(s),
            None => chains.push(vec![s]),
        }
    }
    for chain in &mut chains {
        chain.sort_by(|&s, &t| schemes[s].held.mean().total_cmp(&schemes[t].held.mean()));
    }
    chains
}

/// Steps of a chain, and what they found.
struct Task<'a> {
    chain: &'a [usize],
    steps: std::ops::Range<usize>,
    /// Chain x cuts.
    squares: Vec<f64>,
    /// Scheme, step, and number of defined models where these are not all.
    cut: Vec<(usize, usize, usize)>,
    /// Scheme and step of those close to rank loss.
    close: Vec<(usize, usize)>,
}

/// How much of a pair's curve the closed form gives.
enum Outcome {
    All,
    /// This many models are defined, and no more.
    Leading(usize),
    /// Too close to rank loss for this arithmetic.
    Close,
}

/// What all tasks read.
struct Sweep<'a> {
    nested: &'a Nested,
    schemes: &'a [Scheme<'a>],
    rows: &'a Sets,
    cuts: &'a [usize],
}

impl Sweep<'_> {
    /// How many steps of a chain make a task: enough to share, not so many that threads idle or an interrupt waits. It depends
    /// on the problem alone, and so do the results. A step changes about as many rows as there are data along the rim of
    /// its neighbourhood; only the first takes them all.
    fn steps(&self, chain: &[usize]) -> usize {
        let p = self.nested.factor.rank as f64;
        let length = self.schemes[chain[0]].order.len().max(1);
        let rim = |mean: f64| mean.min(3.0 * mean.sqrt());
        let coupling = self.nested.factor.rows as f64 / self.rows.len().max(1) as f64;
        let cost = |&s: &usize| p * p * (p / 6.0 + coupling * rim(self.schemes[s].held.mean()) / 2.0);
        let most = (TASK / chain.iter().map(cost).sum::<f64>().max(1.0)) as usize;
        (length / 32).clamp(8, STEPS).min(most).max(1)
    }

    fn rows_of(&self, data: &[usize]) -> Vec<usize> {
        data.iter().flat_map(|&datum| self.rows.get(datum)).copied().collect()
    }

    fn task<'a>(&self, chain: &'a [usize], first: usize, last: usize) -> Task<'a> {
        Task {
            chain,
            steps: first..last,
            squares: vec![0.0; chain.len() * self.cuts.len()],
            cut: Vec::new(),
            close: Vec::new(),
        }
    }

    /// The pairs close to rank loss, in runs that share matrices.
    fn rescue(
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
        let factor = &self.nested.factor;
        let squares = self.nested.squares(pool)?;
        let mut results: Vec<(Vec<f64>, usize)> = vec![(Vec::new(), 0); steps.len()];
        let failure = OnceLock::new();
        let workspace = || Rescue {
            sweep: self,
            problem: self.nested.independent(problem),
            squares,
            plain: Workspace::new(self),
            last: Last::default(),
            factor: DoubledFactor::default(),
            refit: Refit::default(),
        };
        let run = (steps.len() / 16).clamp(1, RUN);
        pool.run(steps.chunks(run).zip(results.chunks_mut(run)), workspace, |rescue, (steps, results)| {
            rescue.last.forget(self.rows.len());
            rescue.last.gram.start(squares, factor.rank, factor.responses);
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

/// The matrix of one scheme's last pair, and whose rows it left out.
#[derive(Default)]
struct Last<G> {
    gram: G,
    members: Vec<usize>,
    /// By datum, whether it is one of the members.
    inside: Vec<bool>,
}

impl<G> Last<G> {
    /// Nothing is held out of `count` data.
    fn forget(&mut self, count: usize) {
        self.members.clear();
        self.inside.clear();
        self.inside.resize(count, false);
    }

    fn remember(&mut self, members: &[usize]) {
        self.members.iter().for_each(|&datum| self.inside[datum] = false);
        members.iter().for_each(|&datum| self.inside[datum] = true);
        members.clone_into(&mut self.members);
    }
}

/// How one set of data becomes another.
#[derive(Default)]
struct Change {
    added: Vec<usize>,
    removed: Vec<usize>,
}

impl Change {
    fn len(&self) -> usize {
        self.added.len() + self.removed.len()
    }

    /// From the members of `last` to those that bear the stamp `now` or a later one.
    fn find<G>(&mut self, last: &Last<G>, members: &[usize], stamps: &[u32], now: u32) {
        self.added.clear();
        self.added.extend(members.iter().filter(|&&datum| !last.inside[datum]));
        self.removed.clear();
        self.removed.extend(last.members.iter().filter(|&&datum| stamps[datum] < now));
    }
}

/// Everything a thread needs to solve pairs without allocating.
struct Workspace {
    system: Bordered,
    /// One a scheme of the chain, and last an empty one.
    last: Vec<Last<Gram>>,
    /// Data that the pair at hand holds out.
    members: Vec<usize>,
    stamps: Vec<u32>,
    now: u32,
    slide: Change,
    ring: Change,
    /// Held-out rows of the pair at hand, the validated ones last.
    rows: Vec<usize>,
    validated: usize,
    /// Squared prediction residuals of the pair at hand, one a cut.
    curve: Vec<f64>,
    forward: Vec<f64>,
    dual: Dual,
}

impl Workspace {
    fn new(sweep: &Sweep<'_>) -> Self {
        Self {
            system: Bordered::default(),
            last: Vec::new(),
            members: Vec::new(),
            stamps: vec![0; sweep.rows.len()],
            now: 0,
            slide: Change::default(),
            ring: Change::default(),
            rows: Vec::new(),
            validated: 0,
            curve: vec![0.0; sweep.cuts.len()],
            forward: Vec::new(),
            dual: Dual::default(),
        }
    }

    /// Goes through the steps of a task, all schemes of the chain at each.
    fn walk(&mut self, sweep: &Sweep<'_>, task: &mut Task<'_>, pool: &Pool<'_>) {
        self.forget(sweep, task.chain.len());
        for step in task.steps.clone() {
            for (k, &s) in task.chain.iter().enumerate() {
                let pair = sweep.schemes[s].order[step];
                let outcome = self.solve(sweep, (s, pair), k, pool);
                let squares = &mut task.squares[k * self.curve.len()..(k + 1) * self.curve.len()];
                if let Outcome::All | Outcome::Leading(_) = outcome {
                    squares.iter_mut().zip(&self.curve).for_each(|(sum, x)| *sum += x);
                }
                match outcome {
                    Outcome::All => {}
                    Outcome::Leading(defined) => task.cut.push((s, step, defined)),
                    Outcome::Close => task.close.push((s, step)),
                }
            }
        }
    }

    /// Starts afresh: nothing is held out.
    fn forget(&mut self, sweep: &Sweep<'_>, schemes: usize) {
        let Factor { rank, responses, .. } = sweep.nested.factor;
        self.last.resize_with(schemes.max(self.last.len()), Last::default);
        for last in &mut self.last[..schemes] {
            last.forget(sweep.rows.len());
            last.gram.start(rank, responses);
        }
    }

    /// Lists what a pair holds out, and stamps it: validated data with a later stamp.
    fn gather(&mut self, sweep: &Sweep<'_>, (s, pair): (usize, usize)) {
        let Scheme { held, validated, .. } = &sweep.schemes[s];
        let validated = validated.get(pair);
        held.members(pair, &mut self.members);
        self.now += 2;
        self.members.iter().for_each(|&datum| self.stamps[datum] = self.now);
        validated.iter().for_each(|&datum| self.stamps[datum] = self.now + 1);
        let others = self.members.iter().filter(|&&datum| self.stamps[datum] == self.now);
        self.rows.clear();
        self.rows.extend(others.flat_map(|&datum| sweep.rows.get(datum)));
        let others = self.rows.len();
        self.rows.extend(validated.iter().flat_map(|&datum| sweep.rows.get(datum)));
        self.validated = self.rows.len() - others;
    }

    /// Fills the curve of a pair, the k-th of its chain.
    fn solve(&mut self, sweep: &Sweep<'_>, pair: (usize, usize), k: usize, pool: &Pool<'_>) -> Outcome {
        let Nested { factor, .. } = sweep.nested;
        self.gather(sweep, pair);
        self.curve.fill(0.0);
        if self.rows.is_empty() {
            return Outcome::All;
        }
        if factor.total_rows < factor.rank + self.rows.len() {
            return Outcome::Close;
        }
        let Self { members, stamps, now, last, slide, ring, .. } = self;
        slide.find(&last[k], members, stamps, *now);
        let inner = k > 0 && {
            ring.find(&last[k - 1], members, stamps, *now);
            ring.len() < slide.len()
        };
        let changed = if inner { ring.len() } else { slide.len() }.min(members.len());
        let (q, p) = (self.rows.len() as f64, factor.rank as f64);
        let rows = changed as f64 * q / members.len() as f64;
        if 4.0 * q * q * p <= p * p * (p / 6.0 + rows / 2.0 + 1.0)
            && self.dual.solve(sweep.nested, sweep.cuts, (&self.rows, self.validated), &mut self.curve)
        {
            return Outcome::All;
        }
        self.curve.fill(0.0);
        self.follow(sweep, k, inner);
        self.primal(sweep, k, pool)
    }

    /// Turns the k-th matrix into that of the pair at hand, from the nearest that is known.
    fn follow(&mut self, sweep: &Sweep<'_>, k: usize, inner: bool) {
        let Nested { factor, .. } = sweep.nested;
        let Self { last, members, slide, ring, .. } = self;
        let (before, rest) = last.split_at_mut(k);
        let last = &mut rest[0];
        let change = if inner { ring } else { slide };
        if change.len() > members.len() {
            last.gram.start(factor.rank, factor.responses);
            change.removed.clear();
            change.added.clone_from(members);
        } else if inner {
            last.gram.copy_from(&before[k - 1].gram);
        }
        let fetch = |i: usize| (factor.basis_row(i), factor.residual_row(i));
        last.gram.change(&sweep.rows_of(&change.added), -1.0, fetch);
        last.gram.change(&sweep.rows_of(&change.removed), 1.0, fetch);
        last.remember(members);
    }

    fn primal(&mut self, sweep: &Sweep<'_>, k: usize, pool: &Pool<'_>) -> Outcome {
        let Nested { factor, .. } = sweep.nested;
        let (rank, responses) = (factor.rank, factor.responses);
        self.system.start_from(&self.last[k].gram, PROBES);
        for probe in 0..PROBES {
            for j in 0..rank {
                *self.system.entry(rank + responses + probe, j) = sign(probe, j);
            }
        }
        let least = least_eigenvalue(&mut self.system, rank, responses);
        if least < SAFE {
            return Outcome::Close;
        }
        let Self { system, rows, validated, curve, forward, .. } = self;
        for rows in rows[rows.len() - *validated..].chunks(CARRIED) {
            system.carry(rows.iter().map(|&i| factor.basis_row(i)));
            for c in 0..responses {
                system.forward_row(c, forward);
                system.add_transposed(&factor.projection[c * rank..(c + 1) * rank], forward);
                for (panel, rows) in system.carried().chunks_exact(rank.max(1)).zip(rows.chunks(8)) {
                    let mut b = [0.0; 8];
                    b.iter_mut().zip(rows).for_each(|(b, &i)| *b = sweep.nested.right_row(i)[c]);
                    add_squares(b, panel, forward, sweep.cuts, curve);
                }
            }
        }
        if least > DOUBTFUL { Outcome::All } else { self.cut(sweep, &self.system.upper(), pool) }
    }

    /// Which models the training rows determine, by their triangle `L^T R`, given L^T.
    fn cut(&mut self, sweep: &Sweep<'_>, upper: &[f64], pool: &Pool<'_>) -> Outcome {
        let factor = &sweep.nested.factor;
        let (rank, cuts) = (factor.rank, sweep.cuts);
        let lost = factor.tolerance * (rank as f64).sqrt();
        let safe = (0..PROBES).all(|probe| {
            let mut x: Vec<f64> = (0..rank).map(|j| sign(probe, j)).collect();
            linalg::solve_upper(upper, rank, rank, &mut x, 1);
            linalg::solve_upper(&factor.triangle, rank, rank, &mut x, 1);
            // An estimate of the inverse's norm, give or take a factor of ten.
            10.0 * lost * dot(&x, &x).sqrt() < 1.0
        });
        if safe {
            return Outcome::All;
        }
        let triangle = linalg::product(upper, &factor.triangle, rank, rank, rank);
        match factor::leading_rank(&triangle, rank, factor.tolerance, pool) {
            Ok(count) if count == rank => Outcome::All,
            Ok(count) => {
                let defined = cuts.partition_point(|&cut| cut <= count);
                self.curve[defined..].fill(f64::NAN);
                Outcome::Leading(defined)
            }
            Err(_) => Outcome::Close,
        }
    }
}

/// What a thread needs for pairs close to rank loss.
struct Rescue<'a> {
    sweep: &'a Sweep<'a>,
    problem: Problem<'a>,
    squares: &'a Doubles,
    plain: Workspace,
    last: Last<DoubledGram>,
    factor: DoubledFactor,
    refit: Refit,
}

impl Rescue<'_> {
    /// Fills the curve of a pair, and tells how many of the models are defined.
    fn solve(&mut self, pair: (usize, usize), pool: &Pool<'_>) -> Result<usize, Error> {
        let factor = &self.sweep.nested.factor;
        self.plain.gather(self.sweep, pair);
        self.plain.curve.fill(0.0);
        let enough = factor.total_rows >= factor.rank + self.plain.rows.len();
        if enough && self.doubled() >= DOUBLED {
            match self.plain.cut(self.sweep, &self.factor.upper(), pool) {
                Outcome::All => return Ok(self.sweep.cuts.len()),
                Outcome::Leading(defined) => return Ok(defined),
                Outcome::Close => pool.proceed()?,
            }
        }
        self.refitted(pool)
    }

    /// As `Workspace::primal`, with twice the digits; an estimate of lambda_min(M).
    fn doubled(&mut self) -> f64 {
        let Sweep { nested: Nested { factor, right, .. }, cuts, .. } = *self.sweep;
        let (rank, responses) = (factor.rank, factor.responses);
        self.follow();
        let smallest = self.factor.factor(&self.last.gram);
        if smallest < DOUBLED {
            return 0.0;
        }
        let signs: Vec<f64> = (0..rank).map(|j| sign(0, j)).collect();
        let forward = self.factor.forward(&signs);
        let grown = dot(forward, forward) - 10.0 * rank as f64;
        let Workspace { rows, validated, curve, forward, .. } = &mut self.plain;
        for c in 0..responses {
            self.factor.projection(c, &factor.projection[c * rank..(c + 1) * rank], forward);
            for &i in &rows[rows.len() - *validated..] {
                let u = self.factor.forward(factor.basis_row(i));
                add_squares([right[i * responses + c]], u.as_chunks().0, forward, cuts, curve);
            }
        }
        if grown > 0.0 { smallest.min(grown.recip()) } else { smallest }
    }

    /// Turns the matrix into that of the pair at hand.
    fn follow(&mut self) {
        let Self { sweep, plain, last, squares, .. } = self;
        let factor = &sweep.nested.factor;
        let Workspace { members, stamps, now, slide, .. } = plain;
        slide.find(last, members, stamps, *now);
        if slide.len() > members.len() {
            last.gram.start(squares, factor.rank, factor.responses);
            slide.removed.clear();
            slide.added.clone_from(members);
        }
        let fetch = |i: usize| (factor.basis_row(i), factor.residual_row(i));
        last.gram.change(&sweep.rows_of(&slide.added), -1.0, fetch);
        last.gram.change(&sweep.rows_of(&slide.removed), 1.0, fetch);
        last.remember(members);
    }

    /// From the training rows themselves.
    fn refitted(&mut self, pool: &Pool<'_>) -> Result<usize, Error> {
        let Self { sweep, problem, plain, refit, .. } = self;
        let factor = &sweep.nested.factor;
        let leading = refit.lead(factor, problem, pool, &plain.rows)?;
        let defined = sweep.cuts.partition_point(|&cut| cut <= leading);
        plain.curve[..defined].fill(0.0);
        plain.curve[defined..].fill(f64::NAN);
        for &i in &plain.rows[plain.rows.len() - plain.validated..] {
            for c in 0..factor.responses {
                let (b, u, v) = refit.forward(factor, problem, i, c, leading)?;
                add_squares([b], u.as_chunks().0, v, &sweep.cuts[..defined], &mut plain.curve);
            }
        }
        Ok(defined)
    }
}

/// Workspace of the dual.
#[derive(Default)]
struct Dual {
    /// Q_K, column by column.
    columns: Vec<f64>,
    /// `S_l^-1`, q x q.
    inverse: Vec<f64>,
    /// Prediction residuals of model l, responses x q.
    residuals: Vec<f64>,
    w: Vec<f64>,
}

impl Dual {
    /// Adds the squared residuals of the last `validated` rows at every cut; false if that may be inaccurate.
    fn solve(
        &mut self,
        nested: &Nested,
        cuts: &[usize],
        (rows, validated): (&[usize], usize),
        squares: &mut [f64],
    ) -> bool {
        let (q, rank) = (rows.len(), nested.factor.rank);
        self.load(nested, rows);
        let first = q - validated;
        let mut done = 0;
        for (square, &cut) in squares.iter_mut().zip(cuts) {
            if !(done..cut).all(|j| self.column(j, q, nested.factor.projection.chunks_exact(rank.max(1)))) {
                return false;
            }
            done = cut;
            *square += self.residuals.chunks_exact(q).map(|e| dot(&e[first..], &e[first..])).sum::<f64>();
        }
        let trace: f64 = self.inverse.iter().step_by(q + 1).sum();
        trace < q as f64 + 1.0 / DOUBTFUL
    }

    fn load(&mut self, nested: &Nested, rows: &[usize]) {
        let (q, rank, responses) = (rows.len(), nested.factor.rank, nested.factor.responses);
        self.columns.resize(q * rank, 0.0);
        self.residuals.resize(q * responses, 0.0);
        self.w.resize(q, 0.0);
        self.inverse.clear();
        self.inverse.resize(q * q, 0.0);
        for (k, &row) in rows.iter().enumerate() {
            self.inverse[k * (q + 1)] = 1.0;
            for (j, x) in nested.factor.basis_row(row).iter().enumerate() {
                self.columns[j * q + k] = *x;
            }
            self.residuals[k..].iter_mut().step_by(q).zip(nested.right_row(row)).for_each(|(e, b)| *e = *b);
        }
    }

    /// Adds column j to the model; false if its pivot vanishes.
    fn column<'a>(&mut self, j: usize, q: usize, projection: impl Iterator<Item = &'a [f64]>) -> bool {
        let Self { columns, inverse, residuals, w } = self;
        let column = &columns[j * q..(j + 1) * q];
        for (w, row) in w.iter_mut().zip(inverse.chunks_exact(q)) {
            *w = dot(row, column);
        }
        let pivot = 1.0 - dot(w, column);
        if pivot.is_nan() || pivot <= DOUBTFUL {
            return false;
        }
        for (e, c) in residuals.chunks_exact_mut(q).zip(projection) {
            let step = (c[j] - dot(column, e)) / pivot;
            e.iter_mut().zip(&*w).for_each(|(e, w)| *e -= w * step);
        }
        for (row, w_row) in inverse.chunks_exact_mut(q).zip(&*w) {
            let factor = w_row / pivot;
            row.iter_mut().zip(&*w).for_each(|(x, w)| *x += factor * w);
        }
        true
    }
}
